"""A message on its way over one link."""

from typing import NamedTuple

from dcf_zenoh.message import Message, encode


class Delivery(NamedTuple):
    """A message on its way over one directed link.

    Attributes:
        message: What was sent.
        entered: When it entered the link, fleet time in ns. Never decreases along a link.
        due: When it is there for the receiver, fleet time in ns.
        here: Where the receiver is, shape (d,), in m; empty without a plant.
    """

    message: Message
    entered: int
    due: int
    here: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Length of the encoded message, in bytes."""
        return len(encode(self.message))
