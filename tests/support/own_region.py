"""A fleet whose problem is a plug-in in a file, with a safety region of its own: an ellipse, and one obstacle."""

from pathlib import Path

import numpy as np

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.plant import Array

AXES = (0.6, 0.3)  # m
CENTRE, RADIUS = (0.1, 0.9), 0.2  # m, of the obstacle, a circle

OWN_REGION = f"""
import numpy as np

from dcf_zenoh.problems.problem import MeanProblem
from dcf_zenoh.problems.shared.approach import Approach

AXES, CENTRE, RADIUS = np.array({AXES}), np.array({CENTRE}), {RADIUS}
TURN = np.linspace(0, 2 * np.pi, 60, endpoint=False)
CIRCLE = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)


class Leg(MeanProblem):
    def __init__(self, state, target, approach):
        self.value = np.zeros(1)
        self.state, self.target, self.approach = state, target, approach

    def setpoint(self, decision, stage):
        return self.approach.setpoint(*np.split(self.state, 2), self.target, stage)


class Straight:
    local = True

    def __init__(self, agent, sample_time, *, target: tuple[float, float]):
        self.agent, self.target = agent, np.array(target)
        self.approach = Approach.of(sample_time, 1.5, 2.0)

    def at(self, states):
        return Leg(states[self.agent], self.target, self.approach)

    def distance_to_go(self, state):
        return float(np.linalg.norm(state.position - self.target))


class Apart(Straight):
    def separation(self, own, other):
        return np.linalg.norm((own - other) / AXES, axis=-1) - 1


class Ellipse(Apart):
    def outline(self, position):
        return position + CIRCLE * AXES

    def clearances(self, position):
        return np.linalg.norm(position - CENTRE, axis=-1, keepdims=True) / RADIUS - 1

    def obstacle_outlines(self):
        return [CENTRE + CIRCLE * RADIUS]

    def deadlock(self, starts, targets):
        facing = all(np.array_equal(starts[i], targets[j]) for i, j in ((1, 2), (2, 1)))
        return "1 and 2 fly towards each other" if facing else None


class Fails(Ellipse):
    def separation(self, own, other):
        raise ZeroDivisionError("no such region")


class Flat(Ellipse):
    def separation(self, own, other):
        return 1.0


def Made(agent, sample_time, *, target: tuple[float, float]):
    return Ellipse(agent, sample_time, target=target)
"""

FLEET = """
name = "own_region"
plant = "point"
time = { clock = "virtual", sample_time = 0.2, duration = 3.0 }
exchange = { max_rounds = 100, threshold = 1e-3 }
topology.kind = "complete"
problem.kind = "./own_region.py:Ellipse"
algorithm.kind = "average_consensus"
plants.point.kind = "point_mass"
agents.1 = { start = [-1.0, 0.0], target = [1.0, 0.0] }
agents.2 = { start = [1.0, 0.0], target = [-1.0, 0.0] }
agents.3 = { start = [0.0, 1.5], target = [0.5, 0.5] }
"""


def write_fleet(folder: Path) -> Path:
    """Write the fleet file and its plug-in; return the file."""
    (folder / "own_region.py").write_text(OWN_REGION, encoding="utf-8")
    (folder / "fleet.toml").write_text(FLEET, encoding="utf-8")
    return folder / "fleet.toml"


def fly(folder: Path, kind: str = "Ellipse", out: Path | None = None) -> Run:
    """Simulate the fleet with one of the plug-in's problems."""
    return dcf_zenoh.simulate(write_fleet(folder), changes=[f"problem.kind=./own_region.py:{kind}"], out=out)


def ellipse(apart: Array) -> Array:
    """Return h = sqrt((dx / r1)² + (dy / r2)²) - 1, shape (...), of points `apart`, shape (..., 2), m."""
    h: Array = np.sqrt((apart[..., 0] / AXES[0]) ** 2 + (apart[..., 1] / AXES[1]) ** 2) - 1
    return h


def circle(position: Array) -> Array:
    """Return h of an agent with the obstacle, shape (...), at positions of shape (..., 2), m."""
    h: Array = np.sqrt((position[..., 0] - CENTRE[0]) ** 2 + (position[..., 1] - CENTRE[1]) ** 2) / RADIUS - 1
    return h
