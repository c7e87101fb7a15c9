"""Trajectories that a client stores in the drone's memory: polynomials, piece by piece."""

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array

DEGREE = 7
PIECE = struct.Struct("<33f")  # coefficients of x, y, z and yaw, constant term first, and the duration, s
START, SEGMENT = struct.Struct("<4h"), struct.Struct("<BH")  # of a compressed trajectory; numbers of points, and ms
POINTS = (0, 1, 3, 7)  # control points of a coordinate, by its two bits in the header of a segment
UNITS = np.array([1e-3, 1e-3, 1e-3, math.radians(0.1)])  # of compressed coordinates, in m and rad
REST = np.zeros(4)


class PolynomialPiece(NamedTuple):
    """Polynomial in time for x, y, z and yaw.

    Attributes:
        duration: Duration, s.
        coefficients: Coefficients, shape (8, 4), constant term first; m and rad.
    """

    duration: float
    coefficients: Array

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at `time`, s, shape (4,) each."""
        place, rate, second = REST, REST, REST
        for coefficient in self.coefficients[::-1]:
            second = second * time + 2 * rate
            rate = rate * time + place
            place = place * time + coefficient
        return place, rate, second


class Trajectory:
    """Trajectory that is being flown; it holds its last point when it is over.

    Args:
        pieces: Its pieces, at least one.
        begin: Instant of the beginning, ms.
        timescale: Factor of the durations; larger is slower.
        reverse: Whether it is flown from its end to its beginning.
        start: Position and yaw at which it begins instead of its own, shape (4,), m and rad; NaN where its own count.
            With a yaw the whole trajectory is turned about its beginning.
    """

    def __init__(
        self, pieces: Sequence[PolynomialPiece], begin: int, *, timescale: float, reverse: bool, start: Array
    ) -> None:
        self._pieces = pieces
        self._begin = begin
        self._timescale = timescale
        self._reverse = reverse
        self._duration = sum(each.duration for each in pieces)
        own = self._own(0.0)[0]
        turned, moved = ~np.isnan(start[3]), ~np.isnan(start[:3])
        self._turn = math.remainder(float(start[3] - own[3]), 2 * math.pi) if turned else 0.0
        self._origin = own[:3] if moved.all() or turned else np.zeros(3)
        self._shift = np.where(moved, start[:3], self._origin)

    def at(self, now: int) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative at `now`, ms, shape (4,) each."""
        value, rate, second = self._own((now - self._begin) * 1e-3)
        turn = np.identity(4)
        turn[:2, :2] = [[math.cos(self._turn), -math.sin(self._turn)], [math.sin(self._turn), math.cos(self._turn)]]
        place = turn @ np.append(value[:3] - self._origin, value[3] + self._turn)
        return place + np.append(self._shift, 0.0), turn @ rate, turn @ second

    def over(self, now: int) -> bool:
        """Return whether it has ended at `now`, ms."""
        return (now - self._begin) * 1e-3 >= self._duration * self._timescale

    def _own(self, time: float) -> tuple[Array, Array, Array]:
        """Return value and derivatives at `time`, s after the beginning, without shift and turn."""
        part = time / self._timescale
        over = part >= self._duration
        left = max(0.0, self._duration - part) if self._reverse else min(part, self._duration)
        piece = self._pieces[0]
        for piece in self._pieces:
            if left <= piece.duration:
                break
            left -= piece.duration
        value, rate, second = piece.at(min(left, piece.duration))
        if over:
            return value, REST, REST
        speed = (-1 if self._reverse else 1) / self._timescale
        return value, rate * speed, second * speed**2


def plain_pieces(memory: bytes, offset: int, count: int) -> list[PolynomialPiece]:
    """Read `count` pieces from a memory; fewer if they do not fit into it."""
    found = []
    for begin in range(offset, min(offset + count * PIECE.size, len(memory) - PIECE.size + 1), PIECE.size):
        *coefficients, duration = PIECE.unpack_from(memory, begin)
        if not all(map(math.isfinite, coefficients)) or not 0 < duration < math.inf:
            break
        found.append(PolynomialPiece(duration, np.array(coefficients).reshape(4, DEGREE + 1).T))
    return found


def compressed_pieces(memory: bytes, offset: int) -> list[PolynomialPiece]:
    """Read a compressed trajectory, which ends with a segment without duration or with the memory.

    Each coordinate of a segment is a Bézier curve of degree 0, 1, 3 or 7 that begins where the last one has ended.

    Source: crazyflie-firmware, documentation "Trajectory formats".
    """
    found: list[PolynomialPiece] = []
    if offset + START.size > len(memory):
        return found
    here = np.array(START.unpack_from(memory, offset)) * UNITS
    offset += START.size
    while offset + SEGMENT.size <= len(memory):
        kinds, duration = SEGMENT.unpack_from(memory, offset)
        counts = [POINTS[kinds >> 2 * axis & 3] for axis in range(4)]
        end = offset + SEGMENT.size + 2 * sum(counts)
        if not duration or end > len(memory):
            break
        numbers = iter(struct.unpack_from(f"<{sum(counts)}h", memory, offset + SEGMENT.size))
        coefficients = np.zeros((DEGREE + 1, 4))
        for axis, count in enumerate(counts):
            points = [here[axis], *(next(numbers) * UNITS[axis] for _ in range(count))]
            coefficients[: count + 1, axis] = _bezier(points, duration * 1e-3)
            here[axis] = points[-1]
        found.append(PolynomialPiece(duration * 1e-3, coefficients))
        offset = end
    return found


def _bezier(points: Sequence[float], duration: float) -> list[float]:
    """Return the coefficients in time, constant term first, of the Bézier curve with these control points."""
    degree = len(points) - 1
    return [
        math.comb(degree, power)
        * sum((-1) ** (power + i) * math.comb(power, i) * points[i] for i in range(power + 1))
        / duration**power
        for power in range(degree + 1)
    ]
