"""A message on its way over one link."""

from typing import NamedTuple

from dcf_zenoh.message import Message, encode


class Delivery(NamedTuple):
    """Message on its way over one directed link.

    Attributes:
        message: The message.
        entered: When it entered the link, fleet time in ns. Never decreases along a link.
        due: When the receiver gets it, fleet time in ns.
        here: Position of the receiver, shape (d,), in m; empty without a plant.
    """

    message: Message
    entered: int
    due: int
    here: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Length of the encoded message, in bytes."""
        return len(encode(self.message))
