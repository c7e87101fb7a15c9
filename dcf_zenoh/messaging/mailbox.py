"""Messages that have been received and are not consumed yet, in the order of sending."""

from bisect import bisect_right, insort
from collections import Counter, deque
from collections.abc import Iterable
from typing import NamedTuple

from dcf_zenoh.errors import MessageError
from dcf_zenoh.message import GOODBYE, PLACE_MAX, Last, Message
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.requests import NEVER

GAP_MAX = 2**20  # numbers between the last message of a sender and one that is accepted
AHEAD_MAX = 4096  # messages of a sender that wait behind a gap
RESTARTS_MAX = 1000  # incarnations of a sender between the present one and one that is accepted
CONTRADICTIONS = 3  # messages in a row that contradict the head of a link, before the head is given up


class Limits(NamedTuple):
    """Bounds of the messages of a fleet.

    Attributes:
        step: Largest step.
        round: Largest round.
        sample_time: Control period, in ns; 0: not known.
    """

    step: int = PLACE_MAX
    round: int = PLACE_MAX
    sample_time: int = 0


class _Numbers:
    """Set of sequence numbers, kept as intervals: its size is that of their count, not of their lengths."""

    __slots__ = ("_begins", "_ends")

    def __init__(self) -> None:
        self._begins: list[int] = []
        self._ends: list[int] = []

    def __len__(self) -> int:
        return sum(self._ends) - sum(self._begins)

    def add(self, begin: int, end: int) -> None:
        """Add the numbers from `begin`, larger than all before, to `end`, exclusive."""
        if begin < end:
            self._begins.append(begin)
            self._ends.append(end)

    def remove(self, number: int) -> bool:
        """Remove a number; return whether it was there."""
        place = bisect_right(self._begins, number) - 1
        if place < 0 or number >= self._ends[place]:
            return False
        begin, end = self._begins[place], self._ends[place]
        parts = [each for each in ((begin, number), (number + 1, end)) if each[0] < each[1]]
        self._begins[place : place + 1] = [each[0] for each in parts]
        self._ends[place : place + 1] = [each[1] for each in parts]
        return True


class _SenderQueue:
    """Queue of one in-neighbour.

    Attributes:
        incarnation: Incarnation of the sender whose messages are accepted.
        next: Sequence number that continues `ready`; None: the first message may have any number.
        ready: Messages to be consumed.
        ahead: Messages after a gap, with their numbers, ascending.
        complete_to: Step and round up to which messages have been received without a gap.
        newest: Step and round of the last message of the algorithm in `ready` so far.
        promise: Instant before which the sender will send nothing more, ns.
        goodbye: Kind of the sender's goodbye.
        skipped: Numbers given up.
        contrary: Incarnation and number of the last message that contradicted `newest`.
        contradictions: How many did in a row.
    """

    __slots__ = (
        "ahead", "complete_to", "contradictions", "contrary", "goodbye", "incarnation", "newest", "next", "promise",
        "ready", "skipped",
    )  # fmt: skip

    def __init__(self, incarnation: int = 0, first: int | None = 0) -> None:
        self.incarnation = incarnation
        self.next = first
        self.ready: deque[Delivery] = deque()
        self.ahead: list[tuple[int, Delivery]] = []
        self.complete_to = (-NEVER, 0)
        self.newest = (-NEVER, 0)
        self.promise = -NEVER
        self.goodbye = Last.NO
        self.skipped = _Numbers()
        self.contrary = (-1, 0)
        self.contradictions = 0

    def append(self, delivery: Delivery) -> None:
        """Take in the next message. One after a goodbye shows that the goodbye was none."""
        message = delivery.message
        self.next = message.sequence + 1
        if self.goodbye:  # it was none: it must not hold up what comes after it
            self.ready = deque([each for each in self.ready if each.message.last < GOODBYE])
        self.promise = max(self.promise, message.promise)
        if not message.last:
            self.complete_to = self.newest = (message.step, message.round)
            self.goodbye = Last.NO
        elif message.last is Last.OF_STEP:
            self.complete_to = (message.step, NEVER)
            self.newest = (message.step, message.round)
            self.goodbye = Last.NO
        elif message.last is Last.AWAY:
            self.complete_to = max(self.complete_to, (message.step - 1, NEVER))
            return
        else:
            self.goodbye = message.last
            self.complete_to = (NEVER, 0)
            self.promise = NEVER
        self.ready.append(delivery)

    def contradicted_by(self, message: Message) -> bool:
        """Return whether `message`, whose number or incarnation is over, is the latest of several that are news.

        Numbers, steps and rounds of a sender ascend together. So a message that is earlier by its number and later by
        its step shows that this queue took in a message that its sender did not send, or that the sender is another.
        """
        if message.last >= Last.AWAY or (message.step, message.round) <= self.newest:
            return False
        incarnation, number = self.contrary
        continues = message.incarnation == incarnation and message.sequence > number
        self.contradictions = self.contradictions + 1 if continues else 1
        self.contrary = message.incarnation, message.sequence
        return self.contradictions >= CONTRADICTIONS


