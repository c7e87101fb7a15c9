"""Ports of a drone: dispatch of received packets to the parts of the firmware, and the answers."""

import math
import struct
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from plants.crazyflie.emulator import crtp
from plants.crazyflie.emulator.crtp import Packet
from plants.crazyflie.emulator.firmware import Firmware
from plants.crazyflie.emulator.lighthouse import PERSIST
from plants.crazyflie.emulator.planner import (
    DEFINE,
    GO_TO,
    GO_TO_1,
    GROUP_MASK,
    LAND,
    LAND_AT,
    START,
    START_1,
    STOP_PLAN,
    TAKE_OFF,
    TAKE_OFF_AT,
)
from plants.crazyflie.emulator.setpoints import NAMES, STOP, FirmwareSetpoint, RpytDecoder, generic
from plants.crazyflie.emulator.truth import rounded

Handler: TypeAlias = Callable[[int, bytes], list[Packet]]

PROTOCOL, VERSION, DEVICE = 12, b"dcf-zenoh emulator", b"CF21"
NAME = b"Bitcraze Crazyflie".ljust(30, b"\0")  # tells a client that it may request the protocol version
ECHO, SOURCE = 0, 1  # channels of the port of the link
ARM, RECOVER, EMERGENCY, FEED, BITS, ANSWER = 0x01, 0x02, 0x03, 0x04, 0x0C, 0x80
POSE = 8
# Commands to the planner: names in the truth, and formats of their numbers.
ORDERS = {
    GROUP_MASK: ("group", ""),
    STOP_PLAN: ("stop_plan", ""),
    TAKE_OFF: ("take_off", "<ffxf"),
    LAND: ("land", "<ffxf"),
    GO_TO: ("go_to", "<xx5f"),
    GO_TO_1: ("go_to", "<x5f"),
    TAKE_OFF_AT: ("take_off", "<fxfxf"),
    LAND_AT: ("land", "<fxfxf"),
    DEFINE: ("define_trajectory", "<xBIB"),
    START: ("start_trajectory", "<???Bf"),
    START_1: ("start_trajectory", "<??Bf"),
}


