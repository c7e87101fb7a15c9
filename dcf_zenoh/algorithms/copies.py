"""Copies of all decisions that the two ends of each edge agree on, by relaxed ADMM."""

from collections.abc import Collection, Mapping

import numpy as np

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour
from dcf_zenoh.plant import Array


class Copies:
    """The edge variables z_ij of one agent's copies x.

    ``x = argmin f - sum_j z_ij'x + rho d / 2 |x|²`` is the algorithm's affair, with f what the agent solves and d the
    number of its neighbours; to j goes ``m_ij = 2 rho x - z_ij``, and what comes makes
    ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``. An edge whose message is lost stays as it is, and nothing has to sum to
    zero, so that z may be kept across control steps.

    Args:
        me: This agent.
        lost: Agents that take no part.
        penalty: rho.
        relax: alpha, in (0, 1].
        size: Of x.
        start: Neighbour -> z_ij to start with; another is zero.

    Attributes:
        z: Neighbour -> z_ij.
        weight: rho d.

    Source: Bastianello, Carli, Schenato, Todescato, "Asynchronous distributed optimization over lossy networks via
    relaxed ADMM: stability and linear convergence", IEEE Transactions on Automatic Control, 2021.
    """

    def __init__(
        self, me: Me, lost: Collection[int], penalty: float, relax: float, size: int, start: Mapping[int, Array]
    ) -> None:
        self._all, self._none = me.neighbours, np.zeros(size)
        self._penalty, self._relax = penalty, relax
        self.z = {j: start.get(j, self._none) for j in me.neighbours if j not in lost}
        self.weight = penalty * len(self.z)
        self._moves = dict.fromkeys(self.z, float("inf"))  # by how much each edge moved when it was heard last

    @property
    def pull(self) -> Array:
        """The sum of z_ij."""
        total: Array = np.sum([self._none, *self.z.values()], axis=0)
        return total

    @property
    def moved(self) -> float:
        """The largest move of what the edges ask for, in units of x, when each was heard last."""
        return max(self._moves.values(), default=0.0)

    def said(self, x: Array) -> PerNeighbour:
        """m_ij for each neighbour."""
        return PerNeighbour({j: {"m": 2 * self._penalty * x - self.z[j]} if j in self.z else {} for j in self._all})

    def hear(self, inbox: Inbox) -> None:
        """Move every edge over which something new came; a held message must not count twice."""
        for j, payload in inbox.items():
            if j in self.z and "m" in payload and inbox.new(j):
                move = self._relax * (payload["m"] - self.z[j])
                self.z[j], self._moves[j] = self.z[j] + move, float(abs(move).max()) / self.weight
