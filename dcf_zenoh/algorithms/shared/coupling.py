"""What an agent must know of the others where constraints are shared, and the problem that it makes of it."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.algorithms.shared.local_qp import Solution
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import Whole, assembled
from dcf_zenoh.problems.problem import AggregativeGame, NonlinearGame
from dcf_zenoh.problems.share import Share, Shareable


def gather(me: Me, game: AggregativeGame, plan: Array) -> Dialogue[dict[int, Share] | None]:
    """Tell how the own decision enters what is shared, and learn it of all others; the own cost is told to nobody.

    All pass on what they know, until they know of all and all neighbours have said the same; lost messages make it
    later. It takes one or two rounds more than the graph's diameter, whose residual is infinite.

    Args:
        me: This agent.
        game: Its share of the game.
        plan: Its decision until then, for the log.

    Returns:
        Agent -> its share, ascending, costs of others being zero; None if the iteration is over before. Agents that
        are lost are left out.

    Raises:
        AlgorithmError: The game cannot be told as arrays.
    """
    if not isinstance(game, Shareable):
        raise AlgorithmError(f"the agents must tell their shares, and {type(game).__name__} has no method share()")
    own = game.share()
    count = sum(i not in game.lost for i in me.agents)
    waiting = {j for j in me.neighbours if j not in game.lost}
    known = replace(own, H=np.zeros_like(own.H), g=np.zeros_like(own.g)).to_payload(me.id)
    while True:
        shares = Share.all_in(known)
        if len(shares) == count and not waiting:
            return {**shares, me.id: own}
        me.note(u=plan)
        inbox = yield known, float("inf")
        for j, payload in inbox.items():
            told = Share.all_in(payload)
            if len(told) in (0, count):  # one that speaks of other things knew all before
                waiting.discard(j)
            known = {**payload, **known} if told else known
        if inbox.stop:
            return None


def local_problem(agent: int, shares: dict[int, Share]) -> Whole:
    """What an agent solves over copies of all decisions: the central problem, but nobody else pays for his own.

    It pays its own cost and one part in N of what the agents pay for the mean, and keeps the linear constraints that it
    takes part in, and everybody's bounds. The sum over all agents is what they minimise together.

    Raises:
        AlgorithmError: There is no such common cost, as agents pay differently for the mean.
    """
    count = len(shares)
    mine = shares[agent].A.any(axis=1) if shares[agent].A.size else slice(0)
    whole = assembled([
        replace(share, K=share.K / count, A=share.A[mine], b=share.b[mine]) for _, share in sorted(shares.items())
    ])  # fmt: skip
    if not whole.symmetric:
        raise AlgorithmError("the agents have no common cost to minimise, as they pay differently for the fleet's mean")
    return whole


def linearised(local: Whole, game: NonlinearGame, shares: dict[int, Share], near: Solution) -> Whole:
    """`local` with the game's constraints c(y) <= 0 as they are near a solution: c + c'(y) T (v - near) <= 0.

    The curvature of the constraints, at their prices, is added to that of the cost; a solution without prices has none.
    """
    told = [share for _, share in sorted(shares.items())]
    outputs = np.array([each.T @ near.v[place] + each.t for each, place in zip(told, local.places, strict=True)])
    c, derivative = game.constraints(outputs)
    T = block_diag(*(each.T for each in told))
    slope = derivative.reshape(len(c), -1) @ T
    prices = np.resize(np.maximum(near.prices[len(local.G) :], 0.0), len(c))
    return local._replace(
        M=local.M + T.T @ game.curvature(outputs, prices) @ T,
        G=np.vstack((local.G, slope)),
        low=np.concatenate((local.low, np.full(len(c), -np.inf))),
        high=np.concatenate((local.high, slope @ near.v - c)),
    )
