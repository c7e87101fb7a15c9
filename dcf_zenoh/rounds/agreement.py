"""Agreement of a fleet, by the headers of its messages alone, that a step is over and that all agents have arrived."""

import math
from collections.abc import Collection, Iterable
from typing import NamedTuple

from dcf_zenoh.message import Message


class Header(NamedTuple):
    """The part of a message that serves the agreement; see `Message` for the fields."""

    residuals: tuple[float, ...] = ()
    stop_at: int = -1
    arrived_hops: int = -1


class Agreement:
    """Agreement within one step, as seen by one agent.

    Every message contains, for each d below the diameter D, the largest residual within d hops, d rounds ago. So at
    the end of a round all agents have the same number, the fleet's largest residual of D - 1 rounds before, and all
    find it below the threshold in the same round. With a margin, for networks that lose messages, the end is announced
    that many rounds ahead and the earliest announcement received counts.

    Args:
        diameter: Diameter of the communication graph, in hops.
        neighbours: Number of in-neighbours of this agent.
        threshold: Bound on the residuals: the step is over when none reaches it.
        margin: Rounds between announcing the end and leaving.
        arrived: Whether this agent has arrived.
    """

    def __init__(self, diameter: int, neighbours: int, threshold: float, margin: int, *, arrived: bool) -> None:
        self._diameter = diameter
        self._neighbours = neighbours
        self._threshold = threshold
        self._margin = margin
        self._farther = (math.inf,) * (max(1, diameter) - 1)  # entries 1 .. D-1 of the next header
        self._stop_at = -1
        self._arrived_hops = 0 if arrived else -1

    def header(self, residual: float) -> Header:
        """Return the header to send with the agent's own `residual`."""
        return Header((residual, *self._farther), self._stop_at, self._arrived_hops)

    def conclude(self, residual: float, received: Iterable[Message], round: int) -> bool:
        """Take in the newest header of each neighbour at the end of `round`; return whether this round is the last."""
        own = residual, *self._farther
        messages = [message for message in received if len(message.residuals) == len(own)]
        spread = [max(each) for each in zip(own, *[message.residuals for message in messages], strict=True)]
        for message in messages:
            if message.stop_at >= 0:
                self._announce(message.stop_at)
        if spread.pop() < self._threshold:
            self._announce(round + self._margin)
        self._farther = tuple(spread)
        self.note_arrived(messages)
        return 0 <= self._stop_at <= round

    def note_arrived(self, messages: Collection[Message]) -> None:
        """Take in from the newest header of each neighbour how far around it all have arrived.

        This needs no rounds in step: it is correct in asynchronous mode, too.
        """
        if self._arrived_hops >= 0:
            hops = [message.arrived_hops for message in messages]
            if -1 in hops:
                self._arrived_hops = -1
            elif len(hops) == self._neighbours:
                self._arrived_hops = min((self._arrived_hops, *hops)) + 1

    def _announce(self, round: int) -> None:
        """Take in an announced end: the earliest counts."""
        self._stop_at = round if self._stop_at < 0 else min(self._stop_at, round)

    @property
    def all_arrived(self) -> bool:
        """Whether every agent of the fleet is known to have arrived."""
        return self._arrived_hops >= self._diameter
