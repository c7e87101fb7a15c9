"""What an agent's loop asks of its runner. The loop itself does no I/O and reads no clock.

A runner resumes the loop with the fleet time, an integer number of ns since the start.
"""

from collections.abc import Generator
from typing import NamedTuple, TypeAlias, TypeVar

from dcf_zenoh.message import Message
from dcf_zenoh.plant import Check

NEVER = 2**62


class Publish(NamedTuple):
    """Hand `message` to the out-neighbour `receiver`, or to all of them."""

    message: Message
    receiver: int | None = None


class Wait(NamedTuple):
    """Go on at `until`, or as soon as each of `senders` has been heard up to `round` of `step`.

    On the wall clock whichever comes first ends the wait. In virtual time knowledge comes first: with `senders` the
    runner waits for their messages and no model time passes; without, time moves to `until`.
    """

    until: int
    senders: tuple[int, ...] = ()
    step: int = 0
    round: int = 0


class Activate(NamedTuple):
    """Go on at `until`, knowing all that `senders` sent before.

    On the wall clock that is what is there. In virtual time the runner waits until each of them has promised to send
    nothing more before `until` (conservative simulation; Chandy and Misra 1979, Bryant 1977).
    """

    until: int
    senders: tuple[int, ...]


class Start(NamedTuple):
    """The fleet starts now: its time 0 is this instant, in ns UTC. Virtual time has no use for it."""

    instant: int


class Report(NamedTuple):
    """Tell whoever watches which phase of the flight begins, and what the inspection has found."""

    phase: str
    checks: tuple[Check, ...] = ()


class Agree(NamedTuple):
    """Go on when a person agrees to the take-off, or at `until`; then the loop is resumed with -1."""

    until: int


Request: TypeAlias = Publish | Wait | Activate | Start | Report | Agree
R = TypeVar("R")
Loop: TypeAlias = Generator[Request, int, R]
