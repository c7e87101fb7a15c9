"""One agent on the network: a Zenoh session, its keys, readiness and liveliness.

Messages wait in Zenoh, in one channel per in-neighbour, until the agent reads them; everything else that happens
becomes an event in a queue. Keys, below ``dcf/<fleet>/<run>``:

- ``from/<sender>/to/<receiver>``: messages; what all out-neighbours get is published once, on ``from/<sender>/to/*``;
- ``hello/<from>/to/<to>``: readiness, both ways on every link, also on directed ones;
- ``alive/<agent>``: liveliness tokens;
- ``control/<agent>``: what operators ask of an agent, as queries.

An agent subscribes to its in-neighbours only and publishes under its own id only.
"""

import json
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeAlias

import zenoh
from zenoh.handlers import FifoChannel

from dcf_zenoh.errors import MessageError, NetworkError, NotReady
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Message, decode, encode
from dcf_zenoh.messaging.handshake import ClockOffset, Handshake, Hello
from dcf_zenoh.messaging.waker import Waker

HELLO_PERIOD = 0.02  # s between hellos to a neighbour that has not answered
LATECOMERS = 1.0  # s that an agent which was started again gives its other neighbours after the first has answered
CHANNEL_SIZE = 4096  # messages of one neighbour that can wait; a full channel holds the sender up
WAKE = os.urandom(16)  # what a channel delivers in place of a message when it is time to wake up
# Two runtime threads for what would be five: fewer hand-overs between sending and receiving (docs/performance.md). With
# one alone, a link that is given up while something is unsent (TCP lingers for 10 s) would hold all others up.
os.environ.setdefault(
    "ZENOH_RUNTIME", "(app: (worker_threads: 2), rx: (handover: app), net: (handover: app), acc: (handover: app))"
)


class Refused(NamedTuple):
    """Bytes on one of our keys that are no message, and why."""

    key: str
    reason: str


class Lost(NamedTuple):
    """A neighbour's liveliness token is gone."""

    agent: int


class Stop(NamedTuple):
    """Somebody wants this agent to end."""

    reason: str


class Agreed(NamedTuple):
    """A person has agreed to the take-off."""


class Command(NamedTuple):
    """An operator wants something of this agent, and waits for the answer."""

    request: bytes
    reply: Callable[[bytes], None]


Event: TypeAlias = Refused | Lost | Hello | Stop | Agreed | Command


@dataclass(frozen=True)
class Address:
    """Where an agent is on the network.

    Attributes:
        prefix: Start of all keys, ``dcf/<fleet>/<run>``.
        listen: Endpoint this agent listens on; empty: nobody connects to it.
        connect: Endpoints it connects to.
        settings: Zenoh configuration keys as paths, with their values; they go over our own.
        patience: So long, in s, sending may wait for room on the way to one neighbour; then that link is given up.
    """

    prefix: str
    listen: str
    connect: tuple[str, ...]
    settings: Mapping[str, Any]
    patience: float = 5.0

    def config(self) -> zenoh.Config:
        """The session's configuration: direct links by explicit endpoints, no scouting of any kind.

        Raises:
            NetworkError: Zenoh does not take one of the settings.
        """
        config = zenoh.Config()
        ours: dict[str, Any] = {
            "mode": "peer",
            "listen/endpoints": [self.listen] if self.listen else [],
            "connect/endpoints": list(self.connect),
            "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
            "open/return_conditions": {"connect_scouted": False, "declares": False},
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": round(self.patience * 1e6),
            "transport/shared_memory/enabled": False,  # whoever is killed would leave a file in /dev/shm
        }
        for key, value in {**ours, **self.settings}.items():
            _set(config, key, value)
        return config


def check_settings(settings: Mapping[str, Any]) -> None:
    """Try the settings of a fleet file on a configuration of their own.

    Raises:
        NetworkError: Zenoh does not take one of them.
    """
    config = zenoh.Config()
    for key, value in settings.items():
        _set(config, key, value)


def _set(config: zenoh.Config, key: str, value: Any) -> None:
    try:
        config.insert_json5(key, json.dumps(value))
    except (zenoh.ZError, TypeError) as error:
        raise NetworkError(f"zenoh.settings.{key}: Zenoh does not accept {value!r}: {_plain(error)}") from error


