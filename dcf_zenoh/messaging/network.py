"""Zenoh session of one agent: its keys, handshake and liveliness.

Messages wait in Zenoh, in one channel per in-neighbour, until the agent reads them. Everything else that happens
becomes an event in a queue. Keys, below ``dcf/<fleet>/<run>``:

- ``from/<sender>/to/<receiver>``: messages; one to all out-neighbours is published once, on ``from/<sender>/to/*``;
- ``hello/<from>/to/<to>``: hellos of the handshake, both ways on every link, also on directed ones;
- ``alive/<agent>``: liveliness tokens;
- ``control/<agent>``: requests of operators, as queries.

A UDP endpoint stands for two links to the same address: TCP for all that must be received (Zenoh's declarations,
hellos, liveliness tokens, messages before the start, goodbyes), UDP for the messages of rounds, which may be lost.

An agent subscribes to its in-neighbours only and publishes under its own id only.
"""

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import inf
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Self

import zenoh
from zenoh.handlers import FifoChannel

from dcf_zenoh.errors import MessageError, NetworkError, NotReady
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import GOODBYE, Message, decode, encode
from dcf_zenoh.messaging.address import Address, plain_text
from dcf_zenoh.messaging.events import Agreed, Back, Command, Event, Lost, Refused, Stop
from dcf_zenoh.messaging.handshake import ClockOffset, Handshake, Hello
from dcf_zenoh.messaging.waker import Waker

HELLO_PERIOD = 0.02  # s between hellos to a neighbour that has not answered
CONFIRM_WAIT = 0.2  # s that a complete handshake goes on until the neighbours are known to have their answers too
REJOIN_WAIT = 1.0  # s that a restarted agent waits for further neighbours after the first has answered
CLOSE_WITHIN = 1.0  # s; Zenoh itself waits up to 10 s for a neighbour that takes nothing
EVENTS_MAX = 1000  # hellos, requests and refusals that can wait
CHANNEL_SIZE = 4096  # messages of one neighbour that can wait; a full channel blocks the sender
WAKE = os.urandom(16)  # payload that wakes up a thread which waits for a message
# Two runtime threads in place of five: fewer hand-overs between sending and receiving (docs/performance.md). With a
# single one, a link that is given up with unsent data (TCP lingers for 10 s) would block all others.
os.environ.setdefault(
    "ZENOH_RUNTIME", "(app: (worker_threads: 2), rx: (handover: app), net: (handover: app), acc: (handover: app))"
)


