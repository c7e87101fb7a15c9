"""The connection to one Crazyflie, by way of cflib."""

import re
import struct
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.outbox import LOOK, Outbox
from plants.crazyflie.connection.uri import is_wireless

STALL = 1.0  # s without a packet end an attempt to connect
CLOSING = 3.0  # s
RESEND = 0.2  # s without an answer to a question
SILENT = 2.0  # s without a packet: the link is lost, whatever its driver says
PROTOCOL_MIN, PROTOCOL_SUPERVISOR = 4, 12

PARAMETERS, LOCALISATION, HIGH_LEVEL, SUPERVISOR, PLATFORM, LINK = 2, 6, 8, 9, 13, 15  # ports
READ, WRITE = 1, 2  # channels of PARAMETERS
COMMAND = 1  # channel of SUPERVISOR
ARM, EMERGENCY_STOP, ECHO = 0x01, 0x03, 0x01
LEGACY_ARM, LEGACY_EMERGENCY_STOP = 1, 3


class Link:
    """One connection: commands out, answers in, and how long ago anything came.

    Args:
        uri: Of the drone.
        cache: Folder for the tables.

    Raises:
        PlantError: The folder cannot be made.

    Attributes:
        commander: Low-level setpoints (cflib's `Commander`).
        high_level: Take-off, going to a point, landing (cflib's `HighLevelCommander`).
        crazyflie: cflib's own object, for what needs more than packets.
    """

    def __init__(self, uri: str, cache: Path) -> None:
        from cflib.crazyflie import Crazyflie  # noqa: PLC0415 - an extra, which others need not have
        from cflib.crazyflie.commander import Commander  # noqa: PLC0415
        from cflib.crazyflie.high_level_commander import HighLevelCommander  # noqa: PLC0415
        from cflib.crtp.crtpstack import CRTPPacket  # noqa: PLC0415

        try:
            cache.mkdir(parents=True, exist_ok=True)  # cflib would stumble where two processes make it at once
        except OSError as error:
            raise PlantError(f"cache {cache}: {error.strerror}") from error
        self._uri = uri
        self._packet = CRTPPacket
        self._heard = time.monotonic()
        self._connected = False
        self._answers: dict[tuple[int, int, bytes], tuple[float, bytes]] = {}
        self._accepted = 0.0
        self._opening: threading.Thread | None = None
        self.crazyflie: Any = Crazyflie(rw_cache=str(cache))
        crazyflie = self.crazyflie
        self._outbox = Outbox(crazyflie, insistent=not is_wireless(uri))
        self.commander: Any = Commander(self._outbox)
        self.high_level: Any = HighLevelCommander(self._outbox)
        crazyflie.packet_received.add_callback(self._on_packet)
        crazyflie.connected.add_callback(self._on_connected)
        crazyflie.connection_failed.add_callback(self._on_failure)
        crazyflie.connection_lost.add_callback(self._on_failure)
        crazyflie.disconnected.add_callback(self._on_disconnected)
        for port, channel, size in ((PARAMETERS, READ, 2), (PARAMETERS, WRITE, 2), (LINK, 0, 9)):
            self._listen(port, channel, size)
        crazyflie.add_port_callback(HIGH_LEVEL, self._on_planner)

    @property
    def silence(self) -> float:
        """Time since anything came, in s."""
        return time.monotonic() - self._heard

    @property
    def lost(self) -> str:
        """Why nothing can be sent any more; empty as long as it can."""
        if self._outbox.failure:
            return self._outbox.failure
        silence = self.silence
        return f"nothing came for {silence:.1f} s" if silence > SILENT else ""

    @property
    def protocol(self) -> int:
        """Version of the drone's protocol."""
        return int(self.crazyflie.platform.get_protocol_version())

    def open(self, deadline: float) -> Generator[float, None, str]:
        """Try to connect; why it failed, or nothing.

        Args:
            deadline: By the monotonic clock, in s.
        """
        self._heard = began = time.monotonic()
        self._opening = threading.Thread(target=self.crazyflie.open_link, args=(self._uri,), daemon=True)
        self._outbox.start()
        self._opening.start()  # a thread, for TCP connects with a time-out of minutes
        while not self._connected:
            if self._outbox.failure:
                return self._outbox.failure
            now = time.monotonic()
            if now >= deadline:
                return f"not connected after {now - began:.1f} s"
            if self.silence > STALL:
                return f"no answer for {STALL:g} s"
            yield LOOK
        yield from patiently(self.crazyflie.link_statistics.latency.stop, CLOSING, "ending cflib's pings")
        return (
            "" if self.protocol >= PROTOCOL_MIN else f"its firmware speaks protocol {self.protocol}, which is too old"
        )

    def close(self) -> None:
        """Release all, within a few seconds. Without cflib's last word, which is to stop the motors."""
        for pause in patiently(self.discard, CLOSING, "closing the link"):
            time.sleep(pause)

    def discard(self) -> None:
        """The same, but it may block for ever."""
        self._outbox.close()
        if self._opening is not None:
            self._opening.join()
        updater = self.crazyflie.param.param_updater
        if updater is not None:  # it sends as long as there is a link, and fails where that goes away meanwhile
            updater.close()
            updater.join(1.0)
        driver, self.crazyflie.link = self.crazyflie.link, None
        if driver is not None:
            driver.close()
        self.crazyflie.close_link()

    def send(self, port: int, channel: int, data: bytes) -> None:
        """Send `data`, at most 30 bytes."""
        packet = self._packet()
        packet.set_header(port, channel)
        packet.data = data
        self._outbox.send_packet(packet)

    def accepted_since(self, instant: float) -> bool:
        """Whether the firmware's planner has accepted an order since an instant of the monotonic clock, in s."""
        return self._accepted > instant

    def arm(self, armed: bool) -> None:
        """Ask for the motors to be armed, or disarmed."""
        if self.protocol >= PROTOCOL_SUPERVISOR:
            self.send(SUPERVISOR, COMMAND, struct.pack("<B?", ARM, armed))
        else:
            self.send(PLATFORM, 0, struct.pack("<B?", LEGACY_ARM, armed))

    def emergency_stop(self) -> None:
        """Ask for the motors to be stopped at once; the drone stays locked until it is restarted."""
        if self.protocol >= PROTOCOL_SUPERVISOR:
            self.send(SUPERVISOR, COMMAND, bytes([EMERGENCY_STOP]))
        else:
            self.send(LOCALISATION, 1, bytes([LEGACY_EMERGENCY_STOP]))

    def has_variable(self, name: str) -> bool:
        """Whether the drone can log ``group.name``."""
        return self.crazyflie.log.toc.get_element_by_complete_name(name) is not None

    def has_parameter(self, name: str) -> bool:
        """Whether the drone has a parameter ``group.name``."""
        return self.crazyflie.param.toc.get_element_by_complete_name(name) is not None

    def subscribe(
        self, name: str, variables: Mapping[str, str], period: int, receive: Callable[[int, dict[str, float]], None]
    ) -> Iterator[float]:
        """Have variables sent periodically.

        Args:
            name: Of the block.
            variables: Names, and the types to send them in; 26 bytes in all.
            period: In ms, a multiple of 10.
            receive: Gets the drone's time in ms and the values, on the thread that receives packets.

        Raises:
            PlantError: The drone has no such variable, or refuses.
        """
        from cflib.crazyflie.log import LogConfig  # noqa: PLC0415

        block = LogConfig(name, period)
        for variable, kind in variables.items():
            block.add_variable(variable, kind)
        block.data_received_cb.add_callback(lambda instant, values, _block: receive(instant, values))
        yield from patiently(lambda: self.crazyflie.log.add_config(block), CLOSING, f"log block {name}")
        yield from patiently(block.start, CLOSING, f"log block {name}")

    def read(self, name: str, within: float = 2.0) -> Generator[float, None, float]:
        """The value of a parameter.

        Raises:
            PlantError: There is none, or the drone does not answer.
        """
        element = self._parameter(name)
        ident = struct.pack("<H", element.ident)
        _, data = yield from self._ask(PARAMETERS, READ, ident, ident, within, f"reading {name}")
        return float(struct.unpack(element.pytype, data[3:])[0])

    def write(self, name: str, value: float, within: float = 2.0) -> Iterator[float]:
        """Set a parameter, and wait until the drone has it.

        Raises:
            PlantError: There is none, or the drone does not answer.
        """
        element = self._parameter(name)
        ident = struct.pack("<H", element.ident)
        number = value if element.pytype in ("<f", "<d", "<e") else int(value)
        yield from self._ask(
            PARAMETERS, WRITE, ident + struct.pack(element.pytype, number), ident, within, f"setting {name}"
        )

    def echo(self, number: int, within: float = 2.0) -> Generator[float, None, float]:
        """Time that a packet takes there and back, in s.

        Raises:
            PlantError: The drone does not answer.
        """
        question = struct.pack("<BQ", ECHO, number)  # cflib answers for those that begin with 0
        sent = time.monotonic()
        came, _ = yield from self._ask(LINK, 0, question, question, within, "an echo")
        return came - sent

    def _parameter(self, name: str) -> Any:
        element = self.crazyflie.param.toc.get_element_by_complete_name(name)
        if element is None:
            raise PlantError(f"{self._uri}: its firmware has no parameter {name}")
        return element

    def _ask(
        self, port: int, channel: int, question: bytes, answer: bytes, within: float, what: str
    ) -> Generator[float, None, tuple[float, bytes]]:
        """When something came back that begins with `answer`, in s, and what; asked again, since UDP loses both."""
        key = (port, channel, answer)
        self._answers.pop(key, None)
        deadline = time.monotonic() + within
        while True:
            self.send(port, channel, question)
            again = time.monotonic() + RESEND
            while time.monotonic() < again:
                if key in self._answers:
                    return self._answers.pop(key)
                if self.lost or time.monotonic() > deadline:
                    raise PlantError(f"{self._uri}: {what}: {self.lost or f'no answer within {within:g} s'}")
                yield LOOK / 5

    def _listen(self, port: int, channel: int, size: int) -> None:
        """Keep the last answer of each kind, which its first `size` bytes tell."""

        def receive(packet: Any) -> None:
            data = bytes(packet.data)
            self._answers[port, channel, data[:size]] = time.monotonic(), data

        self.crazyflie.add_header_callback(receive, port, channel)

    def _on_packet(self, _packet: object) -> None:
        self._heard = time.monotonic()

    def _on_planner(self, packet: Any) -> None:
        if len(packet.data) > 3 and packet.data[3] == 0:  # what was ordered, and an error number
            self._accepted = time.monotonic()

    def _on_connected(self, _uri: str) -> None:
        self._connected = True

    def _on_failure(self, _uri: str, message: str) -> None:
        self._outbox.failure = _first_line(message)

    def _on_disconnected(self, _uri: str) -> None:
        self._outbox.failure = self._outbox.failure or "disconnected"


def patiently(work: Callable[[], object], within: float, what: str) -> Iterator[float]:
    """Do what may block for ever, in a thread of its own; pauses, in s, until it is done.

    Raises:
        PlantError: It is not done in time, or raised an exception.
    """
    problems: list[Exception] = []

    def run() -> None:
        try:
            work()
        except Exception as error:  # handed over
            problems.append(error)

    thread = threading.Thread(target=run, name=what, daemon=True)
    thread.start()
    deadline = time.monotonic() + within
    while thread.is_alive():
        if time.monotonic() > deadline:
            raise PlantError(f"{what}: not done within {within:g} s")
        yield LOOK
    if problems:
        raise PlantError(f"{what}: {problems[0]}") from problems[0]


def _first_line(message: str) -> str:
    """What cflib says of a failure, without its trace."""
    head, *exception = re.split(r"\nException:(?=\S)", message.replace("Couldn't load link driver: ", ""))
    lines = [part.strip().partition("\n")[0] for part in (head, *exception) if part.strip()]
    return ": ".join(lines) or "no reason given"
