"""Runners of a daemon: they drive one agent's loop over Zenoh, on the wall clock or in virtual time."""

import gc
import time
from collections.abc import Callable, Mapping
from functools import partial

from agentd.daemon.inbound import Inbound, Stamps
from dcf_zenoh.assembly import AgentParts
from dcf_zenoh.clock import VirtualClock, WallClock
from dcf_zenoh.errors import NeighbourLost, Silence
from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.handshake import ClockOffset
from dcf_zenoh.messaging.network import Network
from dcf_zenoh.requests import Activate, Agree, Publish, Report, Start, Wait
from dcf_zenoh.runner import Runner

GRACE = 0.25  # s for messages that a dead neighbour sent before it died


def spare_collector() -> None:
    """Exclude the objects that exist now, modules above all, from later garbage collections."""
    gc.collect()
    gc.freeze()


class WallRunner(Runner):
    """Runner in real time.

    Args:
        parts: The agent.
        network: Its session.
        offsets: Neighbour -> how far its clock is ahead.
        handle: Carries out an operator's request at a fleet time, in ns, and returns the answer.
        report: Called with each phase of the flight.
    """

    def __init__(
        self,
        parts: AgentParts,
        network: Network,
        offsets: Mapping[int, ClockOffset],
        handle: Callable[[bytes, int], bytes] = lambda _request, _now: b"",
        report: Callable[[Report], None] = lambda _report: None,
    ) -> None:
        super().__init__()
        self._network = network
        self._mailbox = parts.mailbox
        self._handle = handle
        self._report = report
        self._clock = WallClock()
        stamps = Stamps(self._clock.now, offsets, parts.mailbox.limits.sample_time)
        self._inbound = Inbound(network, parts.mailbox, stamps, self._handle_now, self._clock.now)
        if network.start:  # the fleet is already running
            self._clock.start(network.start)

    def publish(self, request: Publish) -> int:
        """Send a message, stamped with the present time."""
        now = self._clock.now()
        self._network.publish(request.message, request.receiver, now)
        return now

    def wait(self, request: Wait) -> int:
        """Wait for messages of living neighbours, or sleep; at most until the request's time."""
        if request.senders:
            self._receive(request)
        else:
            self._sleep(request.until)
        return self._clock.now()

    def activate(self, request: Activate) -> int:
        """Sleep until the activation."""
        self._sleep(request.until)
        return self._clock.now()

    def start(self, request: Start) -> int:
        """Start fleet time, and tell agents that join later when that was."""
        self._clock.start(request.instant)
        self._network.started(request.instant)
        return self._clock.now()

    def report(self, request: Report) -> int:
        """Pass on a phase of the flight."""
        self._report(request)
        return self._clock.now()

    def agree(self, request: Agree) -> int:
        """Wait for a person's consent to the take-off."""
        while not self._inbound.agreed:
            if not self._inbound.events(self._clock.deadline(request.until)) and self._clock.now() >= request.until:
                return -1
        return self._clock.now()

    def _receive(self, request: Wait) -> None:
        until, senders, step, round = request
        inbound, mailbox = self._inbound, self._mailbox
        deadline = self._clock.deadline(until)
        for j in senders:
            while not mailbox.has_received(j, step, round) and j not in mailbox.lost:
                if not inbound.wait(j, deadline) and time.monotonic() >= deadline:
                    for each in senders:
                        inbound.drain(each)
                    self._skip_gaps()
                    return

    def _sleep(self, until: int) -> None:
        """Wait until `until`; handle events meanwhile, and at least once where that time has passed already."""
        self._inbound.events(self._clock.deadline(until))
        while self._clock.now() < until:  # not as long as there are events: they may come as fast as they are handled
            self._inbound.events(self._clock.deadline(until))
        for j in self._mailbox.senders:  # a full channel would hold its sender up
            self._inbound.drain(j)
        self._skip_gaps()  # in asynchronous mode no time-out does that

    def _skip_gaps(self) -> None:
        """Give up missing messages; not before the start, when all messages are received, if late."""
        if self._network.start:
            self._mailbox.skip_gaps()

    def _handle_now(self, request: bytes) -> bytes:
        return self._handle(request, max(0, self._clock.now()) if self._network.start else 0)  # 0 before the start


