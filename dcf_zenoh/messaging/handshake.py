"""The two-way hello by which neighbours know that they can hear each other, and how far their clocks are apart."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import msgpack

from dcf_zenoh.errors import MessageError, NetworkError


class Hello(NamedTuple):
    """A neighbour says that it is there; stamps in ns UTC of the clock that made them.

    `echo` and `heard` tell when the last hello from here was sent and when it arrived there; 0 if none has.
    `incarnation` says which life of the sender in this run this is, and `start` when the fleet's time was 0; 0 if it
    has not started.
    """

    sender: int
    fingerprint: str
    sent: int
    echo: int
    heard: int
    at: int
    incarnation: int = 0
    start: int = 0

    @classmethod
    def read(cls, data: bytes, neighbour: int, at: int) -> "Hello":
        """Read what arrived from `neighbour` at the instant `at`.

        Raises:
            MessageError: It is no hello, or not its.
        """
        try:
            fields = msgpack.unpackb(data)
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            raise MessageError(f"not a hello: {type(error).__name__} {error}") from error
        if not (isinstance(fields, list) and [type(field) for field in fields] == [int, str, *[int] * 5]):
            raise MessageError(f"not a hello: {fields!r:.60}")
        if fields[0] != neighbour:
            raise MessageError(f"it claims to come from agent {fields[0]}")
        sender, fingerprint, sent, echo, heard, incarnation, start = fields
        return cls(sender, fingerprint, sent, echo, heard, at, incarnation, start)


@dataclass(frozen=True)
class ClockOffset:
    """How far a neighbour's clock is ahead of this one, in ns, and the largest error of that number.

    Source: the four-stamp method of NTP (RFC 5905, section 8); the error is half the round trip.
    """

    ahead: int
    error: int

    @property
    def significant(self) -> int:
        """`ahead` if that is more than the error of its measurement, else 0."""
        return self.ahead if abs(self.ahead) > self.error else 0

    @classmethod
    def of(cls, hello: Hello) -> "ClockOffset":
        """From a hello that answers one from here."""
        ahead = (hello.heard - hello.echo) + (hello.sent - hello.at)
        trip = (hello.at - hello.echo) - (hello.sent - hello.heard)
        return cls(ahead // 2, max(0, trip) // 2)


class Handshake:
    """One agent's part in meeting its neighbours. It does no I/O.

    A neighbour is met when it has answered a hello from here. An agent declares its subscriptions before its first
    hello, so an answer shows that the neighbour knows them and that the neighbour's own are known here.

    Args:
        agent: Id of this agent.
        neighbours: All it is linked with, in either direction.
        fingerprint: Of the fleet file and the plug-ins; all must have the same.
        incarnation: Which life of this agent in this run this is.

    Attributes:
        offsets: Neighbour -> clock offset, the most certain one so far.
        start: When the fleet's time was 0, ns UTC of this machine; 0 while that is not known.
    """

    def __init__(self, agent: int, neighbours: Iterable[int], fingerprint: str, incarnation: int = 0) -> None:
        self.offsets: dict[int, ClockOffset] = {}
        self.start = 0
        self._incarnation = incarnation
        self._agent = agent
        self._fingerprint = fingerprint
        self._waiting = set(neighbours)
        self._silent = set(neighbours)
        self._last: dict[int, Hello] = {}

    @property
    def over(self) -> bool:
        """Whether all neighbours have been met."""
        return not self._waiting

    @property
    def plight(self) -> str:
        """Who has not been met, and how far it came."""
        unmet = {"nothing heard of": self._silent, "no answer from": self._waiting - self._silent}
        return ", ".join(
            f"{what} agent{'s' * (len(who) > 1)} {', '.join(map(str, sorted(who)))}"
            for what, who in unmet.items()
            if who
        )

    def say(self, to: int, now: int) -> bytes:
        """The hello for a neighbour, sent at `now`, ns UTC."""
        heard = self._last.get(to)
        echo = (heard.sent, heard.at) if heard else (0, 0)
        data: bytes = msgpack.packb((self._agent, self._fingerprint, now, *echo, self._incarnation, self.start))
        return data

    def hear(self, hello: Hello) -> bool:
        """Take in a hello; whether it is the first of its sender, who then needs an answer at once.

        Raises:
            NetworkError: The sender runs another fleet.
        """
        if hello.fingerprint != self._fingerprint:
            raise NetworkError(
                f"agent {self._agent}: agent {hello.sender} runs another fleet file, other plug-ins or another"
                f" version: fingerprint {hello.fingerprint}, expected {self._fingerprint}"
            )
        first = hello.sender in self._silent
        self._silent.discard(hello.sender)
        self._last[hello.sender] = hello
        if hello.echo:
            self._waiting.discard(hello.sender)
            offset, known = ClockOffset.of(hello), self.offsets.get(hello.sender)
            if known is None or offset.error < known.error:
                self.offsets[hello.sender] = offset
            if hello.start and not self.start:
                self.start = hello.start - offset.significant
        return first

    def lose(self, neighbour: int) -> None:
        """A neighbour is gone; if it comes back, it has to answer again."""
        self._waiting.add(neighbour)
        self._silent.add(neighbour)
        self._last.pop(neighbour, None)
