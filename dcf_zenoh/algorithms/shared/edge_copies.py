"""Copies of all plans that the two ends of each edge agree on, by relaxed ADMM."""

from typing import Any

import numpy as np

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour
from dcf_zenoh.algorithms.shared.local_qp import Solution
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import Whole
from dcf_zenoh.problems.problem import AggregativeGame


class EdgeCopies:
    """The edge variables z_ij of one agent's copies x of the plans of all, kept from one control step to the next.

    ``x = argmin f - sum_j z_ij'x + rho d / 2 |x|²`` is the algorithm's affair, with f what the agent solves and d the
    number of its neighbours; to j goes ``m_ij = 2 rho x - z_ij``, and what comes makes
    ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``. An edge whose message is lost stays as it is, and nothing has to sum to
    zero, so that z may be kept: it starts as it was, every plan in it moved on by one stage.

    Args:
        me: This agent.
        game: What tells how a plan is moved on, and who is lost.
        agents: Whose plans there are copies of, ascending.
        local: The agent's own problem, over the plans of `agents`.
        penalty: rho.
        relax: alpha, in (0, 1].

    Attributes:
        own: Where the agent's own plan is in x.
        z: Neighbour -> z_ij.
        weight: rho d.
        last: The solution of the step before, its plans moved on; None if there is none that fits.

    Source: Bastianello, Carli, Schenato, Todescato, "Asynchronous distributed optimization over lossy networks via
    relaxed ADMM: stability and linear convergence", IEEE Transactions on Automatic Control, 2021.
    """

    def __init__(
        self, me: Me, game: AggregativeGame, agents: tuple[int, ...], local: Whole, penalty: float, relax: float
    ) -> None:
        self._all, self._none, self._agents = me.neighbours, np.zeros_like(local.r), agents
        self._penalty, self._relax = penalty, relax
        self.own = local.places[agents.index(me.id)]
        same = me.recall("agents", ()) == agents

        def ahead(v: Array) -> Array:
            return np.concatenate([game.start(v[place]) for place in local.places])

        z: dict[int, Array] = me.recall("z", {}) if same else {}
        last: Solution | None = me.recall("solution", None) if same else None
        self.z = {j: ahead(z[j]) if j in z else self._none for j in me.neighbours if j not in game.lost}
        self.weight = penalty * len(self.z)
        self.last = None if last is None else last._replace(v=ahead(last.v))
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
        """m_ij for each neighbour; nothing for one that is lost."""
        return PerNeighbour({j: {"m": 2 * self._penalty * x - self.z[j]} if j in self.z else {} for j in self._all})

    def hear(self, inbox: Inbox) -> None:
        """Move every edge over which something new came; a held message must not count twice."""
        for j, payload in inbox.items():
            if j in self.z and "m" in payload and inbox.new(j):
                move = self._relax * (payload["m"] - self.z[j])
                self.z[j], self._moves[j] = self.z[j] + move, float(abs(move).max()) / self.weight

    def memory(self, x: Solution) -> dict[str, Any]:
        """What to remember for the next control step."""
        return {"agents": self._agents, "z": self.z, "solution": x}
