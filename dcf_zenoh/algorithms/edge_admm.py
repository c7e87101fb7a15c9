"""Relaxed ADMM over the edges, which tolerates lost messages."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.needs import Fraction, needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, links="undirected", agents=2, alike=True, uses=("argmin",))
def edge_admm(
    problem: ConsensusProblem, me: Me, *, penalty: PositiveFloat = 1.0, relax: Fraction = 0.9
) -> Dialogue[Result]:
    """Minimise with an edge variable at either end of each edge, which follows the messages of the other end.

    With rho the penalty, alpha the relaxation, d the number of neighbours, and z_ij = 0 at first, each round solves
    ``x = argmin f - sum_j z_ij'x + rho d / 2 |x|²``, sends ``m_ij = 2 rho x - z_ij`` to neighbour j, and updates
    ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``. An edge whose message is lost keeps its variable. No sum has to stay
    zero, so the limit is exact even with half of all messages lost. The residual is the largest change of x or of the
    edge variables.

    Args:
        problem: Cost and set of this agent.
        me: This agent.
        penalty: rho.
        relax: alpha.

    Source: Bastianello, Carli, Schenato, Todescato, "Asynchronous distributed optimization over lossy networks via
    relaxed ADMM: stability and linear convergence", IEEE Transactions on Automatic Control, 2021.
    """
    edges = {j: np.zeros(problem.size) for j in me.neighbours}
    moves = dict.fromkeys(edges, float("inf"))  # last move of each edge variable, in units of x
    weight = penalty * len(edges)
    x = problem.argmin(np.zeros(problem.size), weight)
    change = float("inf")
    while True:
        inbox = yield PerNeighbour({j: {"m": 2 * penalty * x - z} for j, z in edges.items()}), change
        for j, payload in inbox.items():
            if inbox.new(j):  # a held value must not count twice
                move = relax * (payload["m"] - edges[j])
                edges[j], moves[j] = edges[j] + move, float(abs(move).max()) / weight
        new = problem.argmin(-np.sum(list(edges.values()), axis=0), weight)
        change, x = max(float(abs(new - x).max()), *moves.values()), new
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
