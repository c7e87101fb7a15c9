"""The autopilot of a real Crazyflie and the emulated drone, both in model time: the same flight each time, and fast.

The autopilot, its setpoints and watchdog, cflib's commanders and the packets are those of a real flight, and so are the
drone's firmware and radio. In place of cflib's threads and its connection, `ModelFlight` moves the packets; in place of
the autopilot's thread it calls `Autopilot.work`.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from cflib.crtp.crtpstack import CRTPPacket

from plants.crazyflie.connection import link as link_module
from plants.crazyflie.connection import outbox
from plants.crazyflie.connection.link import Link
from plants.crazyflie.emulator.crtp import HIGH_LEVEL, LOG, Packet, packet
from plants.crazyflie.emulator.drone import Drone
from plants.crazyflie.emulator.endpoint import Endpoint
from plants.crazyflie.emulator.firmware import Firmware
from plants.crazyflie.emulator.log_blocks import CODES, CREATE, START, UNIT
from plants.crazyflie.emulator.ports import PROTOCOL
from plants.crazyflie.emulator.radio import Radio, RadioConditions
from plants.crazyflie.emulator.truth import Record, Truth, read_truth
from plants.crazyflie.flying import autopilot as autopilot_module
from plants.crazyflie.flying import setpoint_stream, telemetry, watchdog
from plants.crazyflie.flying.autopilot import Autopilot
from plants.crazyflie.flying.bounds import Bounds
from plants.crazyflie.flying.telemetry import HEALTH, HEALTH_PERIOD, LIGHTHOUSE, MOTION, MOTION_PERIOD, Telemetry
from plants.crazyflie.hardware import flight_bounds
from plants.crazyflie.model.vehicle import read
from plants.crazyflie.options import HardwareFlightOptions, WatchdogOptions
from plants.sensing import LIGHTHOUSE as LIGHTHOUSE_SENSOR

MODULES = (link_module, outbox, telemetry, setpoint_stream, watchdog, autopilot_module)  # they read the clock
STEP = 0.0005  # s; least step of model time
FORMATS = {"float": "f", "FP16": "e", "uint16_t": "H"}
BLOCKS = {1: (MOTION, MOTION_PERIOD), 2: (HEALTH | LIGHTHOUSE, HEALTH_PERIOD)}


class Clock:
    """Stands in for the module `time`: model time, in s."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


class Wire(Endpoint):
    """Endpoint in memory."""

    uri = "udp://memory"

    def __init__(self) -> None:
        self.to_drone: list[tuple[float, bytes]] = []
        self.to_client: list[bytes] = []

    def open(self) -> None: ...

    def close(self) -> None: ...

    def sockets(self) -> list[Any]:
        return []

    def receive(self) -> list[tuple[float, bytes]]:
        received, self.to_drone = self.to_drone, []
        return received

    def send(self, wire: bytes) -> None:
        self.to_client.append(wire)


class Sent(NamedTuple):
    """Packet sent to the drone, and its instant, s."""

    at: float
    packet: Packet


