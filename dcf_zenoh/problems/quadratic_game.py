"""Any game with linear pseudo-gradients and one number for each player."""

import numpy as np

from dcf_zenoh.plant import Array
from dcf_zenoh.problems.problem import Game
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Box, vector


class QuadraticGame(Game):
    """Each agent chooses a number; the slope of its cost is row'x + constant, with the numbers x of all agents.

    The numbers x are in order of ids. The rows of all agents make a matrix M. The game has one equilibrium where
    M + M' is positive definite.

    Args:
        agent: Id of this agent.
        agents: Ids of all agents, ascending.
        row: This agent's row of M, a list of one number for each agent.
        constant: F_i at 0.
        lower: Least number that the agent can choose; None: no limit.
        upper: Greatest number that the agent can choose; None: no limit.

    Raises:
        ValueError: The row has another length, its own entry is not positive, or `lower` is above `upper`.
    """

    def __init__(
        self,
        agent: int,
        agents: tuple[int, ...],
        *,
        row: list[float],
        constant: float = 0.0,
        lower: float | None = None,
        upper: float | None = None,
    ) -> None:
        if len(row) != len(agents):
            raise ValueError(f"row must have one number for each of the {len(agents)} agents, not {row}")
        self.players = agents
        self.size = 1
        self._place = agents.index(agent)
        self._row = vector("row", row, len(agents))
        if not self._row[self._place] > 0:
            raise ValueError(f"row must be positive at the agent itself, and is {self._row[self._place]:g} there")
        self._constant = constant
        self._box = Box.of(1, lower, upper)

    def pseudo_gradient(self, profile: Array) -> Array:
        """Return F_i = row'x + constant at `profile`."""
        slope: Array = self._row @ profile + self._constant
        return slope

    def project(self, x: Array) -> Array:
        """Return the nearest number that the agent can choose."""
        return self._box.nearest(x)

    def share(self) -> Share:
        """Return the problem as arrays: the contribution to the mean is N times the agent's number at its place."""
        count = len(self.players)
        place = count * np.eye(count)[:, [self._place]]
        return Share(
            np.zeros((1, 1)),
            np.array([self._constant]),
            *self._box,
            K=self._row[np.newaxis],
            Phi=place,
            phi=np.zeros(count),
        )