class Ports:
    """Dispatch of packets to the parts of a drone. Malformed and unknown packets have no answer and no effect.

    Commands of clients are recorded in the drone's truth: setpoints by the names of their modes (those with a thrust as
    "roll_pitch_yaw_thrust"), commands to the planner, "arm", "disarm", "recover", "relax", "emergency_stop".

    Args:
        firmware: Firmware of the drone.
    """

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self._thrust = RpytDecoder()
        self._handlers: dict[int, Handler] = {
            crtp.LINK: self._link,
            crtp.PLATFORM: self._platform,
            crtp.LOG: self._log,
            crtp.PARAM: self._parameters,
            crtp.MEMORY: self._memory,
            crtp.COMMANDER: self._by_thrust,
            crtp.GENERIC: self._generic,
            crtp.HIGH_LEVEL: self._high_level,
            crtp.SUPERVISOR: self._supervise,
            crtp.LOCALISATION: self._localise,
        }

    def receive(self, packet: Packet) -> list[Packet]:
        """Handle a packet; return the answers."""
        handler = self._handlers.get(packet.port)
        if handler is None:
            return []
        try:
            return handler(packet.channel, packet.data)
        except (struct.error, IndexError, ValueError):  # wrong length, or text that is not UTF-8
            return []

    def restart(self) -> None:
        """Switch the drone off and on."""
        self._thrust = RpytDecoder()
        self._firmware.restart()

    def _command(self, name: str, *values: float, **more: bool) -> None:
        """Record a command of a client."""
        self._firmware.truth.write("command", self._firmware.now, command=name, values=rounded(values), **more)

    def _follow(self, setpoint: FirmwareSetpoint, name: str) -> None:
        """Follow a setpoint. One that is not finite stops the motors; the real firmware's reaction is unknown."""
        self._command(name, *setpoint.values)
        finite = all(math.isfinite(value) for value in setpoint.values)
        self._firmware.commander.follow(setpoint if finite else STOP, self._firmware.now)

    def _link(self, channel: int, data: bytes) -> list[Packet]:
        if channel == ECHO:
            return [Packet(crtp.LINK, ECHO, data)]
        if channel != SOURCE:
            return []
        self._firmware.listened = True
        return [Packet(crtp.LINK, SOURCE, NAME)]

    def _log(self, channel: int, data: bytes) -> list[Packet]:
        return self._firmware.log.receive(channel, data, self._firmware.now)

    def _parameters(self, channel: int, data: bytes) -> list[Packet]:
        return self._firmware.parameters.receive(channel, data)

    def _memory(self, channel: int, data: bytes) -> list[Packet]:
        return self._firmware.memories.receive(channel, data)

    def _platform(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 1:
            answers = {0: bytes((PROTOCOL,)), 1: VERSION, 2: DEVICE}
            return [Packet(crtp.PLATFORM, 1, data[:1] + answers.get(data[0], b""))]
        if channel == 0 and data[0] in (ARM, RECOVER):  # protocol versions below 12
            return [Packet(crtp.PLATFORM, 0, data[:1] + self._arm_or_recover(data)[1:])]
        return []

    def _supervise(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            if data[0] == BITS:
                return [Packet(crtp.SUPERVISOR, 0, struct.pack("<BH", BITS | ANSWER, self._firmware.bits))]
            if 1 <= data[0] < BITS:
                return [Packet(crtp.SUPERVISOR, 0, bytes((data[0] | ANSWER, self._firmware.bits >> data[0] - 1 & 1)))]
            return []
        if data[0] in (ARM, RECOVER):
            return [Packet(crtp.SUPERVISOR, 1, self._arm_or_recover(data))]
        self._safeguard(data[0])
        return []

    def _arm_or_recover(self, data: bytes) -> bytes:
        """Arm or recover; return the data of the answer."""
        if data[0] == RECOVER:
            self._command("recover")
            accepted = self._firmware.supervisor.recover()
            return bytes((RECOVER | ANSWER, accepted, accepted))
        wanted = bool(data[1])
        self._command("arm" if wanted else "disarm")
        accepted = self._firmware.arm(wanted)
        return bytes((ARM | ANSWER, accepted, self._firmware.supervisor.armed))

    def _safeguard(self, kind: int) -> None:
        if kind == EMERGENCY:
            self._command("emergency_stop")
            self._firmware.stop()
        elif kind == FEED:
            self._firmware.supervisor.feed(self._firmware.now)

    def _by_thrust(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            self._follow(self._thrust.setpoint(data), "roll_pitch_yaw_thrust")
        return []

    def _generic(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            setpoint = generic(data)
            if setpoint is not None:
                self._follow(setpoint, NAMES[setpoint.mode])
        elif channel == 1 and data[0] == 0:
            self._command("relax")
            self._firmware.commander.relax()
            self._firmware.refresh_planner()
        return []

    def _high_level(self, channel: int, data: bytes) -> list[Packet]:
        error = self._firmware.planner.command(data, self._firmware.now)
        name, layout = ORDERS.get(data[0], ("unknown", ""))
        self._command(name, *struct.unpack(layout, data[2:]) if layout else (), accepted=error == 0)
        return [Packet(crtp.HIGH_LEVEL, channel, data[:3].ljust(3, b"\0") + bytes((error,)))]

    def _localise(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            self._firmware.estimator.correct(np.array(struct.unpack("<3f", data)))
        elif data[0] == POSE:
            self._firmware.estimator.correct(np.array(struct.unpack("<7f", data[1:])[:3]), attitude=True)
        elif data[0] == PERSIST:
            return self._firmware.lighthouse.persist(data)
        elif data[0] in (EMERGENCY, FEED):  # protocol versions below 12
            self._safeguard(data[0])
        return []
