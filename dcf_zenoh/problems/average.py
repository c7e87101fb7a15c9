"""The mean of the agents' values."""

import numpy as np

from dcf_zenoh.plant import Array, State, read_only
from dcf_zenoh.problems.problem import ConsensusProblem, MeanProblem
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Box


class Average(MeanProblem, ConsensusProblem):
    """Each agent holds a value; all want the mean.

    The mean is the x with the least sum of |x - value|² / 2, so any algorithm that minimises a sum can find it.

    Args:
        value: This agent's value: a number or an array, the same shape at every agent.

    Attributes:
        value: This agent's value as a read-only array of shape (n,).
    """

    def __init__(self, *, value: float | list[float]) -> None:
        self.value = read_only(np.atleast_1d(value))
        self.size = self.value.size

    def cost(self, x: Array) -> float:
        """Return |x - value|² / 2."""
        return float((x - self.value) @ (x - self.value)) / 2

    def gradient(self, x: Array) -> Array:
        """Return x - value."""
        return x - self.value

    def argmin(self, slope: Array, weight: float) -> Array:
        """Return the x where the gradient is 0."""
        nearest: Array = (self.value - slope) / (1 + weight)
        return nearest

    def share(self) -> Share:
        """Return the problem as arrays."""
        return Share(np.eye(self.size), -self.value, *Box.of(self.size, None, None), common=True)

    def distance_to_go(self, state: State) -> float:  # noqa: ARG002
        """Return 0: the problem moves no body."""
        return 0.0
