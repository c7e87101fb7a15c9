"""Agents change places in the plane and keep a true distance: the position swap with ellipses instead of diamonds."""

import copy
from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import combinations
from typing import ClassVar

import numpy as np

from dcf_zenoh.plant import Array, Setpoint, State, nothing
from dcf_zenoh.problems.position_swap import PositionSwap, planar
from dcf_zenoh.problems.problem import NonlinearGame
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.swap_options import (
    DEFAULT_BARRIER,
    DEFAULT_COST,
    DEFAULT_PREDICTION,
    RENAMED,
    BarrierOptions,
    CostOptions,
    DiamondOptions,
    PredictionOptions,
)

IN_LINE = 0.01  # m; where a coordinate of two agents differs by less, they are in line
ASIDE = 0.1  # m; offset at which the tangent is then taken, of the one with the lower id
TINY = 1e-9  # least scaled distance, which has no derivative at 0


class DistanceSwap:
    """The game of `PositionSwap`, where the safety region is the ellipse around its diamond.

    Every pair keeps e = sqrt((dx / r1)² + (dy / r2)²) - 1 >= 0, by e[l+1] >= (1 - gamma) e[l] along the prediction;
    that is a distance where r1 = r2. It is not linear in the plans, and needs no signs that are held over the horizon.
    The diamond is in the ellipse, so its barrier h is at least e. Where two agents are in line, in x or in y, tangents
    of e next to their paths replace e, which leads them out of a deadlock face to face.

    Args:
        agent: Id of this agent.
        agents: Ids of all agents, ascending.
        sample_time: t_s, in s.
        target: Target of this agent, shape (2,), in m.
        prediction: Prediction of the agent's motion.
        cost: Weights of the agent's cost.
        barrier: Barrier constraints; the radii are the half axes of the ellipse.

    Raises:
        ValueError: The target does not have two coordinates.

    Source: as `PositionSwap`, with the distance that is usual in predictive control for its barrier.
    """

    SHARED = ("prediction.horizon", *(f"barrier.{each.name}" for each in fields(BarrierOptions)))
    RENAMED: ClassVar[Mapping[str, str]] = {
        old: new for old, new in RENAMED.items() if old not in ("barrier_margin", "obstacles")
    }

    def __init__(
        self,
        agent: int,
        agents: tuple[int, ...],
        sample_time: float,
        *,
        target: tuple[float, ...],
        prediction: PredictionOptions = DEFAULT_PREDICTION,
        cost: CostOptions = DEFAULT_COST,
        barrier: BarrierOptions = DEFAULT_BARRIER,
    ) -> None:
        self._swap = PositionSwap(
            agent,
            agents,
            sample_time,
            target=target,
            prediction=prediction,
            cost=cost,
            barrier=DiamondOptions(barrier.radii, barrier.decay),
        )

    @property
    def target(self) -> Array:
        """Target of this agent, shape (2,), in m."""
        return self._swap.target

    def toward(self, target: Array) -> "DistanceSwap":
        """Return the same problem with another target, shape (2,), in m."""
        other = copy.copy(self)
        other._swap = self._swap.toward(target)
        return other

    def distance_to_go(self, state: State) -> float:
        """Return the distance to the target in the plane, in m."""
        return self._swap.distance_to_go(state)

    def ahead(self, state: State, flown: Setpoint | None, delay: float) -> Array:
        """Return the state [position, velocity] after `delay` (s) with the setpoint `flown`, by the agent's model."""
        return self._swap.ahead(state, flown, delay)

    def check_starts(self, starts: Mapping[int, Array]) -> dict[int, str]:
        """Return agent -> text, for starts too close to an agent with a lower id."""
        found = self._swap.check_starts(starts)
        for i, j in combinations(sorted(starts.keys() - found.keys()), 2):
            apart = starts[i][np.newaxis, :2] - starts[j][:2]
            e = float(clearance(apart, np.array(self._swap.radii), np.zeros((1, 2)))[0][0])
            if e < 0:
                found[j] = f"agent {j} would start in the safety region of agent {i}: e = {e:.3g}, expected at least 0"
        return found

    def separation(self, own: Array, other: Array) -> Array:
        """Return the barrier value h of `PositionSwap`, shape (...): at least e, and comparable between the two."""
        return self._swap.separation(own, other)

    def outline(self, position: Array) -> Array:
        """Return the corners of the diamond in the ellipse around an agent at `position`, shape (4, 2), m."""
        return self._swap.outline(position)

    def at(self, states: Mapping[int, Array]) -> "DistanceGame":
        """Return the game of one control step, given agent -> [position, velocity], shape (2 d,) with d 2 or 3."""
        return DistanceGame(self._swap, {agent: planar(state) for agent, state in states.items()})


