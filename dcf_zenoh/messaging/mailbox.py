"""Messages that have been received and are not consumed yet, in the order of sending."""

from bisect import insort
from collections import deque
from collections.abc import Iterable

from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.requests import NEVER


class _SenderQueue:
    """Queue of one in-neighbour.

    Attributes:
        incarnation: Incarnation of the sender whose messages are accepted.
        next: Sequence number that continues `ready`; None: the first message may have any number.
        ready: Messages to be consumed.
        ahead: Messages after a gap, with their numbers, ascending.
        complete_to: Step and round up to which messages have been received without a gap.
        promise: Instant before which the sender will send nothing more, ns.
        goodbye: Kind of the sender's goodbye.
        skipped: Numbers given up.
    """

    __slots__ = ("ahead", "complete_to", "goodbye", "incarnation", "next", "promise", "ready", "skipped")

    def __init__(self, incarnation: int = 0, first: int | None = 0) -> None:
        self.incarnation = incarnation
        self.next = first
        self.ready: deque[Delivery] = deque()
        self.ahead: list[tuple[int, Delivery]] = []
        self.complete_to = (-NEVER, 0)
        self.promise = -NEVER
        self.goodbye = Last.NO
        self.skipped: set[int] = set()

    def append(self, delivery: Delivery) -> None:
        """Take in the next message."""
        message = delivery.message
        self.next = message.sequence + 1
        self.promise = max(self.promise, message.promise)
        if not message.last:
            self.complete_to = (message.step, message.round)
        elif message.last is Last.OF_STEP:
            self.complete_to = (message.step, NEVER)
        elif message.last is Last.AWAY:
            self.complete_to = max(self.complete_to, (message.step - 1, NEVER))
            return
        else:
            self.goodbye = message.last
            self.complete_to = (NEVER, 0)
            self.promise = NEVER
        self.ready.append(delivery)


class Mailbox:
    """Mailbox of one agent: the messages of its in-neighbours. Belongs to one thread and one run.

    The messages of a sender are released in the order of their numbers, whatever the order in which a network delivers
    them. Messages for runners alone (`Last.AWAY`) are never released.

    Args:
        senders: The in-neighbours.
        first: Number of their first message; None: they are already running, and any number may be the first.

    Attributes:
        duplicates: Number of messages dropped because their sequence number had already been released.
        overtaken: Number of messages dropped because they came after their number had been given up, or from an
            earlier incarnation.
        refused: Number of arrivals that were no messages.
        lost: Neighbours that died -> how that was noticed.
    """

    def __init__(self, senders: Iterable[int], *, first: int | None = 0) -> None:
        self._queues = {sender: _SenderQueue(first=first) for sender in senders}
        self.duplicates = 0
        self.overtaken = 0
        self.refused = 0
        self.lost: dict[int, str] = {}

    def put(self, message: Message, entered: int, due: int | None = None) -> None:
        """Take in one message.

        Args:
            message: The message.
            entered: When it entered the link, fleet time in ns.
            due: When it was received, fleet time in ns; None: the same instant.
        """
        queue = self._queues[message.sender]
        delivery = Delivery(message, entered, entered if due is None else due)
        if message.sequence == queue.next and message.incarnation == queue.incarnation and not queue.ahead:
            queue.append(delivery)
        else:
            self._sort_in(queue, delivery)

    def _sort_in(self, queue: _SenderQueue, delivery: Delivery) -> None:
        """Take in a message that is not the next of its sender."""
        message = delivery.message
        if message.incarnation != queue.incarnation:
            if message.incarnation < queue.incarnation:
                self.overtaken += 1
                return
            queue = self.restart(message.sender, message.incarnation)
        if queue.next is None:
            queue.next = message.sequence
        if message.sequence == queue.next:
            queue.append(delivery)
            while queue.ahead and queue.ahead[0][0] <= queue.next:
                number, waiting = queue.ahead.pop(0)
                if number == queue.next:
                    queue.append(waiting)
                else:
                    self.duplicates += 1
        elif message.sequence in queue.skipped:
            queue.skipped.discard(message.sequence)
            self.overtaken += 1
        elif message.sequence < queue.next:
            self.duplicates += 1
        else:
            insort(queue.ahead, (message.sequence, delivery), key=lambda entry: entry[0])

    def restart(self, sender: int, incarnation: int) -> _SenderQueue:
        """Begin a new queue for a restarted `sender`; unread messages of its earlier incarnation are dropped."""
        self.lost.pop(sender, None)
        self._queues[sender] = _SenderQueue(incarnation)
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
                queue.skipped.update(range(begin, number))
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
