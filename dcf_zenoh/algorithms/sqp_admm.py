"""Decentralised sequential quadratic programming with an inner ADMM over the edges of the graph."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import Count, Fraction, needs
from dcf_zenoh.algorithms.shared.coupling import gather, linearised, local_problem
from dcf_zenoh.algorithms.shared.edge_copies import EdgeCopies
from dcf_zenoh.algorithms.shared.local_qp import LocalQP, Solution
from dcf_zenoh.plant import nothing
from dcf_zenoh.problems.problem import NonlinearGame
from dcf_zenoh.spec import PositiveFloat


@needs(NonlinearGame, links="undirected", agents=2)
def sqp_admm(
    game: NonlinearGame,
    me: Me,
    *,
    penalty: PositiveFloat = 5.0,
    relax: Fraction = 0.9,
    inner: Count = 10,
    multiplier_max: PositiveFloat | None = 1e3,
) -> Dialogue[Result]:
    """Linearise the constraints at the present plans, agree on new plans by ADMM, and repeat.

    Agent i keeps a copy x of all plans. An outer iteration replaces the constraints c(y) <= 0 that it takes part in by
    ``c + c'(x - x_k) <= 0`` at its copies x_k, and adds their curvature at the present prices, which `curvature` makes
    positive semidefinite. `inner` rounds of the ADMM of `admm_mpc` follow on the resulting quadratic program; z carries
    over from one outer iteration to the next. OSQP is set up in every outer iteration and starts from its last
    solution.

    It converges locally, near a minimiser of the sum of costs that satisfies the second-order conditions, on any
    connected graph, if there are enough inner rounds; with too few on a sparse graph it cycles. Lost messages only
    delay it. The residual is the largest change of x, distance of x to the point of linearisation, or change of the
    edge variables.

    Args:
        game: This agent's share of the game, which must have a potential: equal prices of the mean. No agent may be
            lost.
        me: This agent.
        penalty: rho.
        relax: alpha.
        inner: Rounds of each outer iteration.
        multiplier_max: Price of violating a shared constraint where the local problem has no solution; bounds its
            multipliers. None: such a step is an error.

    Raises:
        AlgorithmError: The game has no potential, or the local problem has no solution; the message tells the
            reason.

    Source: Stomberg, Engelmann, Faulwasser, "Decentralized non-convex optimization via bi-level SQP and ADMM", IEEE
    Conference on Decision and Control, 2022; with a fixed number of inner rounds as in Stomberg, Ebel, Faulwasser,
    Eberhard, "Cooperative distributed MPC via decentralized real-time optimization: implementation results for robot
    formations", Control Engineering Practice, 2023; the edges: see `EdgeCopies`.
    """
    plan = game.start(me.last)
    shares = yield from gather(me, game, plan)
    if shares is None:
        return me.result(plan)
    local = local_problem(me.id, shares)
    copies = EdgeCopies(me, game, tuple(shares), local, penalty, relax)
    x, number = copies.last or Solution(np.tile(game.start(None), len(shares)), nothing()), 0
    while True:
        if number % inner == 0:
            qp, near = LocalQP(linearised(local, game, shares, x), copies.weight, x, multiplier_max), x.v
        new, number = qp.solve(copies.pull), number + 1
        change = max(float(abs(new.v - x.v).max()), float(abs(new.v - near).max()), copies.moved)
        x = new
        me.note(u=x.v[copies.own], iterations=qp.iterations, softened=qp.softened)
        me.violated = qp.softened
        inbox = yield copies.payloads(x.v), change
        copies.update(inbox)
        if inbox.stop:
            return me.result(x.v[copies.own], **copies.memory(x))
