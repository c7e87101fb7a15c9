"""Two-way hello between neighbours: each receives the other's messages, and the offset of their clocks is known."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import msgpack

from dcf_zenoh.errors import MessageError, NetworkError
from dcf_zenoh.message import BOUNDS, FieldBounds

SIZE_MAX = 512  # bytes of a hello
_INSTANT = FieldBounds(0, 2**62)  # ns UTC, until the year 2116
HELLO_BOUNDS = (BOUNDS["sender"], FieldBounds(0, 128), _INSTANT, _INSTANT, _INSTANT, BOUNDS["incarnation"], _INSTANT)
START_APART = 30 * 24 * 3600 * 1_000_000_000  # ns between the start of a fleet and a hello that is believed


class Hello(NamedTuple):
    """Hello of a neighbour. Instants in ns UTC of the clock that measured them.

    Attributes:
        sender: Id of the neighbour.
        fingerprint: Hash of its fleet file, plug-ins and version.
        sent: When it was sent, by the sender's clock.
        echo: When the last hello to the sender was sent, by the receiver's clock; 0 if the sender has had none.
        received: When that one was received there, by the sender's clock; 0 if the sender has had none.
        at: When this hello was received, by the receiver's clock.
        incarnation: Number of restarts of the sender in this run.
        start: When fleet time was 0, by the sender's clock; 0 if it has not started.
    """

    sender: int
    fingerprint: str
    sent: int
    echo: int
    received: int
    at: int
    incarnation: int = 0
    start: int = 0

    @classmethod
    def read(cls, data: bytes, neighbour: int, at: int) -> "Hello":
        """Decode a hello received from `neighbour` at the instant `at`, ns UTC.

        Raises:
            MessageError: `data` is no hello, or not one of `neighbour`.
        """
        if len(data) > SIZE_MAX:
            raise MessageError(f"not a hello: {len(data)} bytes, at most {SIZE_MAX} are allowed")
        try:
            fields = msgpack.unpackb(data)
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            raise MessageError(f"not a hello: {type(error).__name__} {error}") from error
        if not (isinstance(fields, list) and [type(field) for field in fields] == [int, str, *[int] * 5]):
            raise MessageError(f"not a hello: {fields!r:.60}")
        if fields[0] != neighbour:
            raise MessageError(f"it claims to come from agent {fields[0]}")
        for name, value, bounds in zip(_FIELDS, fields, HELLO_BOUNDS, strict=True):
            number = len(value) if isinstance(value, str) else value  # of the fingerprint its length
            if not bounds.least <= number <= bounds.most:
                raise MessageError(f"not a hello: {name} {value!r:.60}, expected {bounds.least:g} .. {bounds.most:g}")
        sender, fingerprint, sent, echo, received, incarnation, start = fields
        if start and abs(start - at) > START_APART:
            raise MessageError(f"not a hello: the fleet would have started {(at - start) * 1e-9 / 86400:.3g} days ago")
        return cls(sender, fingerprint, sent, echo, received, at, incarnation, start)


_FIELDS = ("sender", "fingerprint", "sent", "echo", "received", "incarnation", "start")


@dataclass(frozen=True)
class ClockOffset:
    """Offset of a neighbour's clock.

    Source: the four-stamp method of NTP (RFC 5905, section 8); the error is half the round trip.

    Attributes:
        ahead: How far the neighbour's clock is ahead of this one, ns.
        error: Largest error of that number, ns.
    """

    ahead: int
    error: int

    @property
    def significant(self) -> int:
        """`ahead` if it is larger than the error of its measurement, else 0."""
        return self.ahead if abs(self.ahead) > self.error else 0

    @classmethod
    def of(cls, hello: Hello) -> "ClockOffset":
        """Compute the offset from a hello that answers an earlier one."""
        ahead = (hello.received - hello.echo) + (hello.sent - hello.at)
        trip = (hello.at - hello.echo) - (hello.sent - hello.received)
        return cls(ahead // 2, max(0, trip) // 2)


class Handshake:
    """Handshake of one agent with its neighbours. It does no I/O.

    The handshake with a neighbour is complete when the neighbour has answered a hello. An agent declares its
    subscriptions before its first hello, so an answer shows that each knows the subscriptions of the other.

    Args:
        agent: Id of this agent.
        neighbours: Its neighbours, over links in either direction.
        fingerprint: Hash of fleet file, plug-ins and version; it must be the same at every agent.
        incarnation: Number of restarts of this agent in this run.

    Attributes:
        offsets: Neighbour -> clock offset, the most certain one so far.
        start: When fleet time was 0, ns UTC of this machine; 0 while that is not known.
    """

    def __init__(self, agent: int, neighbours: Iterable[int], fingerprint: str, incarnation: int = 0) -> None:
        self.offsets: dict[int, ClockOffset] = {}
        self.start = 0
        self._incarnation = incarnation
        self._agent = agent
        self._fingerprint = fingerprint
        self._unanswered = set(neighbours)
        self._silent = set(neighbours)
        self._unconfirmed = set(neighbours)
        self._last: dict[int, Hello] = {}
        self._asked: dict[int, int] = {}  # neighbour -> when the last hello that was no answer was sent to it, ns UTC

    @property
    def complete(self) -> bool:
        """Whether all neighbours have answered."""
        return not self._unanswered

    @property
    def confirmed(self) -> bool:
        """Whether all neighbours are known to have an answer too: then no further hello is needed."""
        return not (self._unanswered or self._unconfirmed)

    @property
    def status(self) -> str:
        """Neighbours that are missing, and how far the handshake with them has come, for error texts."""
        missing = {"nothing heard of": self._silent, "no answer from": self._unanswered - self._silent}
        return ", ".join(
            f"{what} agent{'s' * (len(ids) > 1)} {', '.join(map(str, sorted(ids)))}"
            for what, ids in missing.items()
            if ids
        )

    def hello(self, to: int, now: int) -> bytes:
        """Return the hello for a neighbour, sent at `now`, ns UTC."""
        last = self._last.get(to)
        if last is None:
            self._asked[to] = now
        echo = (last.sent, last.at) if last else (0, 0)
        data: bytes = msgpack.packb((self._agent, self._fingerprint, now, *echo, self._incarnation, self.start))
        return data

    def receive(self, hello: Hello) -> bool:
        """Take in a hello; return whether its sender still needs an answer.

        It needs one until it echoes a hello that was an answer itself. So both sides repeat their hellos until each has
        an answer, whatever is lost, and an answer to the last answer is never sent.

        Raises:
            NetworkError: The sender runs another fleet.
        """
        if hello.fingerprint != self._fingerprint:
            raise NetworkError(
                f"agent {self._agent}: agent {hello.sender} runs another fleet file, other plug-ins or another"
                f" version: fingerprint {hello.fingerprint}, expected {self._fingerprint}"
            )
        self._silent.discard(hello.sender)
        self._last[hello.sender] = hello
        if hello.echo:
            self._unanswered.discard(hello.sender)
            offset, best = ClockOffset.of(hello), self.offsets.get(hello.sender)
            if best is None or offset.error < best.error:
                self.offsets[hello.sender] = offset
            if hello.start and not self.start:
                self.start = hello.start - offset.significant
        if hello.echo <= self._asked.get(hello.sender, 0):
            return True
        self._unconfirmed.discard(hello.sender)
        return False

    def forget(self, neighbour: int) -> None:
        """Forget a neighbour that is gone: if it comes back, the handshake with it begins anew."""
        self._unanswered.add(neighbour)
        self._silent.add(neighbour)
        self._unconfirmed.add(neighbour)
        self._last.pop(neighbour, None)
        self._asked.pop(neighbour, None)