class VirtualRunner(Runner):
    """Runner in virtual time: as fast as messages come, with the same results as in the simulator.

    Args:
        parts: The agent.
        network: Its session.
        silence: Longest wait for a message, real s.
        patience: The same before the start, where it is longer.
        report: Called with each phase of the flight.
    """

    def __init__(
        self,
        parts: AgentParts,
        network: Network,
        silence: float,
        patience: float,
        report: Callable[[Report], None] = lambda _report: None,
    ) -> None:
        super().__init__()
        self._agent = parts.id
        self._network = network
        self._mailbox = parts.mailbox
        self._silence = silence
        self._patience = patience
        self._report = report
        self._clock = VirtualClock()
        self._inbound = Inbound(network, parts.mailbox, _as_sent)

    def publish(self, request: Publish) -> int:
        """Send a message with the fleet time that it has."""
        self._network.publish(request.message, request.receiver)
        return self._clock.now()

    def wait(self, request: Wait) -> int:
        """Wait for messages, or let time pass.

        Raises:
            NeighbourLost: A neighbour died or failed. In virtual time the run has no result then.
            Silence: No message came for too long.
        """
        _, senders, step, round = request
        if not senders:
            return self._pass_time(request.until)
        within = max(self._silence, self._patience) if step < 0 else self._silence
        missing = partial(self._mailbox.missing_from, senders, step, round)
        self._receive(senders, missing, f"in step {step} round {round}", within)
        return self._clock.now()

    def activate(self, request: Activate) -> int:
        """Wait for the promises of all senders, then let time pass.

        Raises:
            NeighbourLost: A neighbour died or failed. In virtual time the run has no result then.
            Silence: No message came for too long.
        """
        until, senders = request
        if not senders:
            return self._pass_time(until)
        missing = partial(self._mailbox.unpromised, senders, until)
        self._receive(senders, missing, f"at {until * 1e-9:.6f} s", self._silence)
        return self._clock.advance(until)

    def start(self, request: Start) -> int:
        """Start fleet time."""
        self._clock.start(request.instant)
        return self._clock.now()

    def report(self, request: Report) -> int:
        """Pass on a phase of the flight."""
        self._report(request)
        return self._clock.now()

    def agree(self, request: Agree) -> int:  # noqa: ARG002
        """Continue at once: simulated bodies need no consent."""
        return self._clock.now()

    def _pass_time(self, until: int) -> int:
        """Advance the clock; handle an event, so that an agent without in-neighbours can be stopped too."""
        self._inbound.events(0.0)
        return self._clock.advance(until)

    def _receive(
        self, senders: tuple[int, ...], missing: Callable[[], tuple[int, ...]], where: str, within: float
    ) -> None:
        """Receive messages until `missing` names no sender any more.

        Args:
            senders: In-neighbours that count.
            missing: Returns the senders that are waited for.
            where: Place in the run, for error texts.
            within: Longest wait, s.
        """
        mailbox = self._mailbox
        deadline = time.monotonic() + within
        while awaited := missing():
            dead = next((j for j in awaited if j in mailbox.lost), None)
            sender = awaited[0] if dead is None else dead
            if self._inbound.wait(sender, deadline if dead is None else time.monotonic() + GRACE):
                continue
            if dead is not None:
                raise NeighbourLost(f"agent {self._agent}: neighbour {dead} is lost ({mailbox.lost[dead]}) {where}")
            if time.monotonic() >= deadline:
                raise Silence(f"agent {self._agent}: no message from {sender} {where} within {within:g} s")
        for j in senders:
            if mailbox.departed(j) is Last.FAILED:
                raise NeighbourLost(f"agent {self._agent}: neighbour {j} stopped because of an error, seen {where}")


def await_goodbyes(parts: AgentParts, network: Network, timeout: float) -> None:
    """Keep the session open until the neighbours have ended too, at most for `timeout` s.

    Otherwise messages that are still on their way would be lost.
    """
    inbound = Inbound(network, parts.mailbox, _as_sent)
    deadline = time.monotonic() + timeout
    for j in parts.mailbox.senders:
        while not parts.mailbox.departed(j) and j not in parts.mailbox.lost and time.monotonic() < deadline:
            inbound.wait(j, deadline)
            parts.mailbox.skip_gaps()


def _as_sent(message: Message) -> tuple[int, int]:
    """Return the instants at which a message entered its link and was received: in the model, when it was sent."""
    return message.sent, message.sent
