"""Cooperative predictive control by consensus ADMM over the edges of the graph."""

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import Fraction, needs
from dcf_zenoh.algorithms.shared.coupling import gather, local_problem
from dcf_zenoh.algorithms.shared.edge_copies import EdgeCopies
from dcf_zenoh.algorithms.shared.local_qp import LocalQP
from dcf_zenoh.problems.problem import CoupledGame
from dcf_zenoh.spec import PositiveFloat


@needs(CoupledGame, links="undirected", agents=2)
def admm_mpc(
    game: CoupledGame,
    me: Me,
    *,
    penalty: PositiveFloat = 3.0,
    relax: Fraction = 0.9,
    multiplier_max: PositiveFloat | None = 1e3,
) -> Dialogue[Result]:
    """Plan for all, pay for oneself, agree on the plans edge by edge; a round is one quadratic program for each agent.

    Agent i keeps a copy x of the plans of all. Its own problem f_i(x) has its own cost, one part in N of the common
    one, and the shared constraints that it takes part in; what these are, the agents tell each other in the first
    rounds of a control step (see `gather`). With rho the penalty, alpha how far an edge follows and d the number of
    neighbours: ``x = argmin f_i - sum_j z_ij'x + rho d / 2 |x|²``, to j goes ``m_ij = 2 rho x - z_ij``, and what comes
    makes ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``.

    All agents being coupled to all, a plan is relayed where two of them are no neighbours: any connected graph will do.
    OSQP is set up once in a control step and starts from its last solution; z and that solution are kept from step to
    step, moved on by one stage. It converges to the least sum of costs for any penalty, at a linear rate once the
    active constraints are settled, and bears lost messages. The residual is the largest change of x and of what the
    edges ask for.

    Args:
        game: This agent's share of the game, which must have a potential: equal prices of the mean.
        me: This agent.
        penalty: rho.
        relax: alpha.
        multiplier_max: Bound of the multipliers of an agent's own problem where it has no solution: the price of
            violating a shared constraint. None: such a step is an error.

    Raises:
        AlgorithmError: The game has no potential, or the agent's own problem no solution; then the solver's status is
            in the message.

    Source: Summers and Lygeros, "Distributed model predictive consensus via the alternating direction method of
    multipliers", Allerton Conference, 2012; Rey, Pan, Hauswirth, Lygeros, "Fully decentralized ADMM for coordination
    and collision avoidance", European Control Conference, 2018; the edges: see `EdgeCopies`.
    """
    plan = game.start(me.last)
    shares = yield from gather(me, game, plan)
    if shares is None:
        return me.result(plan)
    local = local_problem(me.id, shares)
    copies = EdgeCopies(me, game, tuple(shares), local, penalty, relax)
    qp = LocalQP(local, copies.weight, copies.last, multiplier_max)
    x, change = qp.solve(copies.pull), float("inf")
    while True:
        inbox = yield copies.said(x.v), change
        copies.hear(inbox)
        new = qp.solve(copies.pull)
        change, x = max(float(abs(new.v - x.v).max()), copies.moved), new
        me.note(u=x.v[copies.own], iterations=qp.iterations, softened=qp.softened)
        if inbox.stop:
            return me.result(x.v[copies.own], **copies.memory(x))
