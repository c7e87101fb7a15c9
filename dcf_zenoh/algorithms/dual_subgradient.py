"""The dual subgradient method for shared constraints."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import CoupledProblem
from dcf_zenoh.spec import NonNegativeFloat, PositiveFloat


@needs(CoupledProblem, traits=("strongly_convex",), doubly_stochastic=True, alike=True, uses=("respond",))
def dual_subgradient(
    problem: CoupledProblem, me: Me, *, step: PositiveFloat = 1.0, decay: NonNegativeFloat = 0.7
) -> Dialogue[Result]:
    """Mix the prices of the shared constraints, minimise at that price, and update it by the agent's own excess.

    ``l = sum_j w_ij lam_j, x = argmin f + l'A x, lam+ = l + a_k (A x - b)``, projected on lam >= 0 for inequalities.
    Only prices are sent. With steps a_k = step / (k + 1)^decay, 1/2 < decay <= 1, it converges to the solution, slowly;
    with decay = 0 it stays near it. The residual is the largest change of x or of the price. The change of the price
    includes the agent's own excess times the step, so the steps must shrink for the residual to vanish.

    Args:
        problem: Cost, set and share of the constraints of this agent.
        me: This agent.
        step: First step size, a_0.
        decay: Exponent by which the steps shrink.

    Source: Falsone, Margellos, Garatti, Prandini, "Dual decomposition for multi-agent distributed optimization with
    coupling constraints", Automatica, 2017; without its averages, as costs are strongly convex.
    """
    lam = me.recall("lam", np.zeros(problem.rows))
    x = problem.respond(lam, 0.0, np.zeros(problem.rows))
    k, change = 0, float("inf")
    while True:
        inbox = yield {"lam": lam}, change
        mixed = me.mix(inbox, "lam")
        new = problem.respond(mixed, 0.0, np.zeros(problem.rows))
        raised = mixed + step / (k + 1) ** decay * problem.coupling(new)
        if not problem.equality:
            raised = np.maximum(raised, 0.0)
        change = max(float(abs(new - x).max()), float(abs(raised - lam).max()))
        x, lam = new, raised
        k += 1
        me.note(x=x, lam=lam)
        if inbox.stop:
            return me.result(x, lam=lam)
