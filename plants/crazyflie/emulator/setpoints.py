"""Decoding of clients' setpoints into those of the cascade."""

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

from plants.crazyflie.model.cascade import HOVER, POSITION, STOPPED, TILT_CLIMB, TILT_HEIGHT, TILT_THRUST, VELOCITY

NAMES = {
    STOPPED: "stop",
    VELOCITY: "velocity",
    HOVER: "hover",
    POSITION: "position",
    TILT_HEIGHT: "tilt_height",
    TILT_CLIMB: "tilt_climb",
    TILT_THRUST: "tilt_thrust",
}
THRUST_LEAST, THRUST_MOST = 1000, 60000  # motor commands that a client may request


class FirmwareSetpoint(NamedTuple):
    """Setpoint for the cascade.

    Attributes:
        mode: One of the modes of `model.cascade`.
        values: Three values and a heading or yaw rate, see the modes.
    """

    mode: int
    values: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @property
    def level(self) -> "FirmwareSetpoint":
        """Setpoint without horizontal motion: level, at the same height, climb rate or thrust."""
        third = self.values[2]
        if self.mode in (HOVER, POSITION, TILT_HEIGHT):
            return FirmwareSetpoint(TILT_HEIGHT, (0.0, 0.0, third, 0.0))
        if self.mode in (VELOCITY, TILT_CLIMB):
            return FirmwareSetpoint(TILT_CLIMB, (0.0, 0.0, third, 0.0))
        if self.mode == TILT_THRUST:
            return FirmwareSetpoint(TILT_THRUST, (0.0, 0.0, third, 0.0))
        return STOP


STOP = FirmwareSetpoint(STOPPED)


def generic(data: bytes) -> FirmwareSetpoint | None:
    """Decode a setpoint on the generic port; None if its type is unknown.

    Raises:
        struct.error: The packet is too short or too long for its kind.
    """
    decode = KINDS.get(data[0])
    return None if decode is None else decode(data[1:])


def _velocity(rest: bytes, turn: float = 1.0) -> FirmwareSetpoint:
    vx, vy, vz, rate = struct.unpack("<4f", rest)
    return FirmwareSetpoint(VELOCITY, (vx, vy, vz, turn * math.radians(rate)))


def _hover(rest: bytes, turn: float = 1.0) -> FirmwareSetpoint:
    ahead, left, rate, height = struct.unpack("<4f", rest)
    return FirmwareSetpoint(HOVER, (ahead, left, height, turn * math.radians(rate)))


def _tilt_height(rest: bytes, turn: float = 1.0) -> FirmwareSetpoint:
    roll, pitch, rate, height = struct.unpack("<4f", rest)
    return FirmwareSetpoint(TILT_HEIGHT, _tilt(roll, pitch, turn * rate, height))


def _position(rest: bytes) -> FirmwareSetpoint:
    x, y, z, yaw = struct.unpack("<4f", rest)
    return FirmwareSetpoint(POSITION, (x, y, z, math.radians(yaw)))


def _full_state(rest: bytes) -> FirmwareSetpoint:
    x, y, z, *_, turned = struct.unpack("<9hI", rest[:22])  # mm; the velocities and accelerations in it are not used
    return FirmwareSetpoint(POSITION, (x * 1e-3, y * 1e-3, z * 1e-3, heading(turned)))


def _manual(rest: bytes) -> FirmwareSetpoint | None:
    roll, pitch, rate, thrust, by_rates = struct.unpack("<fffHB", rest)
    return None if by_rates else _by_thrust(roll, pitch, rate, thrust)


BACK = -1.0  # yaw rates before protocol version 9 were clockwise
KINDS: dict[int, Callable[[bytes], FirmwareSetpoint | None]] = {
    0: lambda _: STOP,
    1: lambda rest: _velocity(rest, BACK),
    2: lambda rest: _tilt_height(rest, BACK),
    5: lambda rest: _hover(rest, BACK),
    6: _full_state,
    7: _position,
    8: _velocity,
    9: _tilt_height,
    10: _hover,
    11: _manual,
}


class RpytDecoder:
    """Decoder of setpoints of roll, pitch, yaw rate and thrust; thrust is locked until it has been zero once."""

    def __init__(self) -> None:
        self._locked = True

    def setpoint(self, data: bytes) -> FirmwareSetpoint:
        """Decode a setpoint; without thrust, or while thrust is locked, it stops the motors.

        Raises:
            struct.error: The packet is too short or too long.
        """
        roll, pitch, rate, thrust = struct.unpack("<fffH", data)
        if thrust == 0:
            self._locked = False
        return STOP if self._locked else _by_thrust(roll, pitch, rate, thrust)


def heading(packed: int) -> float:
    """Return the heading, rad, of a unit quaternion compressed to 32 bits.

    Two bits are the index of the largest component; each of the other three has ten bits, a sign and 9 bits of its
    magnitude in units of 1/√2.
    """
    largest, left, parts, square = packed >> 30, packed, [0.0] * 4, 0.0
    for part in (3, 2, 1, 0):
        if part != largest:
            size = (left & 0x1FF) / 0x1FF / math.sqrt(2)
            parts[part] = -size if left & 0x200 else size
            square += size * size
            left >>= 10
    parts[largest] = math.sqrt(max(0.0, 1.0 - square))
    x, y, z, w = parts
    return math.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))


def _by_thrust(roll: float, pitch: float, rate: float, thrust: int) -> FirmwareSetpoint:
    if thrust < THRUST_LEAST:
        return STOP
    return FirmwareSetpoint(TILT_THRUST, _tilt(roll, pitch, rate, min(thrust, THRUST_MOST)))


def _tilt(roll: float, pitch: float, rate: float, third: float) -> tuple[float, float, float, float]:
    """Convert angles from deg, pitch positive nose up (packets), to rad, positive nose down (cascade)."""
    return math.radians(roll), -math.radians(pitch), third, math.radians(rate)
