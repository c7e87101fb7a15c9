"""A sum of squares, with one decision for all."""

import numpy as np

from dcf_zenoh.plant import Array
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Bound, Box, positive, vector


class Quadratic(ConsensusProblem):
    """Each agent holds weight (x - centre)² / 2 and bounds; all want the x with the least sum.

    Vectors are taken component by component. Without bounds the answer is the weighted mean of the centres.

    Args:
        centre: Where the agent's cost is least: a number, or a list of n, the same n at every agent.
        weight: Positive: a number for all components, or a list of n.
        lower: Least value of x: none, a number, or a list of n.
        upper: Greatest value of x, likewise.

    Raises:
        ValueError: A weight is not positive, there are more or fewer than n, or a lower bound is above the upper one.
    """

    def __init__(
        self,
        *,
        centre: float | list[float],
        weight: float | list[float] = 1.0,
        lower: Bound = None,
        upper: Bound = None,
    ) -> None:
        self.size = np.size(centre)
        self._centre = vector("centre", centre, self.size)
        self._weight = positive("weight", weight, self.size)
        self._box = Box.of(self.size, lower, upper)
        self.unconstrained = self._box.everything

    def cost(self, x: Array) -> float:
        """Return weight (x - centre)² / 2, summed over the components."""
        return float(self._weight @ (x - self._centre) ** 2) / 2

    def gradient(self, x: Array) -> Array:
        """Return weight (x - centre)."""
        return self._weight * (x - self._centre)

    def argmin(self, slope: Array, weight: float) -> Array:
        """Return, component by component, where the gradient is 0, or the bound before it."""
        return self._box.nearest((self._weight * self._centre - slope) / (self._weight + weight))

    def project(self, x: Array) -> Array:
        """Return the nearest point within the bounds."""
        return self._box.nearest(x)

    def share(self) -> Share:
        """Return the problem as arrays."""
        return Share(np.diag(self._weight), -self._weight * self._centre, *self._box, common=True)
