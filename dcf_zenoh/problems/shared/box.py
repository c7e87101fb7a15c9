"""Bounds on each component of a decision."""

from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, read_only

Bound = float | list[float] | None


class Box(NamedTuple):
    """lower <= x <= upper, component by component; both of shape (n,), infinite where there is no bound."""

    lower: Array
    upper: Array

    @classmethod
    def of(cls, size: int, lower: Bound, upper: Bound) -> "Box":
        """Make a box from keys of a fleet file: None, one number for all components, or one for each.

        Raises:
            ValueError: There are not `size` numbers, or a lower bound is above the upper one.
        """
        box = cls(
            vector("lower", -np.inf if lower is None else lower, size),
            vector("upper", np.inf if upper is None else upper, size),
        )
        if (box.lower > box.upper).any():
            raise ValueError(f"lower must not be above upper, and {lower} is above {upper}")
        return box

    @property
    def everything(self) -> bool:
        """Whether there are no bounds."""
        return bool(np.isinf(self.lower).all() and np.isinf(self.upper).all())

    def nearest(self, x: Array) -> Array:
        """Return the point of the box that is nearest to `x`."""
        return np.minimum(np.maximum(x, self.lower), self.upper)


def vector(name: str, value: float | list[float], size: int) -> Array:
    """Return a read-only array of shape (size,) from one number for all components, or one for each.

    Raises:
        ValueError: There are neither 1 nor `size` numbers.
    """
    given = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if given.shape not in ((1,), (size,)):
        raise ValueError(f"{name} must be a number or a list of {size}, not {value}")
    return read_only(np.broadcast_to(given, (size,)))


def positive(name: str, value: float | list[float], size: int) -> Array:
    """Return the same as `vector`, of positive numbers.

    Raises:
        ValueError: A number is not positive.
    """
    given = vector(name, value, size)
    if not (given > 0).all():
        raise ValueError(f"{name} must be positive, not {value}")
    return given
