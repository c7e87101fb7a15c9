"""Consensus ADMM in its node form."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, links="undirected", agents=2, alike=True, uses=("argmin",))
def consensus_admm(problem: ConsensusProblem, me: Me, *, penalty: PositiveFloat = 1.0) -> Dialogue[Result]:
    """Minimise the cost at a price p of disagreement with the neighbours, and update the price.

    With c the penalty, p = 0 at first, and sums over the neighbours: ``p+ = p + c sum_j (x - x_j)``, then
    ``x+ = argmin f + p+'x + c sum_j |x - (x_i + x_j) / 2|²``. It sends one vector, needs neither gradients nor mixing
    weights, and converges for every penalty, linearly for strongly convex and smooth costs. The prices must sum to zero
    over the fleet, so a lost message leaves a bias. The residual is the largest distance to a neighbour or change of x.

    Args:
        problem: Cost and set of this agent.
        me: This agent.
        penalty: c.

    Source: Mateos, Bazerque, Giannakis, "Distributed sparse linear regression", IEEE Transactions on Signal Processing,
    2010; its rate: Shi, Ling, Yuan, Wu, Yin, "On the linear convergence of the ADMM in decentralized
    consensus optimization", IEEE Transactions on Signal Processing, 2014.
    """
    x = problem.start(me.last)
    p = np.zeros_like(x)
    change = float("inf")
    while True:
        inbox = yield {"x": x}, change
        others = [np.asarray(inbox[j]["x"]) for j in inbox]
        if others:
            apart = np.sum([x - other for other in others], axis=0)
            p = p + penalty * apart
            between = 2 * len(others) * x - apart  # the sum of x_i + x_j
            new = problem.argmin(p - penalty * between, 2 * penalty * len(others))
            change = max(float(abs(new - x).max()), *(float(abs(x - other).max()) for other in others))
            x = new
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
