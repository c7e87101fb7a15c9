"""Tracking-ADMM for shared constraints."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import CoupledProblem
from dcf_zenoh.spec import PositiveFloat


@needs(CoupledProblem, traits=("equality",), links="undirected", doubly_stochastic=True, alike=True, uses=("respond",))
def tracking_admm(problem: CoupledProblem, me: Me, *, penalty: PositiveFloat = 1.0) -> Dialogue[Result]:
    """Run parallel ADMM with its central quantities tracked: the mean excess d of the constraints and their price lam.

    With c the penalty, D and L the mixed d and lam, and d = A x - b at first:
    ``x+ = argmin f + L'A x + c / 2 |A x - A x_before + D|²``, ``d+ = D + A x+ - A x_before``, ``lam+ = L + c d+``.
    It sends d and lam and converges for every penalty and any convex costs; no rate is proved, but it is linear on the
    built-in quadratic problems. The mean of d must be kept, so a lost message leaves a bias. The residual is the
    largest change of A x, entry of d, or change of the price.

    Args:
        problem: Cost, set and share of the constraints of this agent; the constraints are equations.
        me: This agent.
        penalty: c.

    Source: Falsone, Notarstefano, Margellos, Prandini, "Tracking-ADMM for distributed constraint-coupled optimization",
    Automatica, 2020.
    """
    lam = me.recall("lam", np.zeros(problem.rows))
    x = problem.respond(lam, penalty, problem.b)
    d = problem.coupling(x)
    change = float("inf")
    while True:
        inbox = yield {"d": d, "lam": lam}, change
        mixed, price = me.mix(inbox, "d"), me.mix(inbox, "lam")
        used = problem.A @ x
        x = problem.respond(price, penalty, used - mixed)
        move = problem.A @ x - used
        d = mixed + move
        change = max(float(abs(each).max()) for each in (move, d, price + penalty * d - lam))
        lam = price + penalty * d
        me.note(x=x, lam=lam)
        if inbox.stop:
            return me.result(x, lam=lam)
