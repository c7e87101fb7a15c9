"""Reading from the network: messages into an agent's mailbox, events to their handlers."""

import logging
import time
from collections.abc import Callable, Mapping

from dcf_zenoh.errors import MessageError, NetworkError, Stopped
from dcf_zenoh.message import GOODBYE, Message
from dcf_zenoh.messaging.events import Agreed, Back, Command, Lost, Refused, Stop
from dcf_zenoh.messaging.handshake import ClockOffset, Hello
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.network import CHANNEL_SIZE, Network

log = logging.getLogger(__name__)
REFUSALS_LOGGED = 5  # messages, and hellos
EARLY = 100_000_000  # ns by which a step may begin at a sender before it does here, in addition to a control period
STRAGGLE = 50_000_000  # ns; a message that was sent so long after its sender was lost shows that it is back


class Inbound:
    """Reader of one agent's network session.

    Args:
        network: The session.
        mailbox: Mailbox that takes the messages.
        stamp: Message -> when it entered the link and when it was received, fleet time in ns; called when it is read.
        handle: Carries out an operator's request and returns the answer.
        now: Returns fleet time, ns. Then a lost neighbour whose liveliness token or messages come again is not lost any
            more. None, for virtual time: it remains lost, as the messages that were lost meanwhile are an error.

    Attributes:
        agreed: Whether a person has agreed to the take-off.
    """

    def __init__(
        self,
        network: Network,
        mailbox: Mailbox,
        stamp: Callable[[Message], tuple[int, int]],
        handle: Callable[[bytes], bytes] = lambda _request: b"",
        now: Callable[[], int] | None = None,
    ) -> None:
        self._network = network
        self._mailbox = mailbox
        self._stamp = stamp
        self._handle = handle
        self._now = now
        self._lost_at: dict[int, int] = {}  # neighbour -> when its loss was noticed, fleet time in ns
        self.agreed = False
        self._hellos_refused = 0

    def wait(self, sender: int, deadline: float) -> bool:
        """Read the next message of `sender`, or an event; return whether there was any before `deadline`, monotonic s.

        A message that is not news does not count after the deadline: no number of those prolongs a wait.

        Raises:
            Stopped: An event stops the agent.
        """
        found = self._network.receive(sender, deadline)
        if found is not None:
            return self._take(found) or time.monotonic() < deadline
        return self.events(0.0)

    def drain(self, sender: int) -> None:
        """Read the messages of `sender` that have been received so far."""
        for _ in range(CHANNEL_SIZE):  # no more: messages may come as fast as they are read
            if (found := self._network.poll(sender)) is None:
                break
            self._take(found)

    def events(self, deadline: float) -> bool:
        """Handle the next event; return whether there was one before `deadline`, monotonic s.

        Raises:
            Stopped: The event stops the agent.
        """
        event = self._network.next_event(deadline)
        if isinstance(event, Stop):
            raise Stopped(event.reason)
        if isinstance(event, Lost) and event.agent in self._mailbox.senders:
            self.drain(event.agent)  # its goodbye may be among its last messages
            if not self._mailbox.departed(event.agent):
                self._mailbox.lost[event.agent] = "its liveliness token is gone"
                if self._now is not None:
                    self._lost_at[event.agent] = self._now()
        elif isinstance(event, Back):
            if self._now is not None:
                self._found_again(event.agent)
        elif isinstance(event, Refused):
            self._take(event)
        elif isinstance(event, Hello):
            self._answer(event)
        elif isinstance(event, Command):
            event.reply(self._handle(event.request))
        elif isinstance(event, Agreed):
            self.agreed = True
        return event is not None

    def _answer(self, hello: Hello) -> None:
        """Answer a neighbour that came later; after its restart, accept messages of its new incarnation."""
        try:
            self._network.answer(hello)
        except NetworkError as error:
            self._hellos_refused += 1
            if self._hellos_refused <= REFUSALS_LOGGED:
                log.warning("%s", error)
            return
        if hello.sender in self._mailbox.senders:
            self._mailbox.greet(hello.sender, hello.incarnation)

    def _take(self, found: Message | Refused) -> bool:
        """Put a message into the mailbox, or count and log why it is none; return whether it was news."""
        if isinstance(found, Refused):
            self._refuse(found.key, found.reason)
            return False
        try:
            entered, received = self._stamp(found)
            news = self._mailbox.put(found, entered, received)
        except MessageError as error:
            self._refuse(f"the link from agent {found.sender}", str(error))
            return False
        if news and self._lost_at:
            self._heed(found, entered)
        return news

    def _refuse(self, place: str, reason: str) -> None:
        self._mailbox.refused += 1
        if self._mailbox.refused <= REFUSALS_LOGGED:
            log.warning("refused a message on %s: %s", place, reason)

    def _heed(self, message: Message, entered: int) -> None:
        """Take a lost neighbour back whose messages come again, unless they were sent before the loss."""
        j = message.sender
        flows = message.step >= 0 and message.incarnation == self._mailbox.incarnation(j)
        if flows and j in self._lost_at and entered > self._lost_at[j] + STRAGGLE:
            self._found_again(j)

    def _found_again(self, neighbour: int) -> None:
        self._lost_at.pop(neighbour, None)
        self._mailbox.lost.pop(neighbour, None)


class Stamps:
    """Times of messages on the wall clock: when they entered their links, and when they were read.

    A message is read when the loop has time for it, which may be long after it was received. So it enters its link when
    it was sent, by the sender's clock, corrected where that is measurably off. Injected latency counts from there; the
    real latency is part of it.

    Args:
        now: Returns fleet time, ns.
        offsets: Neighbour -> how far its clock is ahead.
        sample_time: Control period, ns; 0: not known, and no message is too early.
    """

    def __init__(self, now: Callable[[], int], offsets: Mapping[int, ClockOffset], sample_time: int = 0) -> None:
        self._now = now
        self._sample_time = sample_time
        self._early = sample_time + EARLY
        self._ahead = {j: offset.significant for j, offset in offsets.items()}
        self._last: dict[int, int] = {}

    def __call__(self, message: Message) -> tuple[int, int]:
        """Return when `message`, read now, entered its link, and now; in order of sending for each sender.

        Raises:
            MessageError: It is of a step that is far from beginning.
        """
        now, sender = self._now(), message.sender
        if message.step * self._sample_time > now + self._early and message.last < GOODBYE:
            raise MessageError(
                f"step {message.step} begins at {message.step * self._sample_time * 1e-9:g} s; it is {now * 1e-9:.3f} s"
            )
        if message.step < 0:  # before the common start
            return now, now
        sent = message.sent - self._ahead.get(sender, 0)
        entered = self._last[sender] = min(now, max(sent, self._last.get(sender, 0)))
        return entered, now
