"""Diamond-shaped regions in the plane: how far out of one a point is, and on which side."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, read_only

SAME_COORDINATE = 1e-9  # m; closer than this, coordinates are equal


def barrier(apart: Array, radii: Sequence[float]) -> float:
    """The barrier value h = |dx| / r1 + |dy| / r2 - 1 of two points `apart`, shape (2,), m; negative in the diamond.

    Source: Memon et al., eq. (6).
    """
    return float(abs(apart[0]) / radii[0] + abs(apart[1]) / radii[1] - 1)


def side(apart: Array) -> Array:
    """Signs of `apart` in x and y, shape (2,), each 1 or -1; equal coordinates count as 1."""
    return np.where(apart > -SAME_COORDINATE, 1.0, -1.0)


class Obstacle(NamedTuple):
    """Something that stands in the way: no agent's position may be in its diamond.

    Attributes:
        at: Its centre, shape (2,), m.
        radii: Half axes r1, r2 of the diamond, m.
    """

    at: Array
    radii: tuple[float, float]

    @classmethod
    def of(cls, numbers: Sequence[float]) -> "Obstacle":
        """The obstacle that ``[x, y, r1, r2]`` is in a fleet file.

        Raises:
            ValueError: These are not four numbers, the last two positive.
        """
        if len(numbers) != 4 or not min(numbers[2:]) > 0:
            raise ValueError(f"an obstacle is [x, y, r1, r2] in m, r1 and r2 positive, not {list(numbers)}")
        x, y, r1, r2 = numbers
        return cls(read_only((x, y)), (r1, r2))

    def barrier(self, position: Array) -> float:
        """The barrier value of an agent at `position`, shape (d,), m."""
        return barrier(position[:2] - self.at, self.radii)