def _plain(error: Exception) -> str:
    """What Zenoh says, without the places in its source."""
    return re.sub(r"\s*\bat \S+\.rs:\d+\.?|[\[\]]", "", str(error)).strip(" .")


class Network:
    """The open session of one agent, read and written by one thread. Use it in a ``with`` statement.

    Args:
        agent: Id of this agent.
        hood: Whom it hears and who hears it.
        address: Keys and endpoints.
        urgent: Sees what operators ask for at once, in a thread of Zenoh's: it must neither wait nor publish.

    Raises:
        NetworkError: The endpoint is taken or malformed, or a setting is not Zenoh's.
    """

    def __init__(
        self,
        agent: int,
        hood: Neighbourhood,
        address: Address,
        urgent: Callable[[bytes], None] = lambda _request: None,
    ) -> None:
        self._agent = agent
        self._linked = sorted({*hood.receives_from, *hood.sends_to})
        self._prefix = address.prefix
        self._urgent = urgent
        self._events: SimpleQueue[Event] = SimpleQueue()
        self._meeting: Handshake | None = None
        config = address.config()
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise NetworkError(
                f"agent {agent}: cannot listen on {address.listen}, or cannot connect to {list(address.connect)}:"
                f" {_plain(error)}"
            ) from error
        self._waker = Waker(self._wake)
        self._keys = {j: f"{self._prefix}/from/{j}/to/{agent}" for j in hood.receives_from}
        self._channels = {
            j: self._session.declare_subscriber(key, FifoChannel(CHANNEL_SIZE)) for j, key in self._keys.items()
        }
        self._publisher = self._declare_publisher("*")
        self._edges = {j: self._declare_publisher(str(j)) for j in hood.sends_to}
        for j in self._linked:  # last, so that whoever can reach our hello key knows the others too
            self._watch(j)
        self._session.declare_queryable(f"{self._prefix}/control/{agent}", self._command)
        self._token = self._session.liveliness().declare_token(f"{self._prefix}/alive/{agent}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waker.close()
        for channel in self._channels.values():  # a session with a full channel does not close
            channel.undeclare()  # type: ignore[no-untyped-call]
        with suppress(zenoh.ZError):  # who is frozen does not take what was sent last, and the session is gone anyway
            self._session.close()  # type: ignore[no-untyped-call]

    def publish(self, message: Message, receiver: int | None = None, sent: int | None = None) -> None:
        """Send `message` to the out-neighbour `receiver`, or to all of them, stamped with `sent` if given."""
        publisher = self._publisher if receiver is None else self._edges[receiver]
        publisher.put(encode(message, sent))

    def receive(self, sender: int, deadline: float) -> Message | Refused | None:
        """Wait for the next message of the in-neighbour `sender`.

        Returns:
            None at `deadline` (monotonic s), or earlier when there is an event.
        """
        channel = self._channels[sender]
        while True:
            sample = channel.try_recv()
            if sample is None:
                self._waker.arm(sender, deadline)
                if not self._events.empty():
                    self._waker.disarm()
                    return None
                sample = channel.recv()
                self._waker.disarm()
            data = sample.payload.to_bytes()
            if data != WAKE:
                return self._read(data, sender)
            if not self._events.empty() or time.monotonic() >= deadline:
                return None

    def poll(self, sender: int) -> Message | Refused | None:
        """The next message of the in-neighbour `sender` if it is here already."""
        while (sample := self._channels[sender].try_recv()) is not None:
            data = sample.payload.to_bytes()
            if data != WAKE:
                return self._read(data, sender)
        return None

    def next_event(self, deadline: float) -> Event | None:
        """The next event, or None if there is none before `deadline` (monotonic s)."""
        try:
            return self._events.get(timeout=max(0.0, deadline - time.monotonic()))
        except Empty:
            return None

    def notify(self, event: Event) -> None:
        """Tell the agent of `event`, wherever it waits. From any thread, and from signal handlers."""
        self._events.put(event)
        self._waker.poke()

    def meet(self, fingerprint: str, timeout: float, incarnation: int = 0) -> dict[int, ClockOffset]:
        """Say hello to all neighbours until each has answered; see `Handshake`.

        An agent that was started again meets those who are there: it waits `LATECOMERS` for the others.

        Args:
            fingerprint: Of the fleet file and the plug-ins; all must have the same.
            timeout: In s.
            incarnation: Which life of this agent in this run this is.

        Returns:
            Neighbour -> clock offset.

        Raises:
            NotReady: Somebody did not answer; the message names them. Or this agent was told to stop.
            NetworkError: A neighbour runs another fleet.
        """
        self._meeting = meeting = Handshake(self._agent, self._linked, fingerprint, incarnation)
        aside: list[Event] = []
        deadline, due, enough = time.monotonic() + timeout, 0.0, inf
        while not meeting.over:
            now = time.monotonic()
            if incarnation and meeting.offsets:
                enough = min(enough, now + LATECOMERS)
            if now >= enough:
                break
            if now >= deadline:
                raise NotReady(f"agent {self._agent}: not ready within {timeout:g} s: {meeting.plight}")
            if now >= due:
                due = now + HELLO_PERIOD
                self._greet(self._linked, meeting)
            event = self.next_event(min(due, deadline))
            if isinstance(event, Stop):
                raise NotReady(f"agent {self._agent}: {event.reason} before all neighbours were ready")
            if isinstance(event, Lost):
                meeting.lose(event.agent)
            elif isinstance(event, Refused | Agreed):
                aside.append(event)
            elif isinstance(event, Command):
                event.reply(b"")  # not yet
            elif isinstance(event, Hello) and meeting.hear(event):
                self._greet([event.sender], meeting)
        self._greet(self._linked, meeting)
        for event in aside:
            self._events.put(event)
        return meeting.offsets

    @property
    def start(self) -> int:
        """When the fleet's time was 0, ns UTC; 0 while that is not known."""
        return 0 if self._meeting is None else self._meeting.start

    def started(self, instant: int) -> None:
        """Tell whoever joins later that the fleet's time was 0 at `instant`, ns UTC."""
        if self._meeting is not None:
            self._meeting.start = instant

    def answer(self, hello: Hello) -> None:
        """Answer a hello that came after the meeting: somebody joins, or has missed the last answer.

        Raises:
            NetworkError: The sender runs another fleet.
        """
        if self._meeting is not None:
            self._meeting.hear(hello)
            self._greet([hello.sender], self._meeting)

    def _declare_publisher(self, receiver: str) -> zenoh.Publisher:
        return self._session.declare_publisher(
            f"{self._prefix}/from/{self._agent}/to/{receiver}",
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )

    def unanswered(self) -> Iterator[Command]:
        """What operators have asked for and nobody has looked at; for the end, when nobody will."""
        with suppress(Empty):
            while True:
                event = self._events.get_nowait()
                if isinstance(event, Command):
                    yield event

    def _command(self, query: zenoh.Query) -> None:
        request = query.payload.to_bytes() if query.payload else b""
        self._urgent(request)
        self.notify(Command(request, lambda answer: query.reply(query.key_expr, answer)))

    def _wake(self, sender: int) -> None:
        """Let the channel of `sender` deliver something."""
        self._session.put(self._keys[sender], WAKE, allowed_destination=zenoh.Locality.SESSION_LOCAL)

    def _read(self, data: bytes, sender: int) -> Message | Refused:
        try:
            message = decode(data)
        except MessageError as error:
            return Refused(self._keys[sender], str(error))
        if message.sender != sender:
            return Refused(self._keys[sender], f"it claims to come from agent {message.sender}")
        return message

    def _greet(self, neighbours: Iterable[int], meeting: Handshake) -> None:
        for j in neighbours:
            self._session.put(f"{self._prefix}/hello/{self._agent}/to/{j}", meeting.say(j, time.time_ns()))

    def _watch(self, neighbour: int) -> None:
        key = f"{self._prefix}/hello/{neighbour}/to/{self._agent}"

        def greet(sample: zenoh.Sample) -> None:
            at = time.time_ns()
            try:
                self.notify(Hello.read(sample.payload.to_bytes(), neighbour, at))
            except MessageError as error:
                self.notify(Refused(key, str(error)))

        def mourn(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.DELETE:
                self.notify(Lost(neighbour))

        self._session.declare_subscriber(key, greet)
        self._session.liveliness().declare_subscriber(f"{self._prefix}/alive/{neighbour}", mourn, history=True)


def endpoints_to_connect(agent: int, linked: Iterable[int], endpoints: Mapping[int, str]) -> tuple[str, ...]:
    """One link per pair of neighbours: the higher id connects to the lower."""
    return tuple(endpoints[j] for j in linked if j < agent)
