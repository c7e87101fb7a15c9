"""Relaxed ADMM over the edges, which bears lost messages."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.needs import Fraction, needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, links="undirected", agents=2)
def edge_admm(
    problem: ConsensusProblem, me: Me, *, penalty: PositiveFloat = 1.0, relax: Fraction = 0.9
) -> Dialogue[Result]:
    """Each edge has a variable at either end, which follows what the other end says; sent per edge.

    With rho the penalty, alpha how far an edge follows, d the number of neighbours, and z_ij = 0 at first:
    ``x = argmin f - sum_j z_ij'x + rho d / 2 |x|²``, to j goes ``m_ij = 2 rho x - z_ij``, and what comes makes
    ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``. An edge whose message is lost stays as it is; nothing has to sum to zero,
    so the limit is exact also where half of all messages are lost. The residual is the largest change of x and of what
    the edges ask for.

    Args:
        problem: This agent's cost and set.
        me: This agent.
        penalty: rho.
        relax: alpha.

    Source: Bastianello, Carli, Schenato, Todescato, "Asynchronous distributed optimization over lossy networks via
    relaxed ADMM: stability and linear convergence", IEEE Transactions on Automatic Control, 2021.
    """
    edges = {j: np.zeros(problem.size) for j in me.neighbours}
    moves = dict.fromkeys(edges, float("inf"))  # by how much each edge moved when something came over it last
    weight = penalty * len(edges)
    x = problem.argmin(np.zeros(problem.size), weight)
    change = float("inf")
    while True:
        inbox = yield PerNeighbour({j: {"m": 2 * penalty * x - z} for j, z in edges.items()}), change
        for j, payload in inbox.items():
            if inbox.new(j):  # a held message must not count twice
                move = relax * (payload["m"] - edges[j])
                edges[j], moves[j] = edges[j] + move, float(abs(move).max()) / weight
        new = problem.argmin(-np.sum(list(edges.values()), axis=0), weight)
        change, x = max(float(abs(new - x).max()), *moves.values()), new
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
