"""Planner on board: smooth curves for take-off, landing and go-to, and trajectories from the memory."""

import enum
import errno
import math
import struct
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint
from plants.crazyflie.emulator.trajectories import REST, PolynomialPiece, Trajectory, compressed_pieces, plain_pieces
from plants.crazyflie.model.cascade import POSITION

GROUP_MASK, STOP_PLAN, GO_TO_1, START_1, DEFINE, TAKE_OFF, LAND = 0, 3, 4, 5, 6, 7, 8
TAKE_OFF_AT, LAND_AT, GO_TO, START = 9, 10, 12, 13  # the first two at a velocity
IN_MEMORY, PLAIN, COMPRESSED = 1, 0, 1  # location and types of a trajectory
TRAJECTORIES = 10  # that can be defined
DEFAULT_VELOCITY = 0.5  # m/s, of a take-off or landing that gives none


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
        return PolynomialPiece(self.duration, self.coefficients).at(time)

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


class Defined(NamedTuple):
    """Trajectory that a client has defined.

    Attributes:
        location: Where its pieces are; `IN_MEMORY` is the only place.
        kind: `PLAIN` or `COMPRESSED`.
        offset: First byte of its pieces.
        pieces: Number of its pieces; without meaning in a compressed one.
    """

    location: int
    kind: int
    offset: int
    pieces: int


class Planner:
    """Conversion of high-level commands into setpoints.

    Args:
        memory: Memory of trajectories, which clients change.

    Attributes:
        phase: State of the planner.
        blocked: Commands are refused, since the supervisor does not let the motors run.

    Source: crazyflie-firmware, documentation "High Level Commander": polynomials of degree 7; "Trajectory formats".
    """

    def __init__(self, memory: bytes | bytearray = b"") -> None:
        self.phase = Phase.IDLE
        self.blocked = True
        self._memory = memory
        self._defined: dict[int, Defined] = {}
        self._curve: Curve | Trajectory | None = None
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
        if kind == DEFINE:
            return self._define(groups, Defined(*struct.unpack("<BBIB", rest)))
        if kind == GROUP_MASK:
            self._groups = groups
            return 0
        handle = self._HANDLERS.get(kind)
        if handle is None:
            return errno.ENOEXEC
        if groups and not groups & self._groups:
            return 0  # for other groups
        if self.blocked and kind != STOP_PLAN:
            return errno.EBUSY
        return handle(self, kind, rest, now)

    def _define(self, number: int, defined: Defined) -> int:
        if number >= TRAJECTORIES:
            return errno.ENOEXEC
        self._defined[number] = defined
        return 0

    def _stop_plan(self, kind: int, rest: bytes, now: int) -> int:  # noqa: ARG002
        self.stop()
        return 0

    def _vertical(self, kind: int, rest: bytes, now: int) -> int:
        height, yaw, keep_yaw, duration = struct.unpack("<ff?f", rest)
        return self._take_off_or_land(kind == LAND, height, None if keep_yaw else yaw, duration, now)

    def _vertical_at(self, kind: int, rest: bytes, now: int) -> int:
        """Take off or land at a velocity, which is the default one if it is not positive."""
        height, relative, yaw, keep_yaw, velocity = struct.unpack("<f?f?f", rest)
        landing, here = kind == LAND_AT, float(self._here[2])
        if relative:
            height = here - height if landing else here + height
        duration = abs(height - here) / (velocity if velocity > 0 else DEFAULT_VELOCITY)
        return self._take_off_or_land(landing, height, None if keep_yaw else yaw, duration, now)

    def _take_off_or_land(self, landing: bool, height: float, yaw: float | None, duration: float, now: int) -> int:
        if self.phase is not Phase.IDLE and (not landing or self.phase is Phase.LANDING):
            return 1
        end = np.array([*self._here[:2], height, self._here[3] if yaw is None else yaw])
        self._curve = curve(now, duration, (self._here, REST, REST), self._shortest(end))
        self.phase = Phase.LANDING if landing else Phase.FLYING
        return 0

    def _go_to(self, kind: int, rest: bytes, now: int) -> int:
        """Go to a place smoothly or, which the first version of the command does not offer, in a straight line."""
        flags, numbers = (rest[:2], rest[2:]) if kind == GO_TO else (rest[:1] + b"\0", rest[1:])
        relative, straight = struct.unpack("<??", flags)
        *place, duration = struct.unpack("<5f", numbers)
        start = (self._here, self._velocity, REST) if self._curve is None else self._curve.at(now)
        end = self._shortest(np.array(place) + start[0] if relative else np.array(place))
        self._curve = line(now, duration, start[0], end) if straight else curve(now, duration, start, end)
        self.phase = Phase.FLYING
        return 0

    def _start(self, kind: int, rest: bytes, now: int) -> int:
        """Fly a trajectory; one that was not defined, or has no pieces, is ignored without an error."""
        if kind == START:
            relative, turned, reverse, number, timescale = struct.unpack("<???Bf", rest)
        else:
            (relative, reverse, number, timescale), turned = struct.unpack("<??Bf", rest), False
        defined = self._defined.get(number)
        if defined is None or defined.location != IN_MEMORY:
            return 0
        if defined.kind == COMPRESSED and (reverse or timescale != 1):
            return errno.ENOEXEC
        compressed = defined.kind == COMPRESSED
        memory, offset = bytes(self._memory), defined.offset
        pieces = compressed_pieces(memory, offset) if compressed else plain_pieces(memory, offset, defined.pieces)
        if not pieces or not timescale > 0:
            return 0
        start = np.full(4, np.nan)
        start[:3] = self._here[:3] if relative else np.nan
        start[3] = self._here[3] if relative and turned else np.nan
        self._curve = Trajectory(pieces, now, timescale=timescale, reverse=reverse, start=start)
        self.phase = Phase.FLYING
        return 0

    def _shortest(self, end: Array) -> Array:
        """Return the goal with the equivalent yaw that needs the shortest turn from the present one."""
        turn = math.remainder(float(end[3] - self._here[3]), 2 * math.pi)
        return np.append(end[:3], self._here[3] + turn)

    _HANDLERS: ClassVar[dict[int, Callable[["Planner", int, bytes, int], int]]] = {
        STOP_PLAN: _stop_plan,
        TAKE_OFF: _vertical,
        LAND: _vertical,
        TAKE_OFF_AT: _vertical_at,
        LAND_AT: _vertical_at,
        GO_TO_1: _go_to,
        GO_TO: _go_to,
        START_1: _start,
        START: _start,
    }
