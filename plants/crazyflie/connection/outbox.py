"""Sending packets to one Crazyflie, with retransmission."""

import threading
import time
from typing import Any, NamedTuple

POLL = 0.05  # s between two checks of a condition that is waited for


class PendingPacket(NamedTuple):
    """Packet without a reply yet; it is sent again at `due` (monotonic clock, s) and every `timeout` s after that."""

    packet: Any
    due: float
    timeout: float


class Outbox:
    """Replacement of `send_packet` of cflib's Crazyflie object, also for cflib's own calls.

    The original holds a lock that is never released when the driver raises an exception, or when a reply comes at the
    moment of a retransmission; from then on every sender blocks. Here no lock is held while a driver sends: drivers can
    be called from several threads. Requests without a reply are sent again over every link that does not do so itself;
    cflib omits that over UDP and TCP.

    Args:
        crazyflie: cflib's object. Its `send_packet` is replaced.
        always_resend: Send requests again even if the driver declares that it does so itself.

    Attributes:
        failure: Reason why nothing can be sent any more; empty while sending works.
        platform: cflib's platform service; its commanders read the protocol version from it.
    """

    def __init__(self, crazyflie: Any, *, always_resend: bool) -> None:
        self.failure = ""
        self.platform = crazyflie.platform
        self._crazyflie = crazyflie
        self._always_resend = always_resend
        self._lock = threading.Lock()  # guards _awaited
        self._pending: dict[bytes, PendingPacket] = {}
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._resend, name="crazyflie-outbox", daemon=True)
        crazyflie.send_packet = self.send_packet
        crazyflie.packet_received.add_callback(self._receive)

    def start(self) -> None:
        """Start the thread that sends requests again."""
        self._thread.start()

    def close(self) -> None:
        """Stop sending, and the thread."""
        self.failure = self.failure or "closed"
        self._closed.set()

    def send_packet(
        self,
        packet: Any,
        expected_reply: tuple[int, ...] = (),
        resend: bool = False,  # noqa: ARG002 - cflib's
        timeout: float = 0.2,
    ) -> None:
        """Send a packet; on a lost link this does nothing. The radio may block for up to 2 s.

        Args:
            packet: Packet of cflib.
            expected_reply: First data bytes of the reply, if one is expected.
            resend: Ignored; part of cflib's signature.
            timeout: Time without a reply after which the packet is sent again, in s.
        """
        driver = self._crazyflie.link
        if driver is None or self.failure:
            return
        if expected_reply and (self._always_resend or driver.needs_resending):
            with self._lock:
                pending = PendingPacket(packet, time.monotonic() + timeout, timeout)
                self._pending[bytes((packet.header, *expected_reply))] = pending
        self._send(driver, packet)

    def _send(self, driver: Any, packet: Any) -> None:
        try:
            driver.send_packet(packet)
        except Exception as error:  # from the driver, or from a callback for the lost link
            self.failure = self.failure or f"sending failed: {error}"

    def _receive(self, packet: Any) -> None:
        """Remove the pending request whose expected reply is the longest prefix of the packet."""
        data = bytes((packet.header,)) + bytes(packet.data)
        with self._lock:
            answered = max((each for each in self._pending if data.startswith(each)), key=len, default=None)
            if answered is not None:
                del self._pending[answered]

    def _resend(self) -> None:
        while not self._closed.wait(POLL):
            now = time.monotonic()
            with self._lock:
                late = {key: each for key, each in self._pending.items() if now > each.due}
                self._pending |= {key: each._replace(due=now + each.timeout) for key, each in late.items()}
            driver = self._crazyflie.link
            for each in late.values():
                if driver is not None and not self.failure:
                    self._send(driver, each.packet)
