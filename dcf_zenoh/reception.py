"""The receiving half of an exchange: from the mailbox to what an algorithm sees of a round."""

from collections.abc import Iterable, Set
from dataclasses import dataclass
from typing import Any

from dcf_zenoh.algorithms.algorithm import Inbox
from dcf_zenoh.messaging.mailbox import Delivery, Mailbox
from dcf_zenoh.messaging.message import Last, Message, Payload


@dataclass(slots=True)
class LinkCount:
    """What came over one link in one step, in messages."""

    received: int = 0  # in time for its round
    missing: int = 0  # not there when its round ended
    late: int = 0  # came after its round had ended


class Reception:
    """What has come from the neighbours, round by round.

    A message has arrived once the mailbox holds it; it is there for the algorithm from its due time on. In between
    it waits here: this is where links will delay and lose messages.

    Args:
        mailbox: Where the runner puts what arrives.
        hold: Let the last payload of the same step stand in for a missing one.

    Attributes:
        links: Neighbour -> what came from it in this step.
        last_heard: Neighbour -> when something of it was last there, fleet time in ns.
        departed: Neighbour -> its goodbye, of those whose goodbye is there.
    """

    def __init__(self, mailbox: Mailbox, *, hold: bool) -> None:
        self._mailbox = mailbox
        self._hold = hold
        self._waiting: dict[int, list[Delivery]] = {}  # arrived, not due
        self._step = -2
        self._heard: dict[int, Delivery] = {}  # newest of each neighbour in this step
        self._names: Set[Any] = frozenset()  # of the own payload
        self._names_since = 0  # round since which it has had them
        self._through: set[int] = set()  # neighbours that have said that they are through with this step
        self.departed: dict[int, Last] = {}
        self.links: dict[int, LinkCount] = {}
        self.last_heard: dict[int, int] = {}

    def begin(self, step: int, senders: Iterable[int]) -> None:
        """Start a step, in which `senders` are heard: nothing of an earlier one enters it."""
        self._step = step
        self._heard = {}
        self._through = set(self.departed)
        self._names, self._names_since = frozenset(), 0
        self.links = {j: LinkCount() for j in senders}
        for j in self.links:
            self._waiting.setdefault(j, [])

    def complete_at(self, round: int, now: int) -> int:
        """Take in what has arrived up to `round`; when all of that round's messages are there, ns, `now` or later."""
        end = now
        for j in self.links:
            waiting = self._waiting[j]
            waiting += self._mailbox.take(j, self._step, round)
            for message, due in waiting:
                if due > end and message.round == round and message.step == self._step:
                    end = due
        return end

    def close(self, round: int, now: int) -> None:
        """End `round`: hear what is there by `now`, and count it."""
        for j, link in self.links.items():
            fresh, later = False, []
            for delivery in self._waiting[j]:
                message, due = delivery
                if due > now:
                    later.append(delivery)
                    continue
                self.last_heard[j] = due
                if message.last:
                    self._end(message)
                    continue
                if message.step == self._step:
                    self._heard[j] = delivery
                    fresh = message.round == round
                link.late += not fresh
            self._waiting[j] = later
            link.received += fresh
            link.missing += not fresh and j not in self._through

    def _end(self, message: Message) -> None:
        """Take in that more will not come in a step, or ever."""
        if message.last >= Last.DONE:
            self.departed[message.sender] = message.last
        if message.last >= Last.DONE or message.step == self._step:
            self._through.add(message.sender)

    @property
    def messages(self) -> list[Message]:
        """The newest message of each neighbour in this step."""
        return [message for message, _ in self._heard.values()]

    def arrivals(self, round: int) -> dict[int, int]:
        """Neighbour -> when its message of `round` was there, fleet time in ns."""
        return {j: due for j, (message, due) in self._heard.items() if message.round == round}

    def inbox(self, own: Payload, round: int, *, stop: bool) -> Inbox:
        """What the algorithm sees of `round`: fresh payloads, held ones, and who is missing."""
        if own.keys() != self._names:
            self._names, self._names_since = own.keys(), round
        oldest = self._names_since if self._hold else round
        payloads: dict[int, Payload] = {}
        ages: dict[int, int] = {}
        missing: list[int] = []
        for j in self.links:
            message = self._heard[j].message if j in self._heard else None
            if message is None or message.round < oldest:
                missing.append(j)
                continue
            payloads[j] = message.payload
            if message.round < round:
                ages[j] = round - message.round
        return Inbox(own, payloads, stop=stop, ages=ages, missing=tuple(missing))
