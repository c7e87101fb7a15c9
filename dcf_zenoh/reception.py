"""The receiving half of an exchange: from the mailbox to what an algorithm sees of a round."""

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from typing import Any, NamedTuple

from dcf_zenoh.algorithms.algorithm import Inbox
from dcf_zenoh.faults.link import Link
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.message import Last, Message, Payload
from dcf_zenoh.requests import NEVER


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


class Reception:
    """What has come from the neighbours, round by round.

    A message has arrived once the mailbox holds it. When it is consumed, in the order of sending and not before the
    model may know of it, it goes through its link's faults; from its due time on it is there for the algorithm, and in
    between it waits here.

    Args:
        mailbox: Where the runner puts what arrives.
        links: Neighbour -> the faults of the link from it, of the links that have any.
        hold: Let the last payload of the same step stand in for a missing one.
        silent_after: So many rounds without a message make a neighbour silent: it is not waited for.
        watch: Log also what comes over links without faults.

    Attributes:
        links: Neighbour -> what came from it in this step.
        passed: What the links did to messages in this step.
        last_heard: Neighbour -> when something of it was last taken in, fleet time in ns.
        departed: Neighbour -> its goodbye, of those whose goodbye is there.
    """

    def __init__(
        self,
        mailbox: Mailbox,
        links: Mapping[int, Link] | None = None,
        *,
        hold: bool,
        silent_after: int = 20,
        watch: bool = False,
    ) -> None:
        self._mailbox = mailbox
        self._faults = {} if links is None else links
        self._hold = hold
        self._silent_after = silent_after
        self._watch = watch
        self._waiting: dict[int, list[Delivery]] = {}  # arrived, not due
        self._silence: dict[int, int] = {}  # rounds in a row without anything
        self._here: tuple[float, ...] = ()
        self._step = -NEVER
        self._heard: dict[int, Delivery] = {}  # newest of each neighbour in this step
        self._first_seen: dict[int, int] = {}  # own round in which that was first there
        self._names: Set[Any] = frozenset()  # of the own payload
        self._names_since = 0  # round since which it has had them
        self._through: set[int] = set()  # neighbours that have said that they are through with this step
        self.departed: dict[int, Last] = {}
        self.links: dict[int, LinkCount] = {}
        self.passed: list[Passed] = []
        self.last_heard: dict[int, int] = {}

    def begin(self, step: int, senders: Iterable[int], here: tuple[float, ...] = ()) -> None:
        """Start a step, in which `senders` are heard, at the position `here`: nothing of an earlier step enters it."""
        self._step = step
        self._here = here
        self._heard = {}
        self._first_seen = {}
        self._through = set(self.departed)
        self._names, self._names_since = frozenset(), 0
        self.links = {j: LinkCount() for j in senders}
        self.passed = []
        for j in self.links:
            self._waiting.setdefault(j, [])
            self._silence.setdefault(j, 0)

    def round_end(self, round: int, now: int, deadline: int) -> int:
        """Take in what has arrived up to `round`; when that round ends, fleet time in ns, `now` or later.

        A round ends with the last message that is on its way, or at the `deadline` if one will not come. Nobody waits
        for the silent, the dead, and those who have said that they are through.
        """
        end = now
        for j in self.links:
            self._take(j, self._mailbox.take(j, self._step, round))
            due = self._due(j, round)
            if due is not None:
                end = max(end, due)
            elif j not in self._through and not self.silent(j) and not self._mailbox.dead(j):
                end = max(end, deadline)
        return min(end, max(deadline, now))

    def close(self, round: int, now: int) -> None:
        """End a synchronous `round`: hear what is there by `now`, and count it."""
        for j, link in self.links.items():
            news = self._hear(j, round, now)
            fresh = news and self._heard[j].message.round == round
            link.received += fresh
            link.late += news and not fresh
            link.missing += not fresh and j not in self._through

    def activate(self, round: int, now: int) -> None:
        """Hear, at the activation `round` of this agent, what was there before `now`."""
        for j, link in self.links.items():
            self._take(j, self._mailbox.take_before(j, now))
            link.received += self._hear(j, round, now - 1)

    def cut_short(self, step: int) -> tuple[dict[int, LinkCount], list[Passed]]:
        """What had come in `step` when it broke off; nothing if it had not begun to listen."""
        return (self.links, self.passed) if step == self._step else ({}, [])

    def silent(self, neighbour: int) -> bool:
        """Whether nothing has been heard of `neighbour` for so many rounds that nobody waits for it."""
        return self._silence[neighbour] >= self._silent_after

    def _take(self, neighbour: int, arrived: list[Delivery]) -> None:
        """Lead what has arrived through the faults of its link."""
        faults, waiting = self._faults.get(neighbour), self._waiting[neighbour]
        for delivery in arrived:
            message = delivery.message
            if message.last is Last.AWAY:
                continue
            if faults is None or message.step < 0 or message.last >= Last.DONE:  # goodbyes are about the run itself
                waiting.append(delivery)
                if self._watch and message.step >= 0 and message.last < Last.DONE:
                    self._note(delivery, delivery.due)
                continue
            passage = faults.convey(delivery._replace(due=delivery.entered, here=self._here))
            if not passage.deliveries:
                self.links[neighbour].lost += 1
                self._note(delivery, -1, passage.lost_by)
            for each in passage.deliveries:
                due = max(each.due, delivery.due)
                waiting.append(each._replace(due=due))
                self._note(delivery, due)

    def _note(self, delivery: Delivery, due: int, lost_by: str = "") -> None:
        message = delivery.message
        self.passed.append(
            Passed(message.sender, message.sequence, message.step, message.round, delivery.entered, due, lost_by)
        )

    def _due(self, neighbour: int, round: int) -> int | None:
        """When the message of `round` will be there, or the word that it will not come; None if neither will."""
        known = None
        for message, _, due, _ in self._waiting[neighbour]:
            relevant = message.step == self._step and (message.round == round or message.last)
            if (relevant or message.last >= Last.DONE) and (known is None or due < known):
                known = due
        return known

    def _hear(self, neighbour: int, round: int, now: int) -> bool:
        """Take in what is there by `now`, the newest of which counts; whether it is newer than what was there."""
        link, later, news, anything = self.links[neighbour], [], False, False
        for delivery in self._waiting[neighbour]:
            message = delivery.message
            if delivery.due > now:
                later.append(delivery)
                continue
            anything = anything or message.step >= min(self._step, 0)  # the start is no sign of life in flight
            if message.last:
                self._end(message)
                continue
            before = self._heard.get(neighbour)
            if message.step == self._step and (before is None or message.sequence > before.message.sequence):
                if news:
                    link.late += 1  # what this one replaces was never seen
                self._heard[neighbour], news = delivery, True
                self._first_seen[neighbour] = round
            elif before is None or message.sequence != before.message.sequence:
                link.late += 1
        self._waiting[neighbour] = later
        if anything:
            self.last_heard[neighbour] = now
            self._silence[neighbour] = 0
        elif neighbour not in self._through:
            self._silence[neighbour] += 1
        return news

    def _end(self, message: Message) -> None:
        """Take in that more will not come in a step, or ever."""
        if message.last >= Last.DONE:
            self.departed[message.sender] = message.last
        if message.last >= Last.DONE or message.step == self._step:
            self._through.add(message.sender)

    @property
    def messages(self) -> list[Message]:
        """The newest message of each neighbour in this step, but of those who have fallen silent."""
        return [delivery.message for j, delivery in self._heard.items() if not self.silent(j)]

    def arrivals(self, round: int) -> dict[int, int]:
        """Neighbour -> when the message first seen in the own `round` was there, fleet time in ns."""
        return {j: self._heard[j].due for j, seen in self._first_seen.items() if seen == round}

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
        for j in self.links:
            if j not in self._heard:
                missing.append(j)
                continue
            message, seen = self._heard[j].message, self._first_seen[j]
            since = message.round if synchronous else seen
            if since < oldest or not (synchronous or _alike(names, message.payload)):
                missing.append(j)
                continue
            payloads[j] = message.payload
            if since < round:
                ages[j] = round - since
            if seen == round:
                news.append(j)
        return Inbox(own, payloads, stop=stop, ages=ages, news=news, missing=tuple(missing))


def _alike(names: Set[str], payload: Payload) -> bool:
    """Whether two agents are in the same phase of an algorithm, as far as their payloads tell."""
    return not names or not payload or not names.isdisjoint(payload)