class Network:
    """Open session of one agent, read and written by one thread. Use it in a ``with`` statement.

    Args:
        agent: Id of this agent.
        neighbourhood: Its neighbours.
        address: Keys and endpoints.
        urgent: Called with every operator's request at once, in a thread of Zenoh: it must neither wait nor publish.

    Raises:
        NetworkError: The endpoint is in use or malformed, or Zenoh does not accept a setting.
    """

    def __init__(
        self,
        agent: int,
        neighbourhood: Neighbourhood,
        address: Address,
        urgent: Callable[[bytes], None] = lambda _request: None,
    ) -> None:
        self._agent = agent
        self._linked = sorted({*neighbourhood.receives_from, *neighbourhood.sends_to})
        self._prefix = address.prefix
        self._urgent = urgent
        self._events: SimpleQueue[Event] = SimpleQueue()
        self._handshake: Handshake | None = None
        config = address.config()
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            raise NetworkError(
                f"agent {agent}: cannot listen on {address.listen}, or cannot connect to {list(address.connect)}:"
                f" {plain_text(error)}"
            ) from error
        self._waker = Waker(self._wake)
        self._channels: dict[int, zenoh.Subscriber[Any]] = {}
        try:
            self._declare(neighbourhood, lossy=address.lossy and address.over_udp)
        except BaseException:
            self.__exit__(None, None, None)  # a session that stays open would keep the process from ending
            raise

    def _declare(self, neighbourhood: Neighbourhood, *, lossy: bool) -> None:
        """Declare all that the session has, its token last; with `lossy` messages of rounds go by UDP."""
        agent = self._agent
        self._keys = {j: f"{self._prefix}/from/{j}/to/{agent}" for j in neighbourhood.receives_from}
        for j, key in self._keys.items():
            self._channels[j] = self._session.declare_subscriber(key, FifoChannel(CHANNEL_SIZE))
        receivers: tuple[int | None, ...] = (None, *neighbourhood.sends_to)
        self._certain = {j: self._declare_publisher(j, zenoh.Reliability.RELIABLE) for j in receivers}
        self._rounds = self._certain
        if lossy:
            self._rounds = {j: self._declare_publisher(j, zenoh.Reliability.BEST_EFFORT) for j in receivers}
        for j in self._linked:  # last: once the hello key is declared, all others are
            self._watch(j)
        self._session.declare_queryable(f"{self._prefix}/control/{agent}", self._on_query)
        self._token = self._session.liveliness().declare_token(f"{self._prefix}/alive/{agent}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._waker.close()
        closing = threading.Thread(target=self._close, name="close-session", daemon=True)
        closing.start()
        closing.join(CLOSE_WITHIN)

    def _close(self) -> None:
        for channel in self._channels.values():  # a session with a full channel does not close
            channel.undeclare()  # type: ignore[no-untyped-call]
        with suppress(zenoh.ZError):  # a frozen neighbour does not take the last messages
            self._session.close()  # type: ignore[no-untyped-call]

    def publish(self, message: Message, receiver: int | None = None, sent: int | None = None) -> None:
        """Send `message` to the out-neighbour `receiver`, or to all of them, stamped with `sent` if given."""
        certain = message.step < 0 or message.last >= GOODBYE
        (self._certain if certain else self._rounds)[receiver].put(encode(message, sent))

    def receive(self, sender: int, deadline: float) -> Message | Refused | None:
        """Wait for the next message of the in-neighbour `sender`, until `deadline` (monotonic s).

        Returns:
            The message; None at the deadline, or earlier when there is an event.
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
        """Return the next message of the in-neighbour `sender`, or None if none has been received."""
        while (sample := self._channels[sender].try_recv()) is not None:
            data = sample.payload.to_bytes()
            if data != WAKE:
                return self._read(data, sender)
        return None

    def next_event(self, deadline: float) -> Event | None:
        """Wait for the next event; return None if there is none before `deadline` (monotonic s)."""
        try:
            return self._events.get(timeout=max(0.0, deadline - time.monotonic()))
        except Empty:
            return None

    def notify(self, event: Event) -> None:
        """Queue `event` and wake the agent up. Callable from any thread and from signal handlers.

        What comes from the network is dropped where `EVENTS_MAX` events wait already; hellos are repeated.
        """
        if isinstance(event, Hello | Refused | Command) and self._events.qsize() >= EVENTS_MAX:
            return
        self._events.put(event)
        self._waker.poke()

    def do_handshake(self, fingerprint: str, timeout: float, incarnation: int = 0) -> dict[int, ClockOffset]:
        """Do the handshake with all neighbours; see `Handshake`.

        Hellos are repeated until all have answered, and then for up to `CONFIRM_WAIT` until all neighbours have their
        answers too. After that, `answer` serves those that do not. A restarted agent needs one neighbour, and waits
        `REJOIN_WAIT` for the others.

        Args:
            fingerprint: Hash of fleet file, plug-ins and version; it must be the same at every agent.
            timeout: Longest wait, s.
            incarnation: Number of restarts of this agent in this run.

        Returns:
            Neighbour -> clock offset.

        Raises:
            NotReady: A neighbour did not answer; the message names it. Or this agent was stopped from outside.
            NetworkError: A neighbour runs another fleet.
        """
        self._handshake = handshake = Handshake(self._agent, self._linked, fingerprint, incarnation)
        deferred: list[Event] = []
        deadline, due, enough = time.monotonic() + timeout, 0.0, inf
        while not handshake.confirmed:
            now = time.monotonic()
            rest = CONFIRM_WAIT if handshake.complete else REJOIN_WAIT if incarnation and handshake.offsets else inf
            enough = min(enough, now + rest) if rest < inf else inf
            if now >= enough:
                break
            if now >= deadline:
                raise NotReady(f"agent {self._agent}: not ready within {timeout:g} s: {handshake.status}")
            if now >= due:
                due = now + HELLO_PERIOD
                self._send_hellos(self._linked, handshake)
            self._shake(handshake, self.next_event(min(due, deadline, enough)), deferred)
        self._send_hellos(self._linked, handshake)
        for event in deferred:
            self._events.put(event)
        return handshake.offsets

    def _shake(self, handshake: Handshake, event: Event | None, deferred: list[Event]) -> None:
        """Handle an event of the handshake; what belongs to the time after it goes to `deferred`.

        Raises:
            NotReady: This agent was stopped from outside.
            NetworkError: A neighbour runs another fleet.
        """
        if isinstance(event, Stop):
            raise NotReady(f"agent {self._agent}: {event.reason} before all neighbours were ready")
        if isinstance(event, Lost):
            handshake.forget(event.agent)
        elif isinstance(event, Refused | Agreed):
            deferred.append(event)
        elif isinstance(event, Command):
            event.reply(b"")  # no requests before the start
        elif isinstance(event, Hello) and handshake.receive(event):
            self._send_hellos([event.sender], handshake)

    @property
    def start(self) -> int:
        """Instant at which fleet time was 0, ns UTC; 0 while that is not known."""
        return 0 if self._handshake is None else self._handshake.start

    def started(self, instant: int) -> None:
        """Note that fleet time was 0 at `instant`, ns UTC, for agents that join later."""
        if self._handshake is not None:
            self._handshake.start = instant

    def answer(self, hello: Hello) -> None:
        """Answer a hello that came after the handshake, if its sender needs that: it joins late, or missed the answer.

        Raises:
            NetworkError: The sender runs another fleet.
        """
        if self._handshake is not None and self._handshake.receive(hello):
            self._send_hellos([hello.sender], self._handshake)

    def unanswered(self) -> Iterator[Command]:
        """Yield the operators' requests that nothing has handled; for the end of the run."""
        with suppress(Empty):
            while True:
                event = self._events.get_nowait()
                if isinstance(event, Command):
                    yield event

    def _declare_publisher(self, receiver: int | None, reliability: zenoh.Reliability) -> zenoh.Publisher:
        return self._session.declare_publisher(
            f"{self._prefix}/from/{self._agent}/to/{'*' if receiver is None else receiver}",
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
            reliability=reliability,
        )

    def _on_query(self, query: zenoh.Query) -> None:
        request = query.payload.to_bytes() if query.payload else b""
        self._urgent(request)
        self.notify(Command(request, lambda answer: query.reply(query.key_expr, answer)))

    def _wake(self, sender: int) -> None:
        """Make the channel of `sender` deliver `WAKE`."""
        self._session.put(self._keys[sender], WAKE, allowed_destination=zenoh.Locality.SESSION_LOCAL)

    def _read(self, data: bytes, sender: int) -> Message | Refused:
        try:
            message = decode(data)
        except MessageError as error:
            return Refused(self._keys[sender], str(error))
        if message.sender != sender:
            return Refused(self._keys[sender], f"it claims to come from agent {message.sender}")
        return message

    def _send_hellos(self, neighbours: Iterable[int], handshake: Handshake) -> None:
        for j in neighbours:
            self._session.put(
                f"{self._prefix}/hello/{self._agent}/to/{j}",
                handshake.hello(j, time.time_ns()),
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )

    def _watch(self, neighbour: int) -> None:
        """Turn hellos and the liveliness of a neighbour into events."""
        key = f"{self._prefix}/hello/{neighbour}/to/{self._agent}"

        def on_hello(sample: zenoh.Sample) -> None:
            at = time.time_ns()
            try:
                self.notify(Hello.read(sample.payload.to_bytes(), neighbour, at))
            except MessageError as error:
                self.notify(Refused(key, str(error)))

        def on_liveliness(sample: zenoh.Sample) -> None:
            gone = sample.kind == zenoh.SampleKind.DELETE
            self.notify(Lost(neighbour) if gone else Back(neighbour))

        self._session.declare_subscriber(key, on_hello)
        alive = f"{self._prefix}/alive/{neighbour}"
        self._session.liveliness().declare_subscriber(alive, on_liveliness, history=True)
