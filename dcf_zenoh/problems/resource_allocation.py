"""Agents divide a resource among them."""

import numpy as np

from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.problem import CoupledProblem
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Bound, Box, positive, vector


class ResourceAllocation(CoupledProblem):
    """Each agent pays weight (x_i - centre)² / 2 for what it takes; together they take the demand.

    Several resources are independent of each other.

    Args:
        agents: Ids of all agents.
        demand: Amount that all take together: a number, or a list of one for each of n resources.
        exactly: The agents take the whole demand; otherwise at most as much.
        weight: Positive: a number for all resources, or a list of n.
        centre: Amount that the agent would take if it were alone, likewise.
        lower: Least amount that the agent can take: none, a number, or a list of n.
        upper: Greatest amount that the agent can take, likewise.

    Raises:
        ValueError: A weight is not positive, there are more or fewer than n, or a lower bound is above the upper one.
    """

    SHARED = ("demand", "exactly")

    def __init__(
        self,
        agents: tuple[int, ...],
        *,
        demand: float | list[float],
        exactly: bool = True,
        weight: float | list[float] = 1.0,
        centre: float | list[float] = 0.0,
        lower: Bound = 0.0,
        upper: Bound = None,
    ) -> None:
        self.rows = size = np.size(demand)
        self.A = read_only(np.eye(size))
        self.b = read_only(vector("demand", demand, size) / len(agents))
        self.equality = exactly
        self._weight = positive("weight", weight, size)
        self._centre = vector("centre", centre, size)
        self._box = Box.of(size, lower, upper)

    def cost(self, x: Array) -> float:
        """Return weight (x - centre)² / 2, summed over the resources."""
        return float(self._weight @ (x - self._centre) ** 2) / 2

    def respond(self, price: Array, weight: float, target: Array) -> Array:
        """Return, resource by resource, where the gradient is 0, or the bound before it."""
        return self._box.nearest((self._weight * self._centre - price + weight * target) / (self._weight + weight))

    def share(self) -> Share:
        """Return the problem as arrays."""
        return Share(
            np.diag(self._weight),
            -self._weight * self._centre,
            *self._box,
            A=self.A,
            b=self.b,
            equality=self.equality,
        )
