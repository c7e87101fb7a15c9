"""What has arrived and is not consumed yet, in the order it was sent."""

from bisect import insort
from collections import deque
from collections.abc import Iterable

from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.requests import NEVER

_new = tuple.__new__  # makes a named tuple in two thirds of the time


class _Sender:
    """The queue of one in-neighbour."""

    __slots__ = ("ahead", "farewell", "incarnation", "known", "next", "promise", "ready", "skipped")

    def __init__(self, incarnation: int = 0, first: int | None = 0) -> None:
        self.incarnation = incarnation
        self.next = first  # the sequence number that continues `ready`; None: whatever comes first
        self.ready: deque[Delivery] = deque()
        self.ahead: list[tuple[int, Delivery]] = []  # ascending; arrived before a number that is still missing
        self.known = (-NEVER, 0)  # heard without a gap up to this (step, round)
        self.promise = -NEVER  # will send nothing before this instant
        self.farewell = Last.NO
        self.skipped: set[int] = set()  # numbers given up

    def append(self, delivery: Delivery) -> None:
        message = delivery.message
        self.next = message.sequence + 1
        if message.promise > self.promise:  # noqa: PLR1730 - max() takes longer
            self.promise = message.promise
        if not message.last:
            self.known = (message.step, message.round)
        elif message.last is Last.OF_STEP:
            self.known = (message.step, NEVER)
        elif message.last is Last.AWAY:
            self.known = max(self.known, (message.step - 1, NEVER))
            return
        else:
            self.farewell = message.last
            self.known = (NEVER, 0)
            self.promise = NEVER
        self.ready.append(delivery)


class Mailbox:
    """Messages of the in-neighbours of one agent. Belongs to one thread and one run.

    A sender's messages are released in the order of their numbers, whatever order a network delivers them in. What a
    sender says to runners alone (`Last.AWAY`) is never released.

    Args:
        senders: The in-neighbours.
        first: Number of their first message; None: they are under way, whatever comes first is the beginning.

    Attributes:
        duplicates: Messages dropped because their sequence number was already released.
        overtaken: Messages dropped because they came after their number had been given up, or from an earlier life.
        refused: Arrivals that were no messages.
        lost: Neighbours that died, and how that was noticed.
    """

    def __init__(self, senders: Iterable[int], *, first: int | None = 0) -> None:
        self._senders = {sender: _Sender(first=first) for sender in senders}
        self.duplicates = 0
        self.overtaken = 0
        self.refused = 0
        self.lost: dict[int, str] = {}

    def put(self, message: Message, entered: int, due: int | None = None) -> None:
        """Take in one message.

        Args:
            message: What arrived.
            entered: When it entered the link, fleet time in ns.
            due: When it arrived, if that is another instant.
        """
        sender = self._senders[message.sender]
        delivery = _new(Delivery, (message, entered, entered if due is None else due, ()))
        if message.sequence == sender.next and message.incarnation == sender.incarnation and not sender.ahead:
            sender.append(delivery)
        else:
            self._sort_in(sender, delivery)

    def _sort_in(self, sender: _Sender, delivery: Delivery) -> None:
        """Take in what is not just the next message of `sender`."""
        message = delivery.message
        if message.incarnation != sender.incarnation:
            if message.incarnation < sender.incarnation:
                self.overtaken += 1
                return
            sender = self.welcome(message.sender, message.incarnation)
        if sender.next is None:
            sender.next = message.sequence
        if message.sequence == sender.next:
            sender.append(delivery)
            while sender.ahead and sender.ahead[0][0] <= sender.next:
                number, waiting = sender.ahead.pop(0)
                if number == sender.next:
                    sender.append(waiting)
                else:
                    self.duplicates += 1
        elif message.sequence in sender.skipped:
            sender.skipped.discard(message.sequence)
            self.overtaken += 1
        elif message.sequence < sender.next:
            self.duplicates += 1
        else:
            insort(sender.ahead, (message.sequence, delivery), key=lambda entry: entry[0])

    def welcome(self, sender: int, incarnation: int) -> _Sender:
        """Begin anew with `sender`, who was started again; what its earlier life sent and nobody read is gone."""
        self.lost.pop(sender, None)
        self._senders[sender] = _Sender(incarnation)
        return self._senders[sender]

    def incarnation(self, sender: int) -> int:
        """Which life of `sender` is heard."""
        return self._senders[sender].incarnation

    def knows(self, sender: int, step: int, round: int) -> bool:
        """Whether `sender` has been heard up to `round` of `step`: that message, a later one, or its goodbye."""
        return self._senders[sender].known >= (step, round)

    def lacks(self, senders: Iterable[int], step: int, round: int) -> tuple[int, ...]:
        """Those of `senders` who have not been heard so far."""
        need = (step, round)
        return tuple([j for j in senders if self._senders[j].known < need])

    def unpromised(self, senders: Iterable[int], instant: int) -> tuple[int, ...]:
        """Those of `senders` who may still send something before `instant`, ns."""
        return tuple([j for j in senders if self._senders[j].promise < instant])

    def skip_gaps(self) -> None:
        """Give up numbers that have not come, where later ones have (the wall clock does, at a time-out)."""
        for sender in self._senders.values():
            while sender.ahead:
                number, delivery = sender.ahead.pop(0)
                begin = number if sender.next is None else sender.next
                sender.skipped.update(range(begin, number))
                if number >= begin:
                    sender.append(delivery)
                else:
                    self.duplicates += 1

    @property
    def senders(self) -> Iterable[int]:
        """The in-neighbours."""
        return self._senders.keys()

    @property
    def missing(self) -> int:
        """Messages that never came, although later ones did."""
        return sum(len(sender.skipped) for sender in self._senders.values())

    def take(self, sender: int, step: int, round: int) -> list[Delivery]:
        """Consume all that `sender` sent up to `round` of `step`, oldest first."""
        ready = self._senders[sender].ready
        taken = []
        while ready:
            message = ready[0].message
            if message.step > step or (message.step == step and message.round > round):
                break
            taken.append(ready.popleft())
        return taken

    def take_before(self, sender: int, instant: int) -> list[Delivery]:
        """Consume all of `sender` that entered the link before `instant`, ns, oldest first."""
        ready = self._senders[sender].ready
        taken = []
        while ready and ready[0].entered < instant:
            taken.append(ready.popleft())
        return taken

    def dead(self, sender: int) -> str:
        """How it was noticed that `sender` died or failed; empty while it lives. A matter of real time."""
        if sender in self.lost:
            return self.lost[sender]
        return "it stopped because of an error" if self.departed(sender) is Last.FAILED else ""

    def departed(self, sender: int) -> Last:
        """The goodbye of `sender`, as soon as it has arrived; `Last.NO` before.

        That is a matter of real time: what the model may know of it, it learns from `take`.
        """
        return self._senders[sender].farewell
