"""All that is sent to one Crazyflie."""

import threading
import time
from typing import Any, NamedTuple

LOOK = 0.05  # s between two looks at what has not been answered


class Awaited(NamedTuple):
    """A packet whose answer has not come: what it is, when it is sent again, in s, and how long that takes, in s."""

    packet: Any
    due: float
    timeout: float


class Outbox:
    """Takes the place of `send_packet` of a Crazyflie of cflib, for cflib itself as well.

    cflib's own has a lock that stays locked for ever when the driver raises an exception, or when the thread that sends
    something again finds it answered that very moment; from then on everybody waits who sends anything. Here nobody
    waits for another: drivers can be called by many threads. And what was not answered is sent again over any link that
    does not do so itself, which cflib leaves undone over UDP and TCP.

    Args:
        crazyflie: cflib's. Its `send_packet` is replaced.
        insistent: Send again, whatever the driver says.

    Attributes:
        failure: Why nothing can be sent any more; empty as long as it can.
        platform: What cflib's commanders ask for the version of the protocol.
    """

    def __init__(self, crazyflie: Any, *, insistent: bool) -> None:
        self.failure = ""
        self.platform = crazyflie.platform
        self._crazyflie = crazyflie
        self._insistent = insistent
        self._lock = threading.Lock()  # guards _awaited
        self._awaited: dict[bytes, Awaited] = {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._insist, name="crazyflie-outbox", daemon=True)
        crazyflie.send_packet = self.send_packet
        crazyflie.packet_received.add_callback(self._receive)

    def start(self) -> None:
        """Begin to send again what is not answered."""
        self._thread.start()

    def close(self) -> None:
        """End that; nothing is sent any more."""
        self.failure = self.failure or "closed"
        self._ended.set()

    def send_packet(
        self,
        packet: Any,
        expected_reply: tuple[int, ...] = (),
        resend: bool = False,  # noqa: ARG002 - cflib's
        timeout: float = 0.2,
    ) -> None:
        """Send a packet of cflib's; nothing happens where the link is lost. The radio may take up to 2 s for it.

        Args:
            packet: Of cflib.
            expected_reply: How the data of the answer begins, where one is expected.
            resend: Of no use here.
            timeout: After which it is sent again, in s.
        """
        driver = self._crazyflie.link
        if driver is None or self.failure:
            return
        if expected_reply and (self._insistent or driver.needs_resending):
            with self._lock:
                awaited = Awaited(packet, time.monotonic() + timeout, timeout)
                self._awaited[bytes((packet.header, *expected_reply))] = awaited
        self._send(driver, packet)

    def _send(self, driver: Any, packet: Any) -> None:
        try:
            driver.send_packet(packet)
        except Exception as error:  # of a driver, and of all callbacks of a lost link
            self.failure = self.failure or f"sending failed: {error}"

    def _receive(self, packet: Any) -> None:
        """An answer has come to the question with the longest beginning in common."""
        data = bytes((packet.header,)) + bytes(packet.data)
        with self._lock:
            answered = max((each for each in self._awaited if data.startswith(each)), key=len, default=None)
            if answered is not None:
                del self._awaited[answered]

    def _insist(self) -> None:
        while not self._ended.wait(LOOK):
            now = time.monotonic()
            with self._lock:
                late = {key: each for key, each in self._awaited.items() if now > each.due}
                self._awaited |= {key: each._replace(due=now + each.timeout) for key, each in late.items()}
            driver = self._crazyflie.link
            for each in late.values():
                if driver is not None and not self.failure:
                    self._send(driver, each.packet)
