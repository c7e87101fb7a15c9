"""Try the algorithm without a fleet: does it keep the contract, and does it find the equilibrium?

python examples/algorithm/check_my_tracking.py
"""
from functools import partial

import numpy as np
from my_tracking import my_tracking

from dcf_zenoh.graph import Graph
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.testing import check_algorithm, fleet_of, lockstep

starts = {1: (0.0, 1.0), 2: (0.0, -1.0), 3: (1.0, 0.0), 4: (-1.0, 0.0)}             # m
ring = Graph.of(starts, [(1, 2), (2, 1), (2, 3), (3, 2), (3, 4), (4, 3), (4, 1), (1, 4)])


def games():
    """The game of the first control step: agent -> its share. All are at rest at their starts."""
    states = {i: np.array([*start, 0.0, 0.0]) for i, start in starts.items()}       # [px, py, vx, vy]
    return {i: PositionSwap(i, tuple(starts), 0.2, target=(-x, -y)).at(states) for i, (x, y) in starts.items()}


def check():
    # 1. The contract: it stops on inbox.stop, accepts missing neighbours, modifies no payload and is repeatable.
    check_algorithm(my_tracking, games, ring)

    # 2. The answer: all agents find the solution of a central solver, which has the games of all.
    found = lockstep(partial(my_tracking, step=0.05), games(), fleet_of(ring), rounds=1000)
    central = solve_together({i: game.share() for i, game in games().items()})
    return max(abs(found[i].decision - central[i]).max() for i in starts)


if __name__ == "__main__":
    print(f"contract kept; largest distance to the central solution: {check():.1e}")
