"""Asynchronous mode: every agent activates at instants of its own."""

from typing import Any

from dcf_zenoh.algorithms.algorithm import Inbox
from dcf_zenoh.message import Last
from dcf_zenoh.requests import Activate, Loop, Publish, Wait
from dcf_zenoh.rounds.activation import ActivationSchedule
from dcf_zenoh.rounds.exchange import StepExchange
from dcf_zenoh.rounds.synchronous import Synchronous
from dcf_zenoh.spec import Rounds


class Asynchronous:
    """Mode in which a round is an activation, with the freshest message of each neighbour.

    Before the start the fleet agrees in synchronous rounds.

    Args:
        settings: Table ``[exchange]`` of the fleet file.
        schedule: Activation instants of this agent.
    """

    def __init__(self, settings: Rounds, schedule: ActivationSchedule) -> None:
        self._max_rounds = settings.max_rounds
        self._schedule = schedule
        self._before_start = Synchronous(settings)

    def run(self, exchange: StepExchange[Any]) -> Loop[tuple[int, str]]:
        """Exchange messages activation by activation; see `ExchangeMode.run`."""
        if exchange.step < 0:
            return (yield from self._before_start.run(exchange))
        dialogue, agreement, receiver = exchange.dialogue, exchange.agreement, exchange.receiver
        now, until, senders = exchange.now, exchange.until, exchange.neighbourhood.receives_from
        inbox: Inbox | None = None
        stopped_by = ""
        activation = now
        while dialogue.resume(inbox):
            round = dialogue.rounds - 1
            if (end := exchange.computed(now)) > now:
                now = yield Wait(end)
            activation = max(self._schedule.after(activation), now + 1)
            if activation >= until:
                stopped_by, activation = "budget", max(until, now + 1)
            elif round + 1 >= self._max_rounds:
                stopped_by = "rounds"
            # Nothing is sent before the next activation; after the last one, nothing before the next step.
            promise = max(exchange.next_step, activation) if stopped_by else activation
            sent = exchange.messages(round, now, promise)
            for publication in sent.publications:
                now = yield publication
            now = yield Activate(activation, senders)
            receiver.activate(round, now)
            agreement.note_arrived(receiver.messages)
            inbox = exchange.inbox(sent, round, stop=bool(stopped_by), synchronous=False)
        if (end := exchange.computed(now)) > now:
            now = yield Wait(end)
        if not stopped_by:
            promise = max(exchange.next_step, now)
            last = exchange.sender.message(now, exchange.step, dialogue.rounds, last=Last.OF_STEP, promise=promise)
            yield Publish(last)
        return now, stopped_by or "returned"
