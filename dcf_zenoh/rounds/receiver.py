"""The receiving half of an exchange: from the mailbox to what an algorithm sees of a round."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from dcf_zenoh.algorithms.algorithm import Inbox
from dcf_zenoh.faults.chain import FaultChain
from dcf_zenoh.message import Last, Message, Payload
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.requests import NEVER

_DONE = Last.DONE  # looked up once: that takes longer than all else that is done with a message


@dataclass(slots=True)
class LinkCount:
    """What came over one link in one step, in messages."""

    received: int = 0  # in time for its round; in asynchronous mode: new at an activation
    missing: int = 0  # not there when its round ended
    late: int = 0  # came after its round had ended, or after a newer one
    lost: int = 0  # lost by a fault


class Passed(NamedTuple):
    """What a link did to one message, as the log keeps it. Times in ns of fleet time.

    Attributes:
        sender: Id.
        sequence: Number of the message.
        step: Control step in which it was sent.
        round: Round in which it was sent.
        entered: When it entered the link.
        due: When it was there; -1 if it was lost.
        lost_by: Name of the fault that lost it, or nothing.
    """

    sender: int
    sequence: int
    step: int
    round: int
    entered: int
    due: int
    lost_by: str


Note: TypeAlias = tuple[int, int, int, int, int, int, str]  # a `Passed`, cheaper to make: there is one per message


class _Ear:
    """What is heard of one neighbour.

    Attributes:
        waiting: What has arrived and is not due.
        silence: Rounds in a row without anything.
        count: What came in this step.
        newest: Message of this step; None if there was none.
        there: When that was there, fleet time in ns.
        first_seen: The own round in which it was first there.
        through: Nothing more comes in this step, as the neighbour has said.
    """

    __slots__ = ("count", "first_seen", "newest", "silence", "there", "through", "waiting")

    def __init__(self) -> None:
        self.waiting: list[Delivery] = []
        self.silence = 0
        self.begin(through=False)

    def begin(self, *, through: bool) -> None:
        """Start a step: nothing of an earlier one enters it."""
        self.count = LinkCount()
        self.newest: Message | None = None
        self.there = self.first_seen = -1
        self.through = through


class Receiver:
    """What has come from the neighbours, round by round.

    A message has arrived once the mailbox holds it. When it is consumed, in the order of sending and not before the
    model may know of it, it goes through its link's faults; from its due time on it is there for the algorithm, and in
    between it waits here.

    Args:
        mailbox: Where the runner puts what arrives.
        links: Neighbour -> the faults of the link from it, of the links that have any.
        hold: Let the last payload of the same step stand in for a missing one.
        skip_after_rounds: So many rounds without a message make a neighbour silent: it is not waited for.
        watch: Log also what comes over links without faults.

    Attributes:
        passed: What the links did to messages in this step.
        last_heard: Neighbour -> when something of it was last taken in, fleet time in ns.
        departed: Neighbour -> its goodbye, of those whose goodbye is there.
    """

    def __init__(
        self,
        mailbox: Mailbox,
        links: Mapping[int, FaultChain] | None = None,
        *,
        hold: bool,
        skip_after_rounds: int = 20,
        watch: bool = False,
    ) -> None:
        self._mailbox = mailbox
        self._faults = {} if links is None else links
        self._hold = hold
        self._skip_after_rounds = skip_after_rounds
        self._watch = watch
        self._here: tuple[float, ...] = ()
        self._step = -NEVER
        self._known: defaultdict[int, _Ear] = defaultdict(_Ear)  # all who were ever heard
        self._ears: dict[int, _Ear] = {}  # who is heard in this step
        self._names: Set[Any] = frozenset()  # of the own payload
        self._names_since = 0  # round since which it has had them
        self.departed: dict[int, Last] = {}
        self.passed: list[Note] = []
        self.last_heard: dict[int, int] = {}

    def begin(self, step: int, senders: Iterable[int], here: tuple[float, ...] = ()) -> None:
        """Start a step, in which `senders` are heard, at the position `here`: nothing of an earlier step enters it."""
        self._step = step
        self._here = here
        self._ears = {j: self._known[j] for j in senders}
        for j, ear in self._ears.items():
            ear.begin(through=j in self.departed)
        self._names, self._names_since = frozenset(), 0
        self.passed = []

    def round_end(self, round: int, now: int, deadline: int) -> int:
        """Take in what has arrived up to `round`; when that round ends, fleet time in ns, `now` or later.

        A round ends with the last message that is on its way, or at the `deadline` if one will not come. Nobody waits
        for the silent, the dead, and those who have said that they are through.
        """
        end = now
        for j, ear in self._ears.items():
            arrived = self._mailbox.take(j, self._step, round)
            if arrived:
                self._take(j, ear, arrived)
            due = self._due(ear, round)
            if due is None:
                awaited = not (ear.through or ear.silence >= self._skip_after_rounds or self._mailbox.dead(j))
                due = deadline if awaited else now
            if due > end:  # noqa: PLR1730 - max() takes longer
                end = due
        return end if end <= deadline or end <= now else max(deadline, now)

    def close(self, round: int, now: int) -> None:
        """End a synchronous `round`: hear what is there by `now`, and count it."""
        for j, ear in self._ears.items():
            news = self._hear(j, ear, round, now)
            if news and ear.newest is not None and ear.newest.round == round:
                ear.count.received += 1
            else:
                ear.count.late += news
                ear.count.missing += not ear.through

    def activate(self, round: int, now: int) -> None:
        """Hear, at the activation `round` of this agent, what was there before `now`."""
        for j, ear in self._ears.items():
            self._take(j, ear, self._mailbox.take_before(j, now))
            ear.count.received += self._hear(j, ear, round, now - 1)

    @property
    def links(self) -> dict[int, LinkCount]:
        """Neighbour -> what came from it in this step."""
        return {j: ear.count for j, ear in self._ears.items()}

    @property
    def unmet(self) -> list[tuple[int, str, str]]:
        """Neighbour, fault and what that was to act on and no message over this link had."""
        return [(j, *each) for j, link in self._faults.items() for each in link.unmet]

    def cut_short(self, step: int) -> tuple[dict[int, LinkCount], list[Note]]:
        """What had come in `step` when it broke off; nothing if it had not begun to listen."""
        return (self.links, self.passed) if step == self._step else ({}, [])

    def _take(self, neighbour: int, ear: _Ear, arrived: list[Delivery]) -> None:
        """Lead what has arrived through the faults of its link."""
        faults = self._faults.get(neighbour)
        for delivery in arrived:
            message = delivery.message
            of_the_run = message.step < 0 or message.last >= _DONE  # the start and goodbyes
            if faults is None or of_the_run:
                ear.waiting.append(delivery)
                if self._watch and not of_the_run:
                    self._note(delivery, delivery.due)
            else:
                self._convey(delivery, faults, ear)

    def _convey(self, delivery: Delivery, faults: FaultChain, ear: _Ear) -> None:
        """Lead one message through `faults`."""
        passage = faults.convey(Delivery(delivery.message, delivery.entered, delivery.entered, self._here))
        if not passage.deliveries:
            ear.count.lost += 1
            self._note(delivery, -1, passage.lost_by)
            return
        copies = [each if each.due >= delivery.due else each._replace(due=delivery.due) for each in passage.deliveries]
        for each in copies:
            self._note(delivery, each.due)
        ear.waiting.append(min(copies, key=lambda each: each.due))  # its copies say nothing new

    def _note(self, delivery: Delivery, due: int, lost_by: str = "") -> None:
        message = delivery.message
        self.passed.append(
            (message.sender, message.sequence, message.step, message.round, delivery.entered, due, lost_by)
        )

    def _due(self, ear: _Ear, round: int) -> int | None:
        """When the message of `round` will be there, or the word that it will not come; None if neither will."""
        known = None
        for delivery in ear.waiting:
            message, due = delivery.message, delivery.due
            relevant = message.step == self._step and (message.round == round or message.last)
            if (relevant or message.last >= _DONE) and (known is None or due < known):
                known = due
        return known

    def _hear(self, neighbour: int, ear: _Ear, round: int, now: int) -> bool:
        """Take in what is there by `now`, the newest of which counts; whether it is newer than what was there."""
        later, news, anything = [], False, False
        for delivery in ear.waiting:
            message, due = delivery.message, delivery.due
            if due > now:
                later.append(delivery)
                continue
            anything = anything or message.step >= 0 or self._step < 0  # the start is no sign of life in flight
            if message.last:
                self._end(message, ear)
                continue
            before = ear.newest
            if message.step == self._step and (before is None or message.sequence > before.sequence):
                if news:
                    ear.count.late += 1  # what this one replaces was never seen
                ear.newest, ear.there, ear.first_seen, news = message, due, round, True
            elif before is None or message.sequence != before.sequence:
                ear.count.late += 1
        ear.waiting = later
        if anything:
            self.last_heard[neighbour] = now
            ear.silence = 0
        elif not ear.through:
            ear.silence += 1
        return news

    def _end(self, message: Message, ear: _Ear) -> None:
        """Take in that more will not come in a step, or ever."""
        if message.last >= _DONE:
            self.departed[message.sender] = message.last
        if message.last >= _DONE or message.step == self._step:
            ear.through = True

    @property
    def messages(self) -> list[Message]:
        """The newest message of each neighbour in this step, but of those who have fallen silent."""
        return [
            ear.newest
            for ear in self._ears.values()
            if ear.newest is not None and ear.silence < self._skip_after_rounds
        ]

    def received_at(self, round: int) -> dict[int, int]:
        """Neighbour -> when the message first seen in the own `round` was there, fleet time in ns."""
        return {j: ear.there for j, ear in self._ears.items() if ear.first_seen == round}

    def inbox(self, own: Payload, names: Set[str], round: int, *, stop: bool, synchronous: bool = True) -> Inbox:
        """What the algorithm sees of `round`: fresh payloads, held ones, and who is missing.

        The ages are in rounds: since the message was sent, or in asynchronous mode since it was first there.

        Args:
            own: What the agent itself sent.
            names: Of the entries of its payload.
            round: Its own.
            stop: The iteration is over.
            synchronous: Rounds are in step with those of the neighbours.
        """
        if names != self._names:
            self._names, self._names_since = names, round
        oldest = self._names_since if self._hold else round
        payloads: dict[int, Payload] = {}
        ages: dict[int, int] = {}
        news: list[int] = []
        missing: list[int] = []
        for j, ear in self._ears.items():
            message = ear.newest
            if message is None:
                missing.append(j)
                continue
            since = message.round if synchronous else ear.first_seen
            if since < oldest or not (synchronous or _alike(names, message.payload)):
                missing.append(j)
                continue
            payloads[j] = message.payload
            if since < round:
                ages[j] = round - since
            if ear.first_seen == round:
                news.append(j)
        return Inbox(own, payloads, stop=stop, ages=ages, news=news, missing=tuple(missing))


def _alike(names: Set[str], payload: Payload) -> bool:
    """Whether two agents are in the same phase of an algorithm, as far as their payloads tell."""
    return not names or not payload or not names.isdisjoint(payload)