class ModelFlight:
    """One drone and its autopilot. Use `model_flight`.

    Attributes:
        sent: All packets to the drone since the last `clear`.
        after_packet: Called after each packet to the drone has been sent, with its number in `sent`, from 0 on.
    """

    needs_resending = False  # as a driver of cflib

    def __init__(self, folder: Path, clock: Clock, truth: Truth, seed: int, phase: float, bounds: Bounds) -> None:
        self._clock = clock
        self._path = folder / "truth.jsonl"
        self.firmware = Firmware(
            read("forster2015"),
            np.zeros(2),
            0.0,
            sensor=LIGHTHOUSE_SENSOR,
            rng=np.random.default_rng(seed),
            truth=truth,
        )
        self.radio = Radio(RadioConditions(), np.random.default_rng(seed))
        self._wire = Wire()
        self._drone = Drone(self.firmware, self.radio, self._wire, 0.0)
        self.sent: list[Sent] = []
        self.after_packet: Callable[[int], None] = lambda number: None
        self.link = Link("udp://memory", folder / "cache")
        self.link.crazyflie.platform._protocolVersion = PROTOCOL
        self.link.crazyflie.link = self
        self.telemetry = Telemetry(self.link)
        self._next_work = phase
        self._period = 1.0 / bounds.rate
        self._subscribe()
        self._working = False
        self.run(2.5)  # the estimator settles
        self.autopilot = Autopilot(self.link, self.telemetry, bounds)
        self.autopilot._thread.is_alive = lambda: True  # type: ignore[method-assign] # `run` takes its place
        self.autopilot.setpoints.halt()
        self._next_work += self.now
        self._working = True

    @property
    def now(self) -> float:
        """Model time, s."""
        return self._clock.now

    @property
    def position(self) -> "np.ndarray[Any, np.dtype[np.float64]]":
        """True position, m."""
        return self.firmware.body.position.copy()

    @property
    def records(self) -> list[Record]:
        """What the drone recorded."""
        return read_truth(self._path)

    def events(self, name: str, since: float = 0.0) -> list[Record]:
        """Recorded events of a name."""
        return [each for each in self.records if each.kind == "event" and each["event"] == name and each.time >= since]

    def clear(self) -> None:
        """Forget the packets that were sent."""
        self.sent = []

    def send_packet(self, sent: Any) -> None:
        """Send a packet of cflib, as its driver."""
        number = len(self.sent)
        wire = bytes((sent.header, *sent.data))
        made = packet(wire)
        assert made is not None
        self.sent.append(Sent(self.now, made))
        self._wire.to_drone.append((self.now, wire))
        self._drone.run(self.now)
        self.after_packet(number)

    def silence(self, duration: float) -> None:
        """Let nothing get through for a while, s; what has been sent already does."""
        self.radio.silence(self.now, duration)

    def run(self, duration: float) -> None:
        """Let model time pass, s."""
        end = self.now + duration
        while self.now < end:
            work = self._next_work if self._working else end
            self._clock.now = min(end, max(work, self.now + STEP), max(self._drone.next, self.now + STEP))
            self._drone.run(self.now)
            received, self._wire.to_client = self._wire.to_client, []
            for wire in received:
                self._receive(wire)
            if self._working and self.now >= self._next_work:
                self._next_work += self._period
                self.autopilot.work()

    def until(self, true: Callable[[], object], within: float) -> None:
        """Let model time pass until something is true."""
        end = self.now + within
        while not true():
            assert self.now < end, f"not so within {within:g} s"
            self.run(0.01)

    def finish(self, phase: Iterator[float], within: float = 30.0) -> None:
        """Run a phase of the autopilot to its end."""
        end = self.now + within
        for pause in phase:
            assert self.now < end, f"the phase does not end within {within:g} s"
            self.run(pause)

    def hover(self, height: float) -> None:
        """Arm, take off, and hover for a second under setpoints."""
        self.finish(self.autopilot.take_off(height))
        self.run(1.0)

    def _subscribe(self) -> None:
        numbers = {each.name: number for number, each in enumerate(self.firmware.log._variables)}
        for block, (variables, period) in BLOCKS.items():
            entries = [struct.pack("<BH", CODES[FORMATS[kind]], numbers[name]) for name, kind in variables.items()]
            self.firmware.log.receive(1, bytes((CREATE, block)) + b"".join(entries), self.firmware.now)
            self.firmware.log.receive(1, bytes((START, block, period // UNIT)), self.firmware.now)

    def _receive(self, wire: bytes) -> None:
        received = packet(wire)
        assert received is not None
        made = CRTPPacket()
        made.set_header(received.port, received.channel)
        made.data = received.data
        self.link.crazyflie.packet_received.call(made)
        if received.port == HIGH_LEVEL:
            self.link._on_planner(made)
        elif received.port == LOG and received.channel == 2:
            variables, _ = BLOCKS[received.data[0]]
            values = struct.unpack("<" + "".join(FORMATS[kind] for kind in variables.values()), received.data[4:])
            instant = int.from_bytes(received.data[1:4], "little")
            receive = self.telemetry._receive_motion if received.data[0] == 1 else self.telemetry._receive_health
            receive(instant, dict(zip(variables, values, strict=True)))


@contextmanager
def model_flight(
    folder: Path,
    *,
    seed: int = 0,
    phase: float = 0.0,
    flight: HardwareFlightOptions | None = None,
    watchdog: WatchdogOptions | None = None,
) -> Iterator[ModelFlight]:
    """A drone on the ground, whose estimator has settled, and its autopilot.

    Args:
        folder: For the truth and cflib's cache.
        seed: Of what it senses.
        phase: Instant of the autopilot's periods after the drone's slots of 10 ms, s.
        flight: Options of the flight.
        watchdog: Options of the watchdog.
    """
    clock = Clock()
    bounds = flight_bounds(flight or HardwareFlightOptions(), watchdog or WatchdogOptions(), 0.2)
    folder.mkdir(parents=True, exist_ok=True)
    with Truth(folder / "truth.jsonl") as truth:
        patches = [patch.object(module, "time", clock) for module in MODULES]
        for each in patches:
            each.start()
        try:
            yield ModelFlight(folder, clock, truth, seed, phase, bounds)
        finally:
            for each in patches:
                each.stop()
