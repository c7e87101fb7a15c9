"""Moments of a position swap, drawn by seed: agents apart from each other, on the move, and able to keep apart."""

from itertools import combinations

import numpy as np

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.diamond import barrier
from dcf_zenoh.problems.position_swap import PositionSwap, SwapGame

SAMPLE_TIME, RADII = 0.2, (0.5, 0.25)


def moment(
    seed: int, agents: tuple[int, ...], gather_weight: float = 1.0
) -> tuple[dict[int, SwapGame], dict[int, Array]]:
    """The games of one control step, and the decisions that one solver finds for all."""
    rng = np.random.default_rng(seed)
    while True:
        states = {i: np.concatenate((rng.uniform(-1.2, 1.2, 2), rng.normal(scale=0.4, size=2))) for i in agents}
        games = {
            i: PositionSwap(
                i, agents, SAMPLE_TIME, target=tuple(-states[i][:2]), gather_weight=gather_weight, gather_at=(0.5, -0.2)
            ).at(states)
            for i in agents
        }
        if all(barrier(states[i][:2] - states[j][:2], RADII) > 0.05 for i, j in combinations(agents, 2)):
            try:
                return games, solve_together({i: game.share() for i, game in games.items()})
            except AlgorithmError:
                continue  # too fast to keep apart: draw again
