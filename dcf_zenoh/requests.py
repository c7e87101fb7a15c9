"""Requests that an agent's loop makes of its runner. The loop itself does no I/O and reads no clock.

A runner (`dcf_zenoh.runner`) resumes the loop with the fleet time, an integer number of ns since the start.
"""

from collections.abc import Generator
from typing import NamedTuple, TypeAlias, TypeVar

from dcf_zenoh.message import Message
from dcf_zenoh.plant import Check

NEVER = 2**62


class Publish(NamedTuple):
    """Send `message` to the out-neighbour `receiver`, or to all out-neighbours."""

    message: Message
    receiver: int | None = None


class Wait(NamedTuple):
    """Continue at `until`, or once the messages of all `senders` up to `round` of `step` have been received.

    On the wall clock whichever comes first ends the wait. In virtual time, with `senders` the runner waits for their
    messages and no model time passes; without, time moves to `until`.
    """

    until: int
    senders: tuple[int, ...] = ()
    step: int = 0
    round: int = 0


class Activate(NamedTuple):
    """Continue at `until` with all messages that `senders` sent before.

    On the wall clock these are the messages received so far. In virtual time the runner waits until each sender has
    promised to send nothing more before `until` (conservative simulation; Chandy and Misra 1979, Bryant 1977).
    """

    until: int
    senders: tuple[int, ...]


class Start(NamedTuple):
    """Set fleet time 0 to `instant`, ns UTC. Virtual time ignores the instant."""

    instant: int


class Report(NamedTuple):
    """Report the phase of the flight that begins now, and the results of the inspection."""

    phase: str
    checks: tuple[Check, ...] = ()


class Agree(NamedTuple):
    """Continue when a person agrees to the take-off, or at `until`; then the loop is resumed with -1."""

    until: int


Request: TypeAlias = Publish | Wait | Activate | Start | Report | Agree
R = TypeVar("R")
Loop: TypeAlias = Generator[Request, int, R]
