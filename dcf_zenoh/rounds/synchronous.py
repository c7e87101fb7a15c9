"""Synchronous mode: neighbours go through their rounds in step."""

from typing import Any

from dcf_zenoh.algorithms.algorithm import Inbox
from dcf_zenoh.message import Last
from dcf_zenoh.requests import NEVER, Loop, Publish, Wait
from dcf_zenoh.rounds.exchange import StepExchange
from dcf_zenoh.spec import Rounds, nanoseconds


class Synchronous:
    """Mode in which a round ends with the last message of that round.

    It ends at the round's time-out or at the end of the step's time budget where a message has not been received by
    then.

    Args:
        settings: Table ``[exchange]`` of the fleet file.
    """

    def __init__(self, settings: Rounds) -> None:
        self._timeout = NEVER if settings.round_timeout is None else nanoseconds(settings.round_timeout)
        self._max_rounds = settings.max_rounds
        self._margin = settings.margin or 0

    def run(self, exchange: StepExchange[Any]) -> Loop[tuple[int, str]]:
        """Exchange messages round by round; see `ExchangeMode.run`."""
        dialogue, agreement, receiver = exchange.dialogue, exchange.agreement, exchange.receiver
        step, now, until, senders = exchange.step, exchange.now, exchange.until, exchange.neighbourhood.receives_from
        timeout = self._timeout if step >= 0 else NEVER  # before the start there is time
        inbox: Inbox | None = None
        stopped_by = ""
        while dialogue.resume(inbox):
            round = dialogue.rounds - 1
            sent = exchange.messages(round, now)
            for publication in sent.publications:
                now = yield publication
            deadline = min(until, now + timeout)
            if senders:
                now = yield Wait(deadline, senders, step, round)
            end = receiver.round_end(round, now, deadline)
            if end > now:
                now = yield Wait(end)
            receiver.end_round(round, now)
            if agreement.conclude(dialogue.residual, receiver.messages, round):
                stopped_by = "agreed"
            elif round + 1 >= self._max_rounds:
                stopped_by = "rounds"
            elif now >= until:
                stopped_by = "budget"
            inbox = exchange.inbox(sent, round, stop=bool(stopped_by))
            if step >= 0 and (end := exchange.computed(now)) > now:
                now = yield Wait(end)
        if stopped_by in ("", "budget") or self._margin:  # the neighbours may still wait for this agent
            yield Publish(exchange.sender.message(now, step, dialogue.rounds, last=Last.OF_STEP))
        return now, stopped_by or "returned"
