"""Copies of all plans that the two ends of each edge agree on, by relaxed ADMM."""

from typing import Any

import numpy as np

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour
from dcf_zenoh.algorithms.shared.local_qp import Solution
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import VariationalInequality
from dcf_zenoh.problems.problem import AggregativeGame


class EdgeCopies:
    """Edge variables z_ij of one agent's copies x of all plans, kept from one control step to the next.

    The algorithm solves ``x = argmin f - sum_j z_ij'x + rho d / 2 |x|²``, with f the local problem and d the number of
    neighbours. This class makes the messages ``m_ij = 2 rho x - z_ij`` to neighbour j and updates
    ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``. An edge whose message is lost keeps its variable. No sum has to stay
    zero, so z can be kept between steps: it starts from its last value with every plan moved on by one stage.

    Args:
        me: This agent.
        game: Moves plans on by one stage (`start`) and names lost agents.
        agents: Agents whose plans x has copies of, ascending.
        local: Local problem, over the plans of `agents`.
        penalty: rho.
        relax: alpha, in (0, 1].

    Attributes:
        own: Place of the agent's own plan in x.
        z: Neighbour -> z_ij, shape (n,).
        weight: rho d.
        last: Solution of the previous step, its plans moved on; None if there is none over the same agents.

    Source: Bastianello, Carli, Schenato, Todescato, "Asynchronous distributed optimization over lossy networks via
    relaxed ADMM: stability and linear convergence", IEEE Transactions on Automatic Control, 2021.
    """

    def __init__(
        self,
        me: Me,
        game: AggregativeGame,
        agents: tuple[int, ...],
        local: VariationalInequality,
        penalty: float,
        relax: float,
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
        self._moves = dict.fromkeys(self.z, float("inf"))  # last move of each edge variable, in units of x

    @property
    def pull(self) -> Array:
        """Sum of z_ij over the neighbours, shape (n,)."""
        total: Array = np.sum([self._none, *self.z.values()], axis=0)
        return total

    @property
    def moved(self) -> float:
        """Largest last move of an edge variable, in units of x; infinite before each edge has moved."""
        return max(self._moves.values(), default=0.0)

    def payloads(self, x: Array) -> PerNeighbour:
        """Return m_ij for each neighbour; an empty payload for a lost one."""
        return PerNeighbour({j: {"m": 2 * self._penalty * x - self.z[j]} if j in self.z else {} for j in self._all})

    def update(self, inbox: Inbox) -> None:
        """Move each edge variable whose message is new; a held value must not count twice."""
        for j, payload in inbox.items():
            if j in self.z and "m" in payload and inbox.new(j):
                move = self._relax * (payload["m"] - self.z[j])
                self.z[j], self._moves[j] = self.z[j] + move, float(abs(move).max()) / self.weight

    def memory(self, x: Solution) -> dict[str, Any]:
        """Return what `Me` must keep for the next control step, with `x` the last solution."""
        return {"agents": self._agents, "z": self.z, "solution": x}
