"""One agent on the network: a Zenoh session, its keys, readiness and liveliness.

Everything that arrives becomes an event in one queue; callbacks decode and hand over, nothing else. Keys, below
``dcf/<fleet>/<run>``:

- ``from/<sender>``: what all out-neighbours get; ``from/<sender>/to/<receiver>``: edge payloads;
- ``hello/<from>/to/<to>``: readiness, both ways on every link, also on directed ones;
- ``alive/<agent>``: liveliness tokens.

An agent subscribes to its in-neighbours only and publishes under its own id only.
"""

import json
import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeAlias

import msgpack
import zenoh

from dcf_zenoh.errors import MessageError, NetworkError, NotReady
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.messaging.message import Message, decode, encode

HELLO_PERIOD = 0.02  # s between hellos to a neighbour that has not answered
# One runtime thread for what would be four: fewer hand-overs between sending and receiving (docs/performance.md).
os.environ.setdefault(
    "ZENOH_RUNTIME", "(app: (worker_threads: 1), rx: (handover: app), net: (handover: app), acc: (handover: app))"
)


class Arrived(NamedTuple):
    """A message, and when it came, monotonic ns."""

    message: Message
    at: int


class Refused(NamedTuple):
    """Bytes on one of our keys that are no message, and why."""

    key: str
    error: MessageError


class Lost(NamedTuple):
    """A neighbour's liveliness token is gone."""

    agent: int


class Hello(NamedTuple):
    """A neighbour says that it is there; stamps in ns UTC of the clock that made them.

    `echo` and `heard` tell when the last hello from here was sent and when it arrived there; 0 if none has.
    """

    sender: int
    fingerprint: str
    sent: int
    echo: int
    heard: int
    at: int


class Stop(NamedTuple):
    """Somebody wants this agent to end."""

    reason: str


Event: TypeAlias = Arrived | Refused | Lost | Hello | Stop


@dataclass(frozen=True)
class ClockOffset:
    """How far a neighbour's clock is ahead of this one, in ns, and the largest error of that number.

    Source: the four-stamp method of NTP (RFC 5905, section 8); the error is half the round trip.
    """

    ahead: int
    error: int


@dataclass(frozen=True)
class Address:
    """Where an agent is on the network.

    Attributes:
        prefix: Start of all keys, ``dcf/<fleet>/<run>``.
        listen: Endpoint this agent listens on.
        connect: Endpoints it connects to.
        settings: Zenoh configuration keys as paths, with their values.
    """

    prefix: str
    listen: str
    connect: tuple[str, ...]
    settings: Mapping[str, Any]

    def config(self) -> zenoh.Config:
        """The session's configuration: direct links by explicit endpoints, no scouting of any kind.

        Raises:
            NetworkError: Zenoh does not take one of the settings.
        """
        config = zenoh.Config()
        defaults: dict[str, Any] = {
            "mode": "peer",
            "listen/endpoints": [self.listen],
            "connect/endpoints": list(self.connect),
            "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
            "open/return_conditions": {"connect_scouted": False, "declares": False},
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
        }
        for key, value in {**defaults, **self.settings}.items():
            try:
                config.insert_json5(key, json.dumps(value))
            except (zenoh.ZError, TypeError) as error:
                raise NetworkError(f"zenoh.settings.{key}: Zenoh does not accept {value!r}: {error}") from error
        return config


