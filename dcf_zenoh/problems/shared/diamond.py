"""Diamond-shaped regions in the plane: barrier value, outline, and on which side of one a point is."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, read_only

SAME_COORDINATE = 1e-9  # m; closer than this, coordinates are equal


def barrier(apart: Array, radii: Sequence[float]) -> Array:
    """Return h = |dx| / r1 + |dy| / r2 - 1, shape (...): negative in the diamond.

    Args:
        apart: From one point to the other, shape (..., 2), m.
        radii: Half axes r1, r2 of the diamond, m.

    Source: Memon et al., eq. (6).
    """
    h: Array = abs(apart[..., 0]) / radii[0] + abs(apart[..., 1]) / radii[1] - 1
    return h


def outline(centre: Array, radii: Sequence[float]) -> Array:
    """Return the corners of the diamond around `centre`, shape (4, 2), m; there and between them h = 0.

    Args:
        centre: Shape (2,), m.
        radii: Half axes r1, r2 of the diamond, m.
    """
    r1, r2 = radii
    corners: Array = centre + np.array([[r1, 0], [0, r2], [-r1, 0], [0, -r2]])
    return corners


def side(apart: Array) -> Array:
    """Return the signs of `apart` in x and y, shape (2,), each 1 or -1; equal coordinates count as 1."""
    return np.where(apart > -SAME_COORDINATE, 1.0, -1.0)


class Obstacle(NamedTuple):
    """An obstacle: no agent's position may be in its diamond.

    Attributes:
        at: Centre, shape (2,), m.
        radii: Half axes r1, r2 of the diamond, m.
    """

    at: Array
    radii: tuple[float, float]

    @classmethod
    def of(cls, numbers: Sequence[float]) -> "Obstacle":
        """Return the obstacle that a fleet file writes as ``[x, y, r1, r2]``.

        Raises:
            ValueError: These are not four numbers, the last two positive.
        """
        if len(numbers) != 4 or not min(numbers[2:]) > 0:
            raise ValueError(f"an obstacle is [x, y, r1, r2] in m, r1 and r2 positive, not {list(numbers)}")
        x, y, r1, r2 = numbers
        return cls(read_only((x, y)), (r1, r2))

    def barrier(self, position: Array) -> Array:
        """Return the barrier value h of an agent, shape (...), at positions of shape (..., d), m."""
        return barrier(position[..., :2] - self.at, self.radii)

    def outline(self) -> Array:
        """Return the corners, shape (4, 2), m."""
        return outline(self.at, self.radii)
