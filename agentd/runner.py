"""Drives one agent's loop over Zenoh: on the wall clock, or in virtual time."""

import logging
import time
from collections.abc import Callable, Sequence

from dcf_zenoh.assembly import AgentParts
from dcf_zenoh.clock import VirtualClock, WallClock
from dcf_zenoh.errors import DcfError, NeighbourLost, Silence
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.message import Last
from dcf_zenoh.messaging.network import Arrived, Event, Lost, Network, Refused, Stop
from dcf_zenoh.requests import Publish, Start, Wait

log = logging.getLogger(__name__)
REFUSALS_LOGGED = 5
GRACE = 0.25  # s for messages that a dead neighbour sent before it died


class Stopped(DcfError):
    """The agent was told to end before its time."""


class Feed:
    """Takes events from the network and puts messages into the mailbox.

    Args:
        network: Where events come from.
        mailbox: Where messages go.
        due: When a message counts as there, in ns of fleet time.
        early: Events that came before the loop started.
    """

    def __init__(
        self, network: Network, mailbox: Mailbox, due: Callable[[Arrived], int], early: Sequence[Event]
    ) -> None:
        self._network = network
        self._mailbox = mailbox
        self._due = due
        for event in early:
            self._handle(event)

    def take(self, timeout: float) -> bool:
        """Handle the next event; whether there was one within `timeout` seconds.

        Raises:
            Stopped: It says stop.
        """
        event = self._network.next_event(timeout)
        if event is not None:
            self._handle(event)
        return event is not None

    def _handle(self, event: Event) -> None:
        if isinstance(event, Arrived):
            self._mailbox.put(event.message, self._due(event))
        elif isinstance(event, Refused):
            self._mailbox.refused += 1
            if self._mailbox.refused <= REFUSALS_LOGGED:
                log.warning("refused a message on %s: %s", event.key, event.error)
        elif isinstance(event, Lost):
            if not self._mailbox.departed(event.agent):
                self._mailbox.lost[event.agent] = "its liveliness token is gone"
        elif isinstance(event, Stop):
            raise Stopped(event.reason)


def run_wall(parts: AgentParts, network: Network, early: Sequence[Event] = ()) -> Last:
    """Run a loop in real time.

    Raises:
        DcfError: Whatever stops the loop.
    """
    clock, mailbox = WallClock(), parts.mailbox
    feed = Feed(network, mailbox, lambda arrived: clock.at(arrived.at), early)

    def wait(request: Wait) -> int:
        while True:
            now = clock.now()
            if request.senders:
                lacking = mailbox.lacks(request.senders, request.step, request.round)
                if not lacking or mailbox.lost and all(j in mailbox.lost for j in lacking):
                    return now
            if now >= request.until:
                if request.senders and not feed.take(0.0):
                    mailbox.skip_gaps()
                    return now
                if not request.senders:
                    return now
                continue
            feed.take(min((request.until - now) * 1e-9, 60.0))

    reply: int | None = None
    while True:
        try:
            request = parts.loop.send(reply)  # type: ignore[arg-type]
        except StopIteration as finished:
            return _done(finished)
        if isinstance(request, Publish):
            reply = clock.now()
            network.publish(request.message._replace(sent=reply), request.receiver)
        elif isinstance(request, Wait):
            reply = wait(request)
        else:
            clock.start(request.instant)
            reply = clock.now()


def run_virtual(parts: AgentParts, network: Network, early: Sequence[Event], silence: float) -> Last:
    """Run a loop in virtual time: as fast as messages come, with the same results as in the simulator.

    Args:
        parts: The agent.
        network: Its session.
        early: Events that came before the loop started.
        silence: Real seconds without an awaited message that are an error.

    Raises:
        NeighbourLost: A neighbour died or failed. In virtual time that is no result.
        Silence: A neighbour said nothing for too long.
    """
    clock, mailbox = VirtualClock(), parts.mailbox
    feed = Feed(network, mailbox, lambda arrived: arrived.message.sent, early)

    def hear(request: Wait) -> None:
        deadline = time.monotonic() + silence
        while lacking := mailbox.lacks(request.senders, request.step, request.round):
            dead = next((j for j in lacking if j in mailbox.lost), None)
            left = deadline - time.monotonic() if dead is None else GRACE
            if feed.take(left):
                continue
            place = f"in step {request.step} round {request.round}"
            if dead is not None:
                raise NeighbourLost(f"agent {parts.id}: neighbour {dead} is lost ({mailbox.lost[dead]}) {place}")
            if time.monotonic() >= deadline:
                raise Silence(f"agent {parts.id}: no message from {lacking[0]} {place} within {silence:g} s")
        for j in request.senders:
            if mailbox.departed(j) is Last.FAILED:
                raise NeighbourLost(f"agent {parts.id}: neighbour {j} stopped because of an error, before {_place(request)}")

    def _place(request: Wait) -> str:
        return f"step {request.step} round {request.round}"

    reply: int | None = None
    while True:
        try:
            request = parts.loop.send(reply)  # type: ignore[arg-type]
        except StopIteration as finished:
            return _done(finished)
        if isinstance(request, Publish):
            network.publish(request.message, request.receiver)
        elif isinstance(request, Wait):
            if request.senders:
                hear(request)
            else:
                clock.advance(request.until)
        reply = clock.now()


def _done(finished: StopIteration) -> Last:
    last: Last = finished.value
    return last


def await_goodbyes(parts: AgentParts, network: Network, senders: Sequence[int], timeout: float) -> None:
    """Keep the session open until the neighbours have ended too, so that nobody loses what is on its way."""
    feed = Feed(network, parts.mailbox, lambda arrived: arrived.message.sent, ())
    deadline = time.monotonic() + timeout
    while any(not parts.mailbox.departed(j) and j not in parts.mailbox.lost for j in senders):
        if not feed.take(deadline - time.monotonic()) and time.monotonic() >= deadline:
            return