class Mailbox:
    """Mailbox of one agent: the messages of its in-neighbours. Belongs to one thread and one run.

    The messages of a sender are released in the order of their numbers, whatever the order in which a network delivers
    them. Messages for runners alone (`Last.AWAY`) are never released.

    Args:
        senders: The in-neighbours.
        first: Number of their first message; None: they are already running, and any number may be the first.
        limits: The attribute.

    Attributes:
        limits: What a message can be at most.
        duplicates: Number of messages dropped because their sequence number had already been released.
        overtaken: Number of messages dropped because they came after their number had been given up, or from an
            earlier incarnation.
        refused: Number of receptions that were no messages, or not plausible ones.
        lost: Neighbours that died -> how that was noticed.
        restarts: Neighbour -> how often its queue has begun again, because messages contradicted it.
    """

    def __init__(self, senders: Iterable[int], *, first: int | None = 0, limits: Limits = Limits()) -> None:  # noqa: B008
        self._queues = {sender: _SenderQueue(first=first) for sender in senders}
        self._step_max = limits.step
        self._round_max = limits.round
        self.limits = limits
        self._greeted: dict[int, int] = {}
        self.duplicates = 0
        self.overtaken = 0
        self.refused = 0
        self.lost: dict[int, str] = {}
        self.restarts: Counter[int] = Counter()

    def put(self, message: Message, entered: int, due: int | None = None) -> bool:
        """Take in one message; return whether it is news, not a duplicate or one that was overtaken.

        Args:
            message: The message.
            entered: When it entered the link, fleet time in ns.
            due: When it was received, fleet time in ns; None: the same instant.

        Raises:
            MessageError: The message is not plausible, by the limits and by what was received before. It changed
                nothing.
        """
        queue = self._queues[message.sender]
        if message.step > self._step_max or message.round > self._round_max:
            self._check_place(message)
        delivery = Delivery(message, entered, entered if due is None else due)
        if message.sequence == queue.next and message.incarnation == queue.incarnation and not queue.ahead:
            queue.append(delivery)
            return True
        return self._sort_in(queue, delivery)

    def _check_place(self, message: Message) -> None:
        """Refuse a message whose step or round is beyond the limits.

        Raises:
            MessageError: It is, and not a goodbye.
        """
        step, round = self._step_max, self._round_max
        if message.step > step and not (message.step == NEVER and message.last > Last.AWAY):
            raise MessageError(f"step {message.step}: expected at most {step}")
        if message.round > round:
            raise MessageError(f"round {message.round}: expected at most {round}")

    def _sort_in(self, queue: _SenderQueue, delivery: Delivery) -> bool:
        """Take in a message that is not the next of its sender; return whether it is news."""
        message = delivery.message
        if message.incarnation > queue.incarnation:
            queue = self._begin_incarnation(queue, message)
        elif message.incarnation < queue.incarnation:
            if not queue.contradicted_by(message):
                self.overtaken += 1
                return False
            queue = self._begin_again(message)
        gap = 0 if queue.next is None else message.sequence - queue.next
        if gap < 0 and queue.contradicted_by(message):
            queue, gap = self._begin_again(message), 0
        if gap == 0:
            queue.append(delivery)
            self._append_ahead(queue)
        elif gap < 0:
            given_up = queue.skipped.remove(message.sequence)
            self.overtaken += given_up
            self.duplicates += not given_up
            return False
        elif gap > GAP_MAX:
            raise MessageError(
                f"sequence number {message.sequence} is {gap} after the one expected; at most {GAP_MAX} are accepted"
            )
        elif len(queue.ahead) >= AHEAD_MAX:
            raise MessageError(f"{AHEAD_MAX} messages are waiting for number {queue.next}; no more are accepted")
        else:
            insort(queue.ahead, (message.sequence, delivery), key=lambda entry: entry[0])
        return True

    def _append_ahead(self, queue: _SenderQueue) -> None:
        """Take in the messages after a gap that is closed."""
        assert queue.next is not None
        while queue.ahead and queue.ahead[0][0] <= queue.next:
            number, waiting = queue.ahead.pop(0)
            if number == queue.next:
                queue.append(waiting)
            else:
                self.duplicates += 1

    def _begin_incarnation(self, queue: _SenderQueue, message: Message) -> _SenderQueue:
        """Return a new queue for a sender that has restarted, as a hello, its death or its goodbye shows.

        The first message that is received of a sender may have any incarnation.

        Raises:
            MessageError: Nothing does, or the number is far beyond the one before.
        """
        number, sender = message.incarnation, message.sender
        expected = self._greeted.get(sender, 0) >= number or sender in self.lost or queue.goodbye or queue.next is None
        if not expected:
            raise MessageError(
                f"incarnation {number} without a hello of it; expected {queue.incarnation}, as this sender lives"
            )
        if number - queue.incarnation > RESTARTS_MAX:
            raise MessageError(
                f"incarnation {number}: expected at most {queue.incarnation + RESTARTS_MAX}, {RESTARTS_MAX} more than"
                " before"
            )
        return self._restart(sender, number, None if queue.next is None else 0)

    def _begin_again(self, message: Message) -> _SenderQueue:
        """Return a new queue that begins with a message which contradicts the present one."""
        self.restarts[message.sender] += 1
        return self._restart(message.sender, message.incarnation, message.sequence)

    def greet(self, sender: int, incarnation: int) -> None:
        """Note the incarnation in a hello of `sender`: messages of it are accepted from now on."""
        self._greeted[sender] = incarnation
        if incarnation > self._queues[sender].incarnation:
            self.lost.pop(sender, None)

    def _restart(self, sender: int, incarnation: int, first: int | None) -> _SenderQueue:
        """Begin a new queue for `sender`; unread messages of the earlier one are dropped."""
        self.lost.pop(sender, None)
        self._queues[sender] = _SenderQueue(incarnation, first)
        return self._queues[sender]

    def incarnation(self, sender: int) -> int:
        """Return the incarnation of `sender` whose messages are accepted."""
        return self._queues[sender].incarnation

    def has_received(self, sender: int, step: int, round: int) -> bool:
        """Return whether the message of `round` of `step`, a later one or the goodbye of `sender` has been received."""
        return self._queues[sender].complete_to >= (step, round)

    def missing_from(self, senders: Iterable[int], step: int, round: int) -> tuple[int, ...]:
        """Return those of `senders` from which messages up to `round` of `step` are missing; see `has_received`."""
        needed = (step, round)
        return tuple([j for j in senders if self._queues[j].complete_to < needed])

    def unpromised(self, senders: Iterable[int], instant: int) -> tuple[int, ...]:
        """Return those of `senders` that may still send something before `instant`, ns."""
        return tuple([j for j in senders if self._queues[j].promise < instant])

    def skip_gaps(self) -> None:
        """Give up missing numbers before messages that have been received. For the wall clock, at a time-out."""
        for queue in self._queues.values():
            while queue.ahead:
                number, delivery = queue.ahead.pop(0)
                begin = number if queue.next is None else queue.next
                queue.skipped.add(begin, number)
                if number >= begin:
                    queue.append(delivery)
                else:
                    self.duplicates += 1

    @property
    def senders(self) -> Iterable[int]:
        """The in-neighbours."""
        return self._queues.keys()

    @property
    def missing(self) -> int:
        """Number of messages that never came, although later ones did."""
        return sum(len(queue.skipped) for queue in self._queues.values())

    def take(self, sender: int, step: int, round: int) -> list[Delivery]:
        """Consume the messages of `sender` up to `round` of `step`, oldest first."""
        ready = self._queues[sender].ready
        taken = []
        while ready:
            message = ready[0].message
            if message.step > step or (message.step == step and message.round > round):
                break
            taken.append(ready.popleft())
        return taken

    def take_before(self, sender: int, instant: int) -> list[Delivery]:
        """Consume the messages of `sender` that entered the link before `instant`, ns, oldest first."""
        ready = self._queues[sender].ready
        taken = []
        while ready and ready[0].entered < instant:
            taken.append(ready.popleft())
        return taken

    def dead(self, sender: int) -> str:
        """Return how it was noticed, in real time, that `sender` died or failed; empty while it lives."""
        if sender in self.lost:
            return self.lost[sender]
        return "it stopped because of an error" if self.departed(sender) is Last.FAILED else ""

    def departed(self, sender: int) -> Last:
        """Return the goodbye of `sender` as soon as it has been received in real time; `Last.NO` before.

        The model learns of a goodbye by `take` only.
        """
        return self._queues[sender].goodbye
