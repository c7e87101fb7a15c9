"""Events of an agent's network session: all that happens but messages."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from dcf_zenoh.messaging.handshake import Hello


class Refused(NamedTuple):
    """Bytes on one of the agent's keys that are not a message, and why."""

    key: str
    reason: str


class Lost(NamedTuple):
    """The liveliness token of a neighbour is gone."""

    agent: int


class Back(NamedTuple):
    """The liveliness token of a neighbour is there, for the first time or again."""

    agent: int


class Stop(NamedTuple):
    """The agent has to end."""

    reason: str


class Agreed(NamedTuple):
    """A person has agreed to the take-off."""


class Command(NamedTuple):
    """Request of an operator, which waits for the answer."""

    request: bytes
    reply: Callable[[bytes], None]


Event: TypeAlias = Refused | Lost | Back | Hello | Stop | Agreed | Command
