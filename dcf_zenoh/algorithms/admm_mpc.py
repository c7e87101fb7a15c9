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
    """Plan for all agents and agree on the plans edge by edge; each agent solves one quadratic program per round.

    Agent i keeps a copy x of all plans. Its local problem f_i(x) has its own cost, 1/N of the common cost, and the
    shared constraints that it takes part in, which the agents exchange in the first rounds of a control step (see
    `gather`). With rho the penalty, alpha the relaxation and d the number of neighbours, each round solves
    ``x = argmin f_i - sum_j z_ij'x + rho d / 2 |x|²``, sends ``m_ij = 2 rho x - z_ij`` to neighbour j, and updates
    ``z_ij+ = (1 - alpha) z_ij + alpha m_ji``.

    Copies of all plans are relayed from neighbour to neighbour, so any connected graph is enough. OSQP is set up once
    per control step and starts from its last solution. z and that solution are kept between steps, moved on by one
    stage. It converges to the least sum of costs for any penalty, at a linear rate once the set of active constraints
    is settled, and tolerates lost messages. The residual is the largest change of x or of the edge variables.

    Args:
        game: This agent's share of the game, which must have a potential: equal prices of the mean.
        me: This agent.
        penalty: rho.
        relax: alpha.
        multiplier_max: Price of violating a shared constraint where the local problem has no solution; bounds its
            multipliers. None: such a step is an error.

    Raises:
        AlgorithmError: The game has no potential, or the local problem has no solution; the message tells the
            reason.

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
        inbox = yield copies.payloads(x.v), change
        copies.update(inbox)
        new = qp.solve(copies.pull)
        change, x = max(float(abs(new.v - x.v).max()), copies.moved), new
        me.note(u=x.v[copies.own], iterations=qp.iterations, softened=qp.softened)
        me.violated = qp.softened
        if inbox.stop:
            return me.result(x.v[copies.own], **copies.memory(x))
