"""Drives one agent's loop over Zenoh: on the wall clock, or in virtual time."""

import gc
import logging
import time
from collections.abc import Callable, Sequence

from dcf_zenoh.assembly import AgentParts
from dcf_zenoh.clock import VirtualClock, WallClock
from dcf_zenoh.errors import DcfError, NeighbourLost, Silence
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.message import Last, Message
from dcf_zenoh.messaging.network import Lost, Network, Refused, Stop
from dcf_zenoh.requests import Publish, Wait

log = logging.getLogger(__name__)
REFUSALS_LOGGED = 5
GRACE = 0.25  # s for messages that a dead neighbour sent before it died


class Stopped(DcfError):
    """The agent was told to end before its time."""


class Feed:
    """Moves what arrives from the network into the mailbox.

    Args:
        network: Where it comes from.
        mailbox: Where it goes.
        due: Fleet time, in ns, at which a message that is read now counts as there.
    """

    def __init__(self, network: Network, mailbox: Mailbox, due: Callable[[Message], int]) -> None:
        self._network = network
        self._mailbox = mailbox
        self._due = due

    def wait(self, sender: int, deadline: float) -> bool:
        """Take in the next message of `sender`, or events; whether there was any before `deadline`, monotonic s.

        Raises:
            Stopped: An event says stop.
        """
        found = self._network.receive(sender, deadline)
        if found is not None:
            self._take(found)
            return True
        return self.events(0.0)

    def drain(self, sender: int) -> None:
        """Take in all that `sender` has sent and that is here already."""
        while (found := self._network.arrived(sender)) is not None:
            self._take(found)

    def events(self, deadline: float) -> bool:
        """Take in the next event; whether there was one before `deadline`, monotonic s.

        Raises:
            Stopped: It says stop.
        """
        event = self._network.next_event(deadline)
        if isinstance(event, Stop):
            raise Stopped(event.reason)
        if isinstance(event, Lost) and event.agent in self._mailbox.senders:
            self.drain(event.agent)  # it may have said goodbye before
            if not self._mailbox.departed(event.agent):
                self._mailbox.lost[event.agent] = "its liveliness token is gone"
        elif isinstance(event, Refused):
            self._take(event)
        return event is not None

    def _take(self, found: Message | Refused) -> None:
        if isinstance(found, Refused):
            self._mailbox.refused += 1
            if self._mailbox.refused <= REFUSALS_LOGGED:
                log.warning("refused a message on %s: %s", found.key, found.reason)
        else:
            self._mailbox.put(found, self._due(found))


def spare_collector() -> None:
    """Take what is there before the loop starts, modules above all, out of what the garbage collector looks through."""
    gc.collect()
    gc.freeze()


def run_wall(parts: AgentParts, network: Network) -> Last:
    """Run a loop in real time.

    Raises:
        DcfError: Whatever stops the loop.
    """
    clock, mailbox = WallClock(), parts.mailbox
    feed = Feed(network, mailbox, lambda _message: clock.now())

    def hear(request: Wait) -> None:
        """Wait for messages, at most until the request's time; nobody waits for the dead."""
        deadline = clock.deadline(request.until)
        for j in request.senders:
            while not mailbox.knows(j, request.step, request.round) and j not in mailbox.lost:
                if not feed.wait(j, deadline) and time.monotonic() >= deadline:
                    for each in request.senders:
                        feed.drain(each)
                    mailbox.skip_gaps()
                    return

    def sleep(until: int) -> None:
        while clock.now() < until:
            feed.events(clock.deadline(until))

    reply: int | None = None
    while True:
        try:
            request = parts.loop.send(reply)  # type: ignore[arg-type]
        except StopIteration as finished:
            return _done(finished)
        if isinstance(request, Publish):
            reply = clock.now()
            network.publish(request.message, request.receiver, reply)
            continue
        if isinstance(request, Wait):
            hear(request) if request.senders else sleep(request.until)
        else:
            clock.start(request.instant)
        reply = clock.now()


def run_virtual(parts: AgentParts, network: Network, silence: float) -> Last:
    """Run a loop in virtual time: as fast as messages come, with the same results as in the simulator.

    Args:
        parts: The agent.
        network: Its session.
        silence: Real seconds without an awaited message that are an error.

    Raises:
        NeighbourLost: A neighbour died or failed. In virtual time that is no result.
        Silence: A neighbour said nothing for too long.
    """
    clock, mailbox = VirtualClock(), parts.mailbox
    feed = Feed(network, mailbox, lambda message: message.sent)

    def hear(request: Wait) -> None:
        where = f"in step {request.step} round {request.round}"
        deadline = time.monotonic() + silence
        while lacking := mailbox.lacks(request.senders, request.step, request.round):
            dead = next((j for j in lacking if j in mailbox.lost), None)
            sender = lacking[0] if dead is None else dead
            if feed.wait(sender, deadline if dead is None else time.monotonic() + GRACE):
                continue
            if dead is not None:
                raise NeighbourLost(f"agent {parts.id}: neighbour {dead} is lost ({mailbox.lost[dead]}) {where}")
            if time.monotonic() >= deadline:
                raise Silence(f"agent {parts.id}: no message from {sender} {where} within {silence:g} s")
        for j in request.senders:
            if mailbox.departed(j) is Last.FAILED:
                raise NeighbourLost(f"agent {parts.id}: neighbour {j} stopped because of an error, seen {where}")

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
                feed.events(0.0)  # whoever waits for nobody can be stopped too
                clock.advance(request.until)
        reply = clock.now()


def await_goodbyes(parts: AgentParts, network: Network, senders: Sequence[int], timeout: float) -> None:
    """Keep the session open until the neighbours have ended too, so that nobody loses what is on its way."""
    feed = Feed(network, parts.mailbox, lambda message: message.sent)
    deadline = time.monotonic() + timeout
    for j in senders:
        while not parts.mailbox.departed(j) and j not in parts.mailbox.lost and time.monotonic() < deadline:
            feed.wait(j, deadline)


def _done(finished: StopIteration) -> Last:
    last: Last = finished.value
    return last
