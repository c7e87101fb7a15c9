"""The position swap of point masses in plain Python: controllers in lockstep, no exchange, no clock."""

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from dcf_zenoh.algorithms.trades_robust import trades_robust
from dcf_zenoh.controllers.receding_horizon import RecedingHorizon
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array, State
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.testing import Delay, converse, fleet_of

STARTS = {1: (0.0, 1.0), 2: (0.0, -1.0), 3: (1.0, 0.0), 4: (-1.0, 0.0)}
SAMPLE_TIME, ACCEL_MAX = 0.2, 2.0
RADII = np.array([0.5, 0.25])
COMPLETE = Graph.of(STARTS, [(i, j) for i in STARTS for j in STARTS if i != j])


class Flight(NamedTuple):
    """What came of it: when all had arrived (s), the least h of any two agents, and sums of the notes."""

    arrival: float | None
    least_barrier: float
    notes: dict[str, float]


def fly(
    links: Callable[[int], Delay], *, rounds: int, graph: Graph = COMPLETE, stops: Mapping[int, int] | None = None
) -> Flight:
    """Fly for up to 25 s, until all have been within 5 cm of their targets for 1 s.

    Args:
        links: Step -> what its links do.
        rounds: Of every step.
        graph: Who hears whom.
        stops: Agent -> step from which it brakes and stays.
    """
    agents, fleet = graph.agents, fleet_of(graph)
    controllers = {
        i: RecedingHorizon(
            PositionSwap(i, agents, SAMPLE_TIME, target=(-STARTS[i][0], -STARTS[i][1])),
            trades_robust, fleet[i], SAMPLE_TIME, sharing="piggyback",
        )
        for i in agents
    }  # fmt: skip
    position = {i: np.array(STARTS[i]) for i in agents}
    velocity = {i: np.zeros(2) for i in agents}
    least, settled, notes = np.inf, 0, dict[str, float]()
    for step in range(125):
        dialogues = {i: controllers[i].control(State(position[i], velocity[i]), step) for i in agents}
        decisions = converse(dialogues, fleet, rounds, links=links(step))
        for i, decision in decisions.items():
            for name, count in decision.notes.items():
                notes[name] = notes.get(name, 0.0) + count
            stopped = decision.setpoint is None or step >= (stops or {}).get(i, step + 1)
            wanted = None if stopped or decision.setpoint is None else decision.setpoint.acceleration
            applied = (-velocity[i] / SAMPLE_TIME if wanted is None else wanted).clip(-ACCEL_MAX, ACCEL_MAX)
            position[i] = position[i] + velocity[i] * SAMPLE_TIME + applied * SAMPLE_TIME**2 / 2
            velocity[i] = velocity[i] + applied * SAMPLE_TIME
        least = min(least, *(_barrier(position[i], position[j]) for i, j in combinations(agents, 2)))
        there = all(np.hypot(*(position[i] + STARTS[i])) < 0.05 for i in agents)
        settled = settled + 1 if there else 0
        if settled * SAMPLE_TIME > 1.0:
            return Flight((step + 1) * SAMPLE_TIME - 1.0, least, notes)
    return Flight(None, least, notes)


def _barrier(first: Array, second: Array) -> float:
    """h = |dx| / r1 + |dy| / r2 - 1, which the flight is to keep above 0."""
    return float((abs(first - second) / RADII).sum()) - 1
