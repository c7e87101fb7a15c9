"""Exchange of the shares of a game with shared constraints, and the local problem that an agent forms from them."""

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.algorithms.shared.local_qp import Solution
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import VariationalInequality, assemble
from dcf_zenoh.problems.problem import AggregativeGame, NonlinearGame
from dcf_zenoh.problems.share import Share, Shareable


def gather(me: Me, game: AggregativeGame, plan: Array) -> Dialogue[dict[int, Share] | None]:
    """Flood how each agent's decision enters the shared costs and constraints; its own cost stays private.

    Agents forward all shares that they have, until they have those of all agents and all neighbours have them too. Lost
    messages only delay it. It takes one or two rounds more than the graph's diameter; their residual is infinite.

    Args:
        me: This agent.
        game: This agent's share of the game.
        plan: Decision of this agent for the log of these rounds, shape (n,).

    Returns:
        Agent -> share, ascending, without lost agents; the costs H and g of the other agents are zero. None if the
        iteration ends before.

    Raises:
        AlgorithmError: The game has no `share` method.
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
            received = Share.all_in(payload)
            if len(received) in (0, count):  # without shares: a later round of a neighbour that has all of them
                waiting.discard(j)
            known = {**payload, **known} if received else known
        if inbox.stop:
            return None


def local_problem(agent: int, shares: dict[int, Share]) -> VariationalInequality:
    """Return the problem that an agent solves over copies of all decisions.

    Its cost is the agent's own cost and 1/N of the agents' cost of the mean; the sum over all agents is their common
    cost. Its constraints are the bounds of all agents and the linear constraints that this agent takes part in.

    Raises:
        AlgorithmError: There is no common cost, as agents pay differently for the mean.
    """
    count = len(shares)
    mine = shares[agent].A.any(axis=1) if shares[agent].A.size else slice(0)
    whole = assemble([
        replace(share, K=share.K / count, A=share.A[mine], b=share.b[mine]) for _, share in sorted(shares.items())
    ])  # fmt: skip
    if not whole.symmetric:
        raise AlgorithmError("the agents have no common cost to minimise, as they pay differently for the fleet's mean")
    return whole


def linearised(
    local: VariationalInequality, game: NonlinearGame, shares: dict[int, Share], near: Solution
) -> VariationalInequality:
    """Return `local` with the game's constraints c(y) <= 0 linearised at `near`: c + c'(y) T (v - near) <= 0.

    The curvature of the constraints, weighted by their prices, is added to that of the cost. Prices that `near` does
    not have count as zero.
    """
    outputs_of = [share for _, share in sorted(shares.items())]
    outputs = np.array([each.T @ near.v[place] + each.t for each, place in zip(outputs_of, local.places, strict=True)])
    c, derivative = game.constraints(outputs)
    T = block_diag(*(each.T for each in outputs_of))
    slope = derivative.reshape(len(c), -1) @ T
    prices = np.resize(np.maximum(near.prices[len(local.G) :], 0.0), len(c))
    return local._replace(
        M=local.M + T.T @ game.curvature(outputs, prices) @ T,
        G=np.vstack((local.G, slope)),
        low=np.concatenate((local.low, np.full(len(c), -np.inf))),
        high=np.concatenate((local.high, slope @ near.v - c)),
    )
