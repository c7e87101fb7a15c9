"""Drives one agent's loop over Zenoh: on the wall clock, or in virtual time."""

import gc
import time
from collections.abc import Callable, Mapping

import numpy as np

from agentd.daemon.inbound import Inbound, Stamps
from dcf_zenoh.assembly import AgentParts
from dcf_zenoh.clock import VirtualClock, WallClock
from dcf_zenoh.errors import NeighbourLost, Silence
from dcf_zenoh.loop.agent import Ending
from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.handshake import ClockOffset
from dcf_zenoh.messaging.network import Network
from dcf_zenoh.requests import Activate, Agree, Loop, Publish, Report, Request, Start, Wait

GRACE = 0.25  # s for messages that a dead neighbour sent before it died


def spare_collector() -> None:
    """Take what is there before the loop starts, modules above all, out of what the garbage collector looks through."""
    gc.collect()
    gc.freeze()


def drive(loop: Loop[Ending], answer: Callable[[Request], int]) -> Ending:
    """Lead a loop to its end: answer what it asks for, and tell it what goes wrong meanwhile.

    Args:
        loop: An agent's.
        answer: Does what a request says; the fleet time then, ns. What it raises reaches the loop at the request, which
            may have something to do before it ends, such as to land.

    Raises:
        DcfError: Whatever stops the loop.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what is no number is refused in words, see `Talk`
            request = next(loop)
            while True:
                try:
                    now = answer(request)
                except Exception as error:
                    request = loop.throw(error)
                else:
                    request = loop.send(now)
    except StopIteration as finished:
        ending: Ending = finished.value
        return ending


def run_wall(
    parts: AgentParts,
    network: Network,
    offsets: Mapping[int, ClockOffset],
    obey: Callable[[bytes, int], bytes] = lambda _request, _now: b"",
    report: Callable[[Report], None] = lambda _report: None,
) -> Ending:
    """Run a loop in real time.

    Args:
        parts: The agent.
        network: Its session.
        offsets: Neighbour -> by how much its clock is ahead.
        obey: Does what an operator asks for at a fleet time, in ns; its answer.
        report: Tells whoever watches of a phase of the flight.

    Raises:
        DcfError: Whatever stops the loop.
    """
    clock, mailbox = WallClock(), parts.mailbox

    def obey_now(request: bytes) -> bytes:
        return obey(request, max(0, clock.now()) if network.start else 0)  # before the start it is no fleet time

    feed = Inbound(network, mailbox, Stamps(clock.now, offsets), obey_now)

    def hear(request: Wait) -> None:
        """Wait for messages, at most until the request's time; nobody waits for the dead."""
        until, senders, step, round = request
        deadline = clock.deadline(until)
        for j in senders:
            while not mailbox.knows(j, step, round) and j not in mailbox.lost:
                if not feed.wait(j, deadline) and time.monotonic() >= deadline:
                    for each in senders:
                        feed.drain(each)
                    mailbox.skip_gaps()
                    return

    def sleep(until: int) -> None:
        while feed.events(clock.deadline(until)) or clock.now() < until:  # who is always late hears events too
            pass
        for j in mailbox.senders:  # whoever sleeps long must not hold the others up
            feed.drain(j)
        mailbox.skip_gaps()  # no time-out does that in asynchronous mode

    def agree(until: int) -> int:
        """Wait for a person's consent."""
        while not feed.agreed:
            if not feed.events(clock.deadline(until)) and clock.now() >= until:
                return -1
        return clock.now()

    def answer(request: Request) -> int:
        if isinstance(request, Publish):
            now = clock.now()
            network.publish(request.message, request.receiver, now)
            return now
        if isinstance(request, Wait):
            if request.senders:
                hear(request)
            else:
                sleep(request.until)
        elif isinstance(request, Activate):
            sleep(request.until)
        elif isinstance(request, Agree):
            return agree(request.until)
        elif isinstance(request, Start):
            clock.start(request.instant)
            network.started(request.instant)
        else:
            report(request)
        return clock.now()

    if network.start:  # the fleet is under way
        clock.start(network.start)
    return drive(parts.loop, answer)


def run_virtual(
    parts: AgentParts,
    network: Network,
    silence: float,
    patience: float,
    report: Callable[[Report], None] = lambda _report: None,
) -> Ending:
    """Run a loop in virtual time: as fast as messages come, with the same results as in the simulator.

    Args:
        parts: The agent.
        network: Its session.
        silence: Real seconds without an awaited message that are an error.
        patience: The same before the start.
        report: Tells whoever watches of a phase of the flight.

    Raises:
        NeighbourLost: A neighbour died or failed. In virtual time that is no result.
        Silence: A neighbour said nothing for too long.
    """
    clock, mailbox = VirtualClock(), parts.mailbox
    feed = Inbound(network, mailbox, _as_sent)

    def lacks(request: Wait | Activate) -> tuple[int, ...]:
        if isinstance(request, Activate):
            return mailbox.unpromised(request.senders, request.until)
        return mailbox.lacks(request.senders, request.step, request.round)

    def hear(request: Wait | Activate) -> None:
        at = f"at {request.until * 1e-9:.6f} s"
        where = at if isinstance(request, Activate) else f"in step {request.step} round {request.round}"
        before_start = isinstance(request, Wait) and request.step < 0
        within = max(silence, patience) if before_start else silence
        deadline = time.monotonic() + within
        while lacking := lacks(request):
            dead = next((j for j in lacking if j in mailbox.lost), None)
            sender = lacking[0] if dead is None else dead
            if feed.wait(sender, deadline if dead is None else time.monotonic() + GRACE):
                continue
            if dead is not None:
                raise NeighbourLost(f"agent {parts.id}: neighbour {dead} is lost ({mailbox.lost[dead]}) {where}")
            if time.monotonic() >= deadline:
                raise Silence(f"agent {parts.id}: no message from {sender} {where} within {within:g} s")
        for j in request.senders:
            if mailbox.departed(j) is Last.FAILED:
                raise NeighbourLost(f"agent {parts.id}: neighbour {j} stopped because of an error, seen {where}")

    def answer(request: Request) -> int:
        if isinstance(request, Publish):
            network.publish(request.message, request.receiver)
        elif isinstance(request, Start):
            clock.start(request.instant)
        elif isinstance(request, Report):
            report(request)
        elif isinstance(request, (Wait, Activate)):
            if request.senders:
                hear(request)
            else:
                feed.events(0.0)  # whoever waits for nobody can be stopped too
            if isinstance(request, Activate) or not request.senders:
                clock.advance(request.until)
        return clock.now()

    return drive(parts.loop, answer)


def await_goodbyes(parts: AgentParts, network: Network, timeout: float) -> None:
    """Keep the session open until the neighbours have ended too, so that nobody loses what is on its way."""
    feed = Inbound(network, parts.mailbox, _as_sent)
    deadline = time.monotonic() + timeout
    for j in parts.mailbox.senders:
        while not parts.mailbox.departed(j) and j not in parts.mailbox.lost and time.monotonic() < deadline:
            feed.wait(j, deadline)
            parts.mailbox.skip_gaps()


def _as_sent(message: Message) -> tuple[int, int]:
    """In the model a message is there when it is sent."""
    return message.sent, message.sent
