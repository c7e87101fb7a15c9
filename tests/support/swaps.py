"""Moments of a position swap, drawn by seed: agents apart from each other, on the move, and able to keep apart."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import Bounds, minimize

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, nothing
from dcf_zenoh.problems.central import assemble, solve_together
from dcf_zenoh.problems.distance_swap import DistanceGame, DistanceSwap, clearance
from dcf_zenoh.problems.position_swap import PositionSwap, SwapGame
from dcf_zenoh.problems.problem import NonlinearGame
from dcf_zenoh.problems.shared.diamond import barrier
from dcf_zenoh.problems.shared.swap_options import CostOptions

SAMPLE_TIME, RADII, AT = 0.2, (0.5, 0.25), (0.5, -0.2)


def moment(seed: int, agents: tuple[int, ...], gather: float = 1.0) -> tuple[dict[int, SwapGame], dict[int, Array]]:
    """The games of one control step, and the decisions that one solver finds for all."""
    rng = np.random.default_rng(seed)
    while True:
        states = {i: np.concatenate((rng.uniform(-1.2, 1.2, 2), rng.normal(scale=0.4, size=2))) for i in agents}
        games = {
            i: PositionSwap(
                i, agents, SAMPLE_TIME, target=tuple(-states[i][:2]), cost=CostOptions(gather=gather, gather_at=AT)
            ).at(states)
            for i in agents
        }
        if all(barrier(states[i][:2] - states[j][:2], RADII) > 0.05 for i, j in combinations(agents, 2)):
            try:
                return games, solve_together({i: game.share() for i, game in games.items()})
            except AlgorithmError:
                continue  # too fast to keep apart: draw again


@cache
def distance_moment(seed: int, agents: tuple[int, ...]) -> tuple[dict[int, DistanceGame], dict[int, Array]]:
    """The games of one control step with distances, and the decisions that SLSQP finds for all.

    The problem is not convex; SLSQP starts from no input, as the agents do.
    """
    rng = np.random.default_rng(seed)
    while True:
        places = {i: rng.uniform(-1.2, 1.2, 2) for i in agents}
        apart = np.array([places[i] - places[j] for i, j in combinations(agents, 2)])
        states = {i: np.concatenate((place, rng.normal(scale=0.3, size=2))) for i, place in places.items()}
        games = {
            i: DistanceSwap(i, agents, SAMPLE_TIME, target=tuple(-place), cost=CostOptions(gather_at=AT)).at(states)
            for i, place in places.items()
        }
        if min(clearance(apart, np.array(RADII), np.zeros_like(apart))[0]) > 0.1:
            try:
                return games, together(games)
            except AlgorithmError:
                continue  # too fast to keep apart: draw again


def together(games: Mapping[int, NonlinearGame], start: Array | None = None) -> dict[int, Array]:
    """The decisions of all agents where their common cost is least near `start`, shape (N n,), by SLSQP."""
    shares = [replace(game.share(), T=nothing(), t=nothing()) for game in games.values()]  # type: ignore[attr-defined]
    whole = assemble(shares)
    T = block_diag(*(game.T for game in games.values()))
    t = np.concatenate([game.t for game in games.values()])

    def outputs(v: Array) -> Array:
        y: Array = (T @ v + t).reshape(len(games), -1)
        return y

    def limits(v: Array) -> tuple[Array, Array]:
        parts = [game.constraints(outputs(v)) for game in games.values()]
        return np.concatenate([c for c, _ in parts]), np.concatenate([d.reshape(len(d), -1) for _, d in parts]) @ T

    start = np.zeros(len(whole.r)) if start is None else start
    _, once = np.unique(limits(start + 0.01)[1].round(9), axis=0, return_index=True)  # both of a pair tell of it
    found = minimize(
        lambda v: v @ whole.M @ v / 2 + whole.r @ v,
        start,
        jac=lambda v: whole.M @ v + whole.r,
        bounds=Bounds(whole.low, whole.high),
        constraints={"type": "ineq", "fun": lambda v: -limits(v)[0][once], "jac": lambda v: -limits(v)[1][once]},
        method="SLSQP",
        options={"ftol": 1e-13, "maxiter": 100},
    )
    if found.status not in (0, 8):  # 8: no better by rounding
        raise AlgorithmError(found.message)
    return {i: np.asarray(found.x[place]) for i, place in zip(games, whole.places, strict=True)}
