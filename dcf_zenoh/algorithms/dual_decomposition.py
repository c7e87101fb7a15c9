"""Dual decomposition over the edges."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, traits=("strongly_convex",), links="undirected", alike=True, uses=("argmin",))
def dual_decomposition(problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Minimise the cost at a price of disagreement on each edge, and update the prices.

    ``x = argmin f + sum_j lam_ij'x``, then ``lam_ij+ = lam_ij + a (x_i - x_j)``. The two ends of an edge hold the same
    price with opposite signs. Each sends its own, and both start the next round from the mean of the two, so they agree
    again after a lost message and the limit stays exact. Payloads are per neighbour. Converges linearly for strongly
    convex and smooth costs. The residual is the largest distance to a neighbour.

    Args:
        problem: Cost and set of this agent.
        me: This agent.
        step: a; less than m / d for m-strongly convex costs and at most d neighbours.

    Source: Terelius, Topcu, Murray, "Decentralized multi-agent optimization via dual decomposition", IFAC World
    Congress, 2011.
    """
    prices = {j: np.zeros(problem.size) for j in me.neighbours}
    distances = dict.fromkeys(prices, float("inf"))  # to each neighbour, when its last message was received
    x = problem.argmin(np.zeros(problem.size), 0.0)
    while True:
        change = max(distances.values(), default=0.0)
        inbox = yield PerNeighbour({j: {"x": x, "lam": lam} for j, lam in prices.items()}), change
        for j, payload in inbox.items():
            if inbox.new(j):
                difference = x - payload["x"]
                prices[j] = (prices[j] - payload["lam"]) / 2 + step * difference
                distances[j] = float(abs(difference).max())
        x = problem.argmin(np.sum([np.zeros(problem.size), *prices.values()], axis=0), 0.0)
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
