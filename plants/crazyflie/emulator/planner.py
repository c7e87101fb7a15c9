"""Planner on board: smooth trajectories for take-off, landing and go-to."""

import enum
import errno
import math
import struct
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint
from plants.crazyflie.model.cascade import POSITION

GROUP_MASK, STOP_PLAN, TAKE_OFF, LAND, GO_TO = 0, 3, 7, 8, 12
REST = np.zeros(4)


class Phase(enum.Enum):
    """State of the planner."""

    IDLE = "idle"  # motors off
    FLYING = "flying"
    LANDING = "landing"


class Curve(NamedTuple):
    """Polynomial of degree 7 in time for x, y, z and yaw, followed by rest at its end.

    Attributes:
        begin: Instant of the beginning, ms.
        duration: Duration, s.
        coefficients: Coefficients for the time since the beginning, shape (8, 4), constant term first; m and rad.
        end: x, y, z, yaw at the end, shape (4,), m and rad.
    """

    begin: int
    duration: float
    coefficients: Array
    end: Array

    def at(self, now: int) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at `now`, ms, shape (4,) each."""
        time = (now - self.begin) * 1e-3
        if time >= self.duration:
            return self.end, REST, REST
        place, rate, second = REST, REST, REST
        for coefficient in self.coefficients[::-1]:
            second = second * time + 2 * rate
            rate = rate * time + place
            place = place * time + coefficient
        return place, rate, second

    def over(self, now: int) -> bool:
        """Return whether the curve has ended at `now`, ms."""
        return (now - self.begin) * 1e-3 >= self.duration


def curve(begin: int, duration: float, start: tuple[Array, Array, Array], end: Array) -> Curve:
    """Return the curve from `start` to rest at `end`, with zero jerk at both ends.

    Args:
        begin: Instant of the beginning, ms.
        duration: Duration, s; at least 1 ms.
        start: Value, first and second derivative at the beginning, shape (4,) each.
        end: Value at the end, shape (4,).
    """
    duration = max(duration, 1e-3)
    place, rate, second = start
    low = np.array([place, rate, second / 2, REST])
    t = duration
    # The terms t^4 .. t^7 correct value and three derivatives that the lower terms reach at the end.
    reached = np.array(
        [
            place + rate * t + second * t**2 / 2,
            rate + second * t,
            second,
            REST,
        ]
    )
    powers = np.arange(4, 8)
    rows = np.array(
        [
            t**powers,
            powers * t ** (powers - 1.0),
            powers * (powers - 1) * t ** (powers - 2.0),
            powers * (powers - 1) * (powers - 2) * t ** (powers - 3.0),
        ]
    )
    wanted = np.array([end, REST, REST, REST])
    high = np.linalg.solve(rows, wanted - reached)
    return Curve(begin, duration, np.concatenate((low, high)), end)


def line(begin: int, duration: float, start: Array, end: Array) -> Curve:
    """Return a straight line at constant velocity, from `start` to `end`, shape (4,) each."""
    duration = max(duration, 1e-3)
    coefficients = np.zeros((8, 4))
    coefficients[0], coefficients[1] = start, (end - start) / duration
    return Curve(begin, duration, coefficients, end)


class Planner:
    """Conversion of high-level commands into setpoints.

    Attributes:
        phase: State of the planner.
        blocked: Commands are refused, since the supervisor does not let the motors run.

    Source: crazyflie-firmware, documentation "High Level Commander": polynomials of degree 7.
    """

    def __init__(self) -> None:
        self.phase = Phase.IDLE
        self.blocked = True
        self._curve: Curve | None = None
        self._here = REST
        self._velocity = REST
        self._groups = 0

    def finished(self, now: int) -> bool:
        """Return whether the plan has ended at `now`, ms, or there is none."""
        return self._curve is None or self._curve.over(now)

    def stop(self) -> None:
        """Discard the plan."""
        self.phase, self._curve = Phase.IDLE, None

    def block(self, blocked: bool) -> None:
        """Refuse commands and discard the plan, or accept commands again."""
        if blocked and not self.blocked:
            self.stop()
        self.blocked = blocked

    def set_state(self, position: Array, velocity: Array, yaw: float) -> None:
        """Set the state from which a plan starts while there is none: position, m, velocity, m/s, and yaw, rad."""
        if self.phase is Phase.IDLE:
            self._here = np.array([*position.tolist(), yaw])
            self._velocity = np.array([*velocity.tolist(), 0.0])

    def setpoint(self, now: int) -> FirmwareSetpoint:
        """Return the setpoint at `now`, ms."""
        if self._curve is None:
            return STOP
        if self.phase is Phase.LANDING and self._curve.over(now):
            self.stop()
            return STOP
        self._here, self._velocity, _ = self._curve.at(now)
        x, y, z, yaw = (float(value) for value in self._here)
        return FirmwareSetpoint(POSITION, (x, y, z, yaw))

    def command(self, data: bytes, now: int) -> int:
        """Execute a command received at `now`, ms; return its error number, 0 for success.

        Raises:
            struct.error: The packet is too short or too long for its command.
        """
        kind, groups, rest = data[0], data[1], data[2:]
        if kind == GROUP_MASK:
            self._groups = groups
        elif kind not in (STOP_PLAN, TAKE_OFF, LAND, GO_TO):
            return errno.ENOEXEC
        elif groups and not groups & self._groups:
            pass  # for other groups
        elif kind == STOP_PLAN:
            self.stop()
        elif self.blocked:
            return errno.EBUSY
        elif kind == GO_TO:
            relative, straight, x, y, z, yaw, duration = struct.unpack("<??5f", rest)
            self._go_to(np.array([x, y, z, yaw]), duration, relative, straight, now)
        else:
            height, yaw, keep_yaw, duration = struct.unpack("<ff?f", rest)
            return self._take_off_or_land(kind, height, None if keep_yaw else yaw, duration, now)
        return 0

    def _take_off_or_land(self, kind: int, height: float, yaw: float | None, duration: float, now: int) -> int:
        if self.phase is not Phase.IDLE and (kind == TAKE_OFF or self.phase is Phase.LANDING):
            return 1
        end = np.array([*self._here[:2], height, self._here[3] if yaw is None else yaw])
        self._curve = curve(now, duration, (self._here, REST, REST), self._shortest(end))
        self.phase = Phase.FLYING if kind == TAKE_OFF else Phase.LANDING
        return 0

    def _go_to(self, end: Array, duration: float, relative: bool, straight: bool, now: int) -> None:
        start = (self._here, self._velocity, REST) if self._curve is None else self._curve.at(now)
        end = self._shortest(end + start[0] if relative else end)
        self._curve = line(now, duration, start[0], end) if straight else curve(now, duration, start, end)
        self.phase = Phase.FLYING

    def _shortest(self, end: Array) -> Array:
        """Return the goal with the equivalent yaw that needs the shortest turn from the present one."""
        turn = math.remainder(float(end[3] - self._here[3]), 2 * math.pi)
        return np.append(end[:3], self._here[3] + turn)