class DistanceGame(NonlinearGame):
    """One agent's view of the game of one control step; costs and bounds are those of `SwapGame`.

    An output is an agent's predicted path, [p[1], .., p[H]], shape (2 H,). The constraints are ordered by the other
    agent's id, then by stage. Their second derivative is indefinite, and is left out.
    """

    def __init__(self, swap: PositionSwap, states: Mapping[int, Array]) -> None:
        self._swap, self._game = swap, swap.at(states)
        self.agents, self._radii = swap.agents, np.array(swap.radii)
        self._here = np.array([states[i][:2] for i in swap.agents])
        self.T = np.vstack([lift[:2] for lift in swap.lifts[1:]])
        self.t = np.concatenate([power[:2] @ states[swap.agent] for power in swap.powers[1:]])

    def start(self, last: Array | None) -> Array:
        """Return the last plan shifted by one stage, or no input at all."""
        return self._game.start(last)

    def contribution(self, u: Array) -> Array:
        """Return phi(u), the predicted end position, shape (2,), in m."""
        return self._game.contribution(u)

    def gradient(self, u: Array, sigma: Array) -> Array:
        """Return the pseudo-gradient, shape (2 H,); see `SwapGame`."""
        return self._game.gradient(u, sigma)

    def project(self, u: Array) -> Array:
        """Return the nearest input within the bound."""
        return self._game.project(u)

    def brake(self) -> Array:
        """Return the accelerations that stop the body; see `SwapGame`."""
        return self._game.brake()

    def setpoint(self, decision: Array, stage: int) -> Setpoint | None:
        """Return the setpoint of `stage`; see `SwapGame`."""
        return self._game.setpoint(decision, stage)

    def constraints(self, outputs: Array) -> tuple[Array, Array]:
        """Return (1 - gamma) e[l] - e[l+1] of each other agent and l = 0 .. H-1, and its derivative."""
        swap, stages = self._swap, np.arange(self._swap.horizon)
        own, count, keep = swap.agents.index(swap.agent), len(swap.agents), 1 - swap.barrier_decay
        paths = np.concatenate((self._here[:, np.newaxis], outputs.reshape(count, len(stages), 2)), axis=1)
        values, derivatives = [], []
        for other in range(count):
            if other == own:
                continue
            first, second = min(own, other), max(own, other)
            aside = np.zeros((len(stages) + 1, 2))
            aside[1:] = np.where(abs(self._here[first] - self._here[second]) < IN_LINE, ASIDE, 0.0)
            e, slope = clearance(paths[first] - paths[second], self._radii, aside)
            values.append(keep * e[:-1] - e[1:])
            part = np.zeros((len(stages), count, len(stages) + 1, 2))
            part[stages, first, stages] = keep * slope[:-1]
            part[stages, first, stages + 1] = -slope[1:]
            part[:, second] = -part[:, first]
            derivatives.append(part[:, :, 1:].reshape(len(stages), count, -1))
        return np.concatenate(values), np.concatenate(derivatives)

    def share(self) -> Share:
        """Return cost, bounds, and the map from plan to path as arrays."""
        return replace(self._game.share(), A=nothing(), b=nothing(), T=self.T, t=self.t)


def clearance(apart: Array, radii: Array, aside: Array) -> tuple[Array, Array]:
    """Return e = |apart / radii| - 1 of pairs of points, shape (k,), and its derivative, shape (k, 2).

    Args:
        apart: From one point to the other, shape (k, 2), in m.
        radii: r1, r2, in m.
        aside: Where it is not zero, the tangent of e at `apart + aside` replaces e; it is nowhere above e, which is
            convex. Shape (k, 2), in m.
    """
    scaled = (apart + aside) / radii
    length = np.hypot(scaled[:, 0], scaled[:, 1])
    slope = scaled / radii / np.maximum(length, TINY)[:, np.newaxis]
    return length - 1 - (slope * aside).sum(axis=1), slope
