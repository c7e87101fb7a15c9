"""How what comes over Zenoh gets into an agent's mailbox."""

import logging
from collections.abc import Callable, Mapping

from dcf_zenoh.errors import NetworkError, Stopped
from dcf_zenoh.message import Message
from dcf_zenoh.messaging.handshake import ClockOffset, Hello
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.network import Agreed, Command, Lost, Network, Refused, Stop

log = logging.getLogger(__name__)
REFUSALS_LOGGED = 5


class Inbound:
    """Moves what arrives from the network into the mailbox.

    Args:
        network: Where it comes from.
        mailbox: Where it goes.
        stamp: When a message that is read now entered the link, and when it was there; fleet time in ns.
        obey: Does what an operator asks for; its answer.

    Attributes:
        agreed: Whether a person has agreed to the take-off.
    """

    def __init__(
        self,
        network: Network,
        mailbox: Mailbox,
        stamp: Callable[[Message], tuple[int, int]],
        obey: Callable[[bytes], bytes] = lambda _request: b"",
    ) -> None:
        self._network = network
        self._mailbox = mailbox
        self._stamp = stamp
        self._obey = obey
        self.agreed = False

    def wait(self, sender: int, deadline: float) -> bool:
        """Take in the next message of `sender`, or events; whether there was any before `deadline`, monotonic s.

        Raises:
            Stopped: An event says stop.
        """
        found = self._network.receive(sender, deadline)
        if found is not None:
            self._take(found)
            return True
        return self.events(0.0)

    def drain(self, sender: int) -> None:
        """Take in all that `sender` has sent and that is here already."""
        while (found := self._network.poll(sender)) is not None:
            self._take(found)

    def events(self, deadline: float) -> bool:
        """Take in the next event; whether there was one before `deadline`, monotonic s.

        Raises:
            Stopped: It says stop.
        """
        event = self._network.next_event(deadline)
        if isinstance(event, Stop):
            raise Stopped(event.reason)
        if isinstance(event, Lost) and event.agent in self._mailbox.senders:
            self.drain(event.agent)  # it may have said goodbye before
            if not self._mailbox.departed(event.agent):
                self._mailbox.lost[event.agent] = "its liveliness token is gone"
        elif isinstance(event, Refused):
            self._take(event)
        elif isinstance(event, Hello):
            self._welcome(event)
        elif isinstance(event, Command):
            event.reply(self._obey(event.request))
        elif isinstance(event, Agreed):
            self.agreed = True
        return event is not None

    def _welcome(self, hello: Hello) -> None:
        """Answer a neighbour that came later; if it was started again, its new life begins here."""
        if hello.echo:  # it has heard an answer already; two that answer each other's answers never stop
            return
        try:
            self._network.answer(hello)
        except NetworkError as error:
            log.warning("%s", error)
            return
        j = hello.sender
        if j in self._mailbox.senders and hello.incarnation > self._mailbox.incarnation(j):
            self._mailbox.welcome(j, hello.incarnation)

    def _take(self, found: Message | Refused) -> None:
        if isinstance(found, Refused):
            self._mailbox.refused += 1
            if self._mailbox.refused <= REFUSALS_LOGGED:
                log.warning("refused a message on %s: %s", found.key, found.reason)
        else:
            self._mailbox.put(found, *self._stamp(found))


class Stamps:
    """When messages entered their links, on the wall clock.

    A message is read when the loop has time for it, which says little about when it came. So it enters its link when it
    was sent, by the sender's clock, corrected where that is measurably off; injected latency counts from there, and
    the real one is part of it.

    Args:
        now: Fleet time, ns.
        offsets: Neighbour -> by how much its clock is ahead.
    """

    def __init__(self, now: Callable[[], int], offsets: Mapping[int, ClockOffset]) -> None:
        self._now = now
        self._ahead = {j: offset.significant for j, offset in offsets.items()}
        self._last: dict[int, int] = {}

    def __call__(self, message: Message) -> tuple[int, int]:
        """When `message`, read now, entered, and now. Messages of one sender enter in the order of sending."""
        now, sender = self._now(), message.sender
        if message.step < 0:  # before the common start
            return now, now
        entered, before = message.sent - self._ahead.get(sender, 0), self._last.get(sender, 0)
        if entered < before:  # noqa: PLR1730 - max() takes longer
            entered = before
        if entered > now:  # noqa: PLR1730
            entered = now
        self._last[sender] = entered
        return entered, now
