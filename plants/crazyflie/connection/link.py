"""Connection to one Crazyflie through cflib."""

import re
import struct
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.outbox import POLL, Outbox
from plants.crazyflie.connection.uri import is_wireless

STALL = 1.0  # s without a packet after which an attempt to connect ends
CLOSING = 3.0  # s
RESEND = 0.2  # s without a reply after which a request is sent again
SILENCE_MAX = 2.0  # s without a packet after which the link is lost, even if its driver reports no error
PROTOCOL_MIN, PROTOCOL_SUPERVISOR = 4, 12

PARAMETERS, LOCALISATION, HIGH_LEVEL, SUPERVISOR, PLATFORM, LINK = 2, 6, 8, 9, 13, 15  # ports
READ, WRITE = 1, 2  # channels of PARAMETERS
COMMAND = 1  # channel of SUPERVISOR
ARM, EMERGENCY_STOP, ECHO = 0x01, 0x03, 0x01
LEGACY_ARM, LEGACY_EMERGENCY_STOP = 1, 3


class Link:
    """Connection to one drone: commands, requests with replies, and the time since the last packet.

    Args:
        uri: URI of the drone.
        cache: Folder for the tables.

    Raises:
        PlantError: The folder cannot be created.

    Attributes:
        commander: Low-level setpoints (cflib's `Commander`).
        high_level: Take-off, go-to and landing by the firmware's planner (cflib's `HighLevelCommander`).
        crazyflie: cflib's object, for what needs more than single packets.
    """

    def __init__(self, uri: str, cache: Path) -> None:
        from cflib.crazyflie import Crazyflie  # noqa: PLC0415 - an optional extra
        from cflib.crazyflie.commander import Commander  # noqa: PLC0415
        from cflib.crazyflie.high_level_commander import HighLevelCommander  # noqa: PLC0415
        from cflib.crtp.crtpstack import CRTPPacket  # noqa: PLC0415

        try:
            cache.mkdir(parents=True, exist_ok=True)  # cflib fails when two processes create it at once
        except OSError as error:
            raise PlantError(f"cache {cache}: {error.strerror}") from error
        self._uri = uri
        self._packet = CRTPPacket
        self._received_at = time.monotonic()
        self._connected = False
        self._replies: dict[tuple[int, int, bytes], tuple[float, bytes]] = {}
        self._accepted_at = 0.0
        self._opening: threading.Thread | None = None
        self.crazyflie: Any = Crazyflie(rw_cache=str(cache))
        crazyflie = self.crazyflie
        self._outbox = Outbox(crazyflie, always_resend=not is_wireless(uri))
        self.commander: Any = Commander(self._outbox)
        self.high_level: Any = HighLevelCommander(self._outbox)
        crazyflie.packet_received.add_callback(self._on_packet)
        crazyflie.connected.add_callback(self._on_connected)
        crazyflie.connection_failed.add_callback(self._on_failure)
        crazyflie.connection_lost.add_callback(self._on_failure)
        crazyflie.disconnected.add_callback(self._on_disconnected)
        for port, channel, size in ((PARAMETERS, READ, 2), (PARAMETERS, WRITE, 2), (LINK, 0, 9)):
            self._keep_replies(port, channel, size)
        crazyflie.add_port_callback(HIGH_LEVEL, self._on_planner)

    @property
    def silence(self) -> float:
        """Time since the last packet was received, in s."""
        return time.monotonic() - self._received_at

    @property
    def lost(self) -> str:
        """Reason why the link is lost; empty while it works."""
        if self._outbox.failure:
            return self._outbox.failure
        silence = self.silence
        return f"nothing came for {silence:.1f} s" if silence > SILENCE_MAX else ""

    @property
    def protocol(self) -> int:
        """Protocol version of the drone."""
        return int(self.crazyflie.platform.get_protocol_version())

    def open(self, deadline: float) -> Generator[float, None, str]:
        """Try to connect.

        Args:
            deadline: Instant of the monotonic clock, in s.

        Yields:
            Pauses, in s.

        Returns:
            The reason of the failure; empty on success.
        """
        self._received_at = began = time.monotonic()
        self._opening = threading.Thread(target=self.crazyflie.open_link, args=(self._uri,), daemon=True)
        self._outbox.start()
        self._opening.start()  # in a thread: connecting over TCP can block for minutes
        while not self._connected:
            if self._outbox.failure:
                return self._outbox.failure
            now = time.monotonic()
            if now >= deadline:
                return f"not connected after {now - began:.1f} s"
            if self.silence > STALL:
                return f"no answer for {STALL:g} s"
            yield POLL
        yield from run_blocking(self.crazyflie.link_statistics.latency.stop, CLOSING, "ending cflib's pings")
        return (
            "" if self.protocol >= PROTOCOL_MIN else f"its firmware speaks protocol {self.protocol}, which is too old"
        )

    def close(self) -> None:
        """Release the link within a few seconds, without the zero setpoint by which cflib would stop the motors."""
        for pause in run_blocking(self.discard, CLOSING, "closing the link"):
            time.sleep(pause)

    def discard(self) -> None:
        """Release the link as `close` does, without a time-out: this can block for ever."""
        self._outbox.close()
        if self._opening is not None:
            self._opening.join()
        updater = self.crazyflie.param.param_updater
        if updater is not None:  # its thread sends, and raises if the link disappears meanwhile
            updater.close()
            updater.join(1.0)
        driver, self.crazyflie.link = self.crazyflie.link, None
        if driver is not None:
            driver.close()
        self.crazyflie.close_link()

    def send(self, port: int, channel: int, data: bytes) -> None:
        """Send a packet with `data`, at most 30 bytes."""
        packet = self._packet()
        packet.set_header(port, channel)
        packet.data = data
        self._outbox.send_packet(packet)

    def accepted_since(self, instant: float) -> bool:
        """Return whether the firmware's planner has accepted a command since `instant` (monotonic clock, s)."""
        return self._accepted_at > instant

    def arm(self, armed: bool) -> None:
        """Request arming, or disarming, of the motors."""
        if self.protocol >= PROTOCOL_SUPERVISOR:
            self.send(SUPERVISOR, COMMAND, struct.pack("<B?", ARM, armed))
        else:
            self.send(PLATFORM, 0, struct.pack("<B?", LEGACY_ARM, armed))

    def emergency_stop(self) -> None:
        """Request an immediate stop of the motors; the drone stays locked until it is restarted."""
        if self.protocol >= PROTOCOL_SUPERVISOR:
            self.send(SUPERVISOR, COMMAND, bytes([EMERGENCY_STOP]))
        else:
            self.send(LOCALISATION, 1, bytes([LEGACY_EMERGENCY_STOP]))

    def has_variable(self, name: str) -> bool:
        """Return whether the drone can log ``group.name``."""
        return self.crazyflie.log.toc.get_element_by_complete_name(name) is not None

    def has_parameter(self, name: str) -> bool:
        """Return whether the drone has a parameter ``group.name``."""
        return self.crazyflie.param.toc.get_element_by_complete_name(name) is not None

    def subscribe(
        self, name: str, variables: Mapping[str, str], period: int, receive: Callable[[int, dict[str, float]], None]
    ) -> Iterator[float]:
        """Start a log block: the drone sends variables periodically.

        Args:
            name: Name of the block.
            variables: Name -> type in the packet; at most 26 bytes in all.
            period: Period, in ms, a multiple of 10.
            receive: Called with the drone's time, in ms, and the values, on the thread that receives packets.

        Yields:
            Pauses, in s.

        Raises:
            PlantError: The drone has no such variable, or refuses the block.
        """
        from cflib.crazyflie.log import LogConfig  # noqa: PLC0415

        block = LogConfig(name, period)
        for variable, kind in variables.items():
            block.add_variable(variable, kind)
        block.data_received_cb.add_callback(lambda instant, values, _block: receive(instant, values))
        yield from run_blocking(lambda: self.crazyflie.log.add_config(block), CLOSING, f"log block {name}")
        yield from run_blocking(block.start, CLOSING, f"log block {name}")

    def read(self, name: str, timeout: float = 2.0) -> Generator[float, None, float]:
        """Read a parameter; pauses, in s, until its value is there.

        Raises:
            PlantError: There is no such parameter, or the drone does not answer.
        """
        element = self._parameter(name)
        ident = struct.pack("<H", element.ident)
        _, data = yield from self._request(PARAMETERS, READ, ident, ident, timeout, f"reading {name}")
        return float(struct.unpack(element.pytype, data[3:])[0])

    def write(self, name: str, value: float, timeout: float = 2.0) -> Iterator[float]:
        """Set a parameter; pauses, in s, until the drone confirms it.

        Raises:
            PlantError: There is no such parameter, or the drone does not answer.
        """
        element = self._parameter(name)
        ident = struct.pack("<H", element.ident)
        number = value if element.pytype in ("<f", "<d", "<e") else int(value)
        yield from self._request(
            PARAMETERS, WRITE, ident + struct.pack(element.pytype, number), ident, timeout, f"setting {name}"
        )

    def echo(self, number: int, timeout: float = 2.0) -> Generator[float, None, float]:
        """Measure the round-trip time of a packet, in s.

        Raises:
            PlantError: The drone does not answer.
        """
        request = struct.pack("<BQ", ECHO, number)  # cflib's own pings begin with 0
        sent = time.monotonic()
        received_at, _ = yield from self._request(LINK, 0, request, request, timeout, "an echo")
        return received_at - sent

    def _parameter(self, name: str) -> Any:
        element = self.crazyflie.param.toc.get_element_by_complete_name(name)
        if element is None:
            raise PlantError(f"{self._uri}: its firmware has no parameter {name}")
        return element

    def _request(
        self, port: int, channel: int, request: bytes, reply: bytes, timeout: float, what: str
    ) -> Generator[float, None, tuple[float, bytes]]:
        """Send a request, again and again since UDP can lose both, until data beginning with `reply` is received.

        Returns:
            The instant of the reply on the monotonic clock, in s, and its data.
        """
        key = (port, channel, reply)
        self._replies.pop(key, None)
        deadline = time.monotonic() + timeout
        while True:
            self.send(port, channel, request)
            resend_at = time.monotonic() + RESEND
            while time.monotonic() < resend_at:
                if key in self._replies:
                    return self._replies.pop(key)
                if self.lost or time.monotonic() > deadline:
                    raise PlantError(f"{self._uri}: {what}: {self.lost or f'no answer within {timeout:g} s'}")
                yield POLL / 5

    def _keep_replies(self, port: int, channel: int, size: int) -> None:
        """Store the last reply of each kind; its first `size` bytes identify the kind."""

        def receive(packet: Any) -> None:
            data = bytes(packet.data)
            self._replies[port, channel, data[:size]] = time.monotonic(), data

        self.crazyflie.add_header_callback(receive, port, channel)

    def _on_packet(self, _packet: object) -> None:
        self._received_at = time.monotonic()

    def _on_planner(self, packet: Any) -> None:
        if len(packet.data) > 3 and packet.data[3] == 0:  # the command, and an error number
            self._accepted_at = time.monotonic()

    def _on_connected(self, _uri: str) -> None:
        self._connected = True

    def _on_failure(self, _uri: str, message: str) -> None:
        self._outbox.failure = _first_line(message)

    def _on_disconnected(self, _uri: str) -> None:
        self._outbox.failure = self._outbox.failure or "disconnected"


def run_blocking(work: Callable[[], object], timeout: float, what: str) -> Iterator[float]:
    """Run a call that may block for ever in a thread; pauses, in s, until it returns.

    Raises:
        PlantError: The call does not return in time, or raises an exception.
    """
    errors: list[Exception] = []

    def run() -> None:
        try:
            work()
        except Exception as error:  # raised by the caller's thread below
            errors.append(error)

    thread = threading.Thread(target=run, name=what, daemon=True)
    thread.start()
    deadline = time.monotonic() + timeout
    while thread.is_alive():
        if time.monotonic() > deadline:
            raise PlantError(f"{what}: not done within {timeout:g} s")
        yield POLL
    if errors:
        raise PlantError(f"{what}: {errors[0]}") from errors[0]


def _first_line(message: str) -> str:
    """Return the text of an error of cflib without its trace."""
    head, *exception = re.split(r"\nException:(?=\S)", message.replace("Couldn't load link driver: ", ""))
    lines = [part.strip().partition("\n")[0] for part in (head, *exception) if part.strip()]
    return ": ".join(lines) or "no reason given"