class Network:
    """The open session of one agent. Use it in a ``with`` statement.

    Args:
        agent: Id of this agent.
        hood: Whom it hears and who hears it.
        address: Keys and endpoints.

    Raises:
        NetworkError: The endpoint is taken or malformed, or a setting is not Zenoh's.
    """

    def __init__(self, agent: int, hood: Neighbourhood, address: Address) -> None:
        self.events: SimpleQueue[Event] = SimpleQueue()
        self._agent = agent
        self._linked = sorted({*hood.receives_from, *hood.sends_to})
        self._prefix = address.prefix
        config = address.config()
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise NetworkError(
                f"agent {agent}: cannot listen on {address.listen}: the address is in use or not of this machine ({error})"
            ) from error
        publish = {"congestion_control": zenoh.CongestionControl.BLOCK, "express": True}
        for j in hood.receives_from:
            self._subscribe(j, f"{self._prefix}/from/{j}")
            self._subscribe(j, f"{self._prefix}/from/{j}/to/{agent}")
        self._publisher = self._session.declare_publisher(f"{self._prefix}/from/{agent}", **publish)
        self._edges = {
            j: self._session.declare_publisher(f"{self._prefix}/from/{agent}/to/{j}", **publish) for j in hood.sends_to
        }
        for j in self._linked:  # last, so that whoever can reach our hello key knows the others too
            self._watch(j)
        self._token = self._session.liveliness().declare_token(f"{self._prefix}/alive/{agent}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def publish(self, message: Message, receiver: int | None = None) -> None:
        """Send `message` to the out-neighbour `receiver`, or to all of them."""
        publisher = self._publisher if receiver is None else self._edges[receiver]
        publisher.put(encode(message))

    def next_event(self, timeout: float) -> Event | None:
        """The next event, or None if there is none within `timeout` seconds."""
        try:
            return self.events.get(timeout=max(0.0, timeout))
        except Empty:
            return None

    def meet(self, fingerprint: str, timeout: float) -> tuple[dict[int, ClockOffset], list[Event]]:
        """Say hello to all neighbours until each has answered.

        A neighbour's answer shows that it knows this agent's subscriptions and that its own are known here, for it
        declared them before its hello.

        Args:
            fingerprint: Of the fleet file and the plug-ins; all must have the same.
            timeout: In s.

        Returns:
            Neighbour -> clock offset; and the events that came meanwhile and are for the agent's loop.

        Raises:
            NotReady: Somebody did not answer; the message names them.
            NetworkError: A neighbour runs another fleet.
        """
        waiting = set(self._linked)
        last: dict[int, Hello] = {}
        offsets: dict[int, ClockOffset] = {}
        others: list[Event] = []
        deadline = time.monotonic() + timeout
        due = 0.0
        while waiting:
            now = time.monotonic()
            if now >= deadline:
                raise NotReady(
                    f"agent {self._agent}: not ready within {timeout:g} s: nothing heard of agents"
                    f" {sorted(set(self._linked) - set(last))}, no answer from {sorted(waiting & set(last))}"
                )
            if now >= due:
                due = now + HELLO_PERIOD
                for j in self._linked:
                    self._hello(j, fingerprint, last.get(j))
            event = self.next_event(min(due, deadline) - now)
            if isinstance(event, Hello):
                if event.fingerprint != fingerprint:
                    raise NetworkError(
                        f"agent {self._agent}: agent {event.sender} runs another fleet file, other plug-ins or other"
                        f" versions: fingerprint {event.fingerprint}, expected {fingerprint}"
                    )
                fresh = event.sender not in last
                last[event.sender] = event
                if event.echo:
                    waiting.discard(event.sender)
                    offset = _offset(event)
                    known = offsets.get(event.sender)
                    offsets[event.sender] = offset if known is None or offset.error < known.error else known
                if fresh:
                    self._hello(event.sender, fingerprint, event)
            elif isinstance(event, Stop):
                return offsets, [*others, event]
            elif event is not None and not isinstance(event, Lost):
                others.append(event)
        for j in self._linked:
            self._hello(j, fingerprint, last[j])
        return offsets, others

    def _hello(self, to: int, fingerprint: str, heard: Hello | None) -> None:
        echo = (heard.sent, heard.at) if heard else (0, 0)
        data = msgpack.packb((self._agent, fingerprint, time.time_ns(), *echo))
        self._session.put(f"{self._prefix}/hello/{self._agent}/to/{to}", data)

    def _subscribe(self, sender: int, key: str) -> None:
        def deliver(sample: zenoh.Sample) -> None:
            at = time.monotonic_ns()
            try:
                message = decode(sample.payload.to_bytes())
                if message.sender != sender:
                    raise MessageError(f"it claims to come from agent {message.sender}")
                self.events.put(Arrived(message, at))
            except MessageError as error:
                self.events.put(Refused(key, error))

        self._session.declare_subscriber(key, deliver)

    def _watch(self, neighbour: int) -> None:
        hello_key = f"{self._prefix}/hello/{neighbour}/to/{self._agent}"

        def greet(sample: zenoh.Sample) -> None:
            at = time.time_ns()
            try:
                self.events.put(_read_hello(sample.payload.to_bytes(), neighbour, at))
            except MessageError as error:
                self.events.put(Refused(hello_key, error))

        def mourn(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                self.events.put(Lost(neighbour))

        self._session.declare_subscriber(hello_key, greet)
        self._session.liveliness().declare_subscriber(f"{self._prefix}/alive/{neighbour}", mourn, history=True)


def endpoints_to_connect(agent: int, linked: Iterable[int], endpoints: Mapping[int, str]) -> tuple[str, ...]:
    """One link per pair of neighbours: the higher id connects to the lower."""
    return tuple(endpoints[j] for j in linked if j < agent)


def _read_hello(data: bytes, neighbour: int, at: int) -> Hello:
    try:
        fields = msgpack.unpackb(data)
    except (ValueError, msgpack.UnpackException) as error:
        raise MessageError(f"not a hello: {error}") from error
    if not (isinstance(fields, list) and [type(f) for f in fields] == [int, str, int, int, int] and fields[0] == neighbour):
        raise MessageError(f"not a hello of agent {neighbour}: {fields!r:.60}")
    return Hello(*fields, at)


def _offset(hello: Hello) -> ClockOffset:
    there = (hello.heard - hello.echo) + (hello.sent - hello.at)
    trip = (hello.at - hello.echo) - (hello.sent - hello.heard)
    return ClockOffset(there // 2, max(0, trip) // 2)
