"""Dual decomposition over the edges."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, traits=("strongly_convex",), links="undirected")
def dual_decomposition(problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Every edge has a price of disagreement, and each agent its own least cost at these prices; sent per edge.

    ``x = argmin f + sum_j lam_ij'x``, then ``lam_ij+ = lam_ij + a (x_i - x_j)``. The two ends of an edge hold the same
    price with opposite signs; each sends its own, and both start the next round from the mean of the two. So they agree
    again after a message was lost, and the limit stays exact. Linear for strongly convex and smooth costs. The residual
    is the largest distance to a neighbour.

    Args:
        problem: This agent's cost and set.
        me: This agent.
        step: a; less than m / d for costs that are m-strongly convex and d neighbours at most.

    Source: Terelius, Topcu, Murray, "Decentralized multi-agent optimization via dual decomposition", IFAC World
    Congress, 2011.
    """
    prices = {j: np.zeros(problem.size) for j in me.neighbours}
    apart = dict.fromkeys(prices, float("inf"))  # how far each neighbour was when it was heard last
    x = problem.argmin(np.zeros(problem.size), 0.0)
    while True:
        change = max(apart.values(), default=0.0)
        inbox = yield PerNeighbour({j: {"x": x, "lam": lam} for j, lam in prices.items()}), change
        for j, payload in inbox.items():
            if inbox.new(j):
                away = x - payload["x"]
                prices[j] = (prices[j] - payload["lam"]) / 2 + step * away
                apart[j] = float(abs(away).max())
        x = problem.argmin(np.sum([np.zeros(problem.size), *prices.values()], axis=0), 0.0)
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
