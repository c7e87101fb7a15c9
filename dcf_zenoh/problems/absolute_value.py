"""A sum of distances, with one decision for all: a cost with a kink."""

import numpy as np

from dcf_zenoh.plant import Array
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Bound, Box, positive, vector


class AbsoluteValue(ConsensusProblem):
    """Each agent holds weight |x - value| and bounds; all want the x with the least sum.

    Vectors are taken component by component. Without bounds the answer is the weighted median of the values.

    Args:
        value: A number, or a list of n, the same n at every agent.
        weight: Positive: a number for all components, or a list of n.
        lower: Least value of x: none, a number, or a list of n.
        upper: Greatest value of x, likewise.

    Raises:
        ValueError: A weight is not positive, there are more or fewer than n, or a lower bound is above the upper one.
    """

    smooth = False
    strongly_convex = False

    def __init__(
        self,
        *,
        value: float | list[float],
        weight: float | list[float] = 1.0,
        lower: Bound = None,
        upper: Bound = None,
    ) -> None:
        self.size = np.size(value)
        self._value = vector("value", value, self.size)
        self._weight = positive("weight", weight, self.size)
        self._box = Box.of(self.size, lower, upper)
        self.unconstrained = self._box.everything

    def cost(self, x: Array) -> float:
        """Return the weighted distance to the value."""
        return float(self._weight @ abs(x - self._value))

    def gradient(self, x: Array) -> Array:
        """Return a subgradient: weight sign(x - value), 0 at the value."""
        slopes: Array = self._weight * np.sign(x - self._value)
        return slopes

    def argmin(self, slope: Array, weight: float) -> Array:
        """Return the minimiser, by soft thresholding in each component: see `ConsensusProblem.argmin`."""
        pull = slope + weight * self._value  # slope of the smooth terms at the kink
        beyond = np.sign(pull) * np.maximum(abs(pull) - self._weight, 0.0)
        return self._box.nearest(self._value - beyond / weight)

    def project(self, x: Array) -> Array:
        """Return the nearest point within the bounds."""
        return self._box.nearest(x)

    def share(self) -> Share:
        """Return the problem as arrays."""
        flat = np.zeros((self.size, self.size))
        return Share(flat, np.zeros(self.size), *self._box, absolute=self._weight, kink=self._value, common=True)
