"""What has arrived and is not consumed yet, in the order it was sent."""

from bisect import insort
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from dcf_zenoh.messaging.message import Last, Message
from dcf_zenoh.requests import NEVER


class Delivery(NamedTuple):
    """A message and the fleet time, in ns, at which it is there for the receiver."""

    message: Message
    due: int


class _Sender:
    """The queue of one in-neighbour."""

    __slots__ = ("ahead", "farewell", "known", "next", "ready", "skipped")

    def __init__(self) -> None:
        self.next = 0  # the sequence number that continues `ready`
        self.ready: deque[Delivery] = deque()
        self.ahead: list[tuple[int, Delivery]] = []  # ascending; arrived before a number that is still missing
        self.known = (-2, 0)  # heard without a gap up to this (step, round)
        self.farewell = Last.NO
        self.skipped: set[int] = set()  # numbers given up

    def append(self, delivery: Delivery) -> None:
        message = delivery.message
        self.next = message.sequence + 1
        self.ready.append(delivery)
        if message.last >= Last.DONE:
            self.farewell = message.last
            self.known = (NEVER, 0)
        else:
            self.known = (message.step, NEVER if message.last else message.round)


class Mailbox:
    """Messages of the in-neighbours of one agent. Belongs to one thread and one run.

    A sender's messages are released in the order of their numbers, whatever order a network delivers them in.

    Attributes:
        duplicates: Messages dropped because their sequence number was already released.
        overtaken: Messages dropped because they came after their number had been given up.
        refused: Arrivals that were no messages.
        lost: Neighbours that died, and how that was noticed.
    """

    def __init__(self, senders: Iterable[int]) -> None:
        self._senders = {sender: _Sender() for sender in senders}
        self.duplicates = 0
        self.overtaken = 0
        self.refused = 0
        self.lost: dict[int, str] = {}

    def put(self, message: Message, due: int) -> None:
        """Take in one message."""
        sender = self._senders[message.sender]
        if message.sequence in sender.skipped:
            sender.skipped.discard(message.sequence)
            self.overtaken += 1
        elif message.sequence < sender.next:
            self.duplicates += 1
        elif message.sequence == sender.next:
            sender.append(Delivery(message, due))
            while sender.ahead and sender.ahead[0][0] <= sender.next:
                number, delivery = sender.ahead.pop(0)
                if number == sender.next:
                    sender.append(delivery)
                else:
                    self.duplicates += 1
        else:
            insort(sender.ahead, (message.sequence, Delivery(message, due)), key=lambda entry: entry[0])

    def knows(self, sender: int, step: int, round: int) -> bool:
        """Whether `sender` has been heard up to `round` of `step`: that message, a later one, or its goodbye."""
        return self._senders[sender].known >= (step, round)

    def lacks(self, senders: Iterable[int], step: int, round: int) -> tuple[int, ...]:
        """Those of `senders` who have not been heard so far."""
        need = (step, round)
        return tuple([j for j in senders if self._senders[j].known < need])

    def skip_gaps(self) -> None:
        """Give up numbers that have not come, where later ones have (the wall clock does, at a time-out)."""
        for sender in self._senders.values():
            while sender.ahead:
                number, delivery = sender.ahead.pop(0)
                sender.skipped.update(range(sender.next, number))
                if number >= sender.next:
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
        while ready and (ready[0].message.step, ready[0].message.round) <= (step, round):
            taken.append(ready.popleft())
        return taken

    def departed(self, sender: int) -> Last:
        """The goodbye of `sender`, as soon as it has arrived; `Last.NO` before.

        That is a matter of real time: what the model may know of it, it learns from `take`.
        """
        return self._senders[sender].farewell
