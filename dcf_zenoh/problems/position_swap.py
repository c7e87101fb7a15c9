"""Agents change places in the plane; each predicts its own motion, and diamond-shaped regions keep them apart."""

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.problems.problem import CoupledGame
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.deadlock import straight_across
from dcf_zenoh.problems.shared.diamond import SAME_COORDINATE, Obstacle, outline, side
from dcf_zenoh.problems.shared.diamond import barrier as barrier_value
from dcf_zenoh.problems.shared.prediction import Prediction, state_ahead
from dcf_zenoh.problems.shared.swap_options import (
    DEFAULT_COST,
    DEFAULT_DIAMONDS,
    DEFAULT_PREDICTION,
    RENAMED,
    CostOptions,
    DiamondOptions,
    PredictionOptions,
)

_NO_SIGNS: Mapping[tuple[int, int], Array] = MappingProxyType({})


class PositionSwap:
    """The aggregative game of the paper, posed anew at every control step.

    Each agent predicts its own motion over H steps of its input u (planar accelerations, in order of time, shape
    (2 H,)), with its own model. Its cost is made of the distance to its target, the effort, and the distance of the
    fleet's mean end position from `gather_at`. Every pair of agents shares H barrier constraints, and every agent has H
    with each obstacle: rows like the others, in which it alone takes part.

    Agents may differ in weights, bounds and model, because each of a pair knows its own term of their constraints. All
    agents must scale the constraints by the same numbers, so these follow from the nominal weights and model instead of
    the agent's own.

    Args:
        agent: Id of this agent.
        agents: Ids of all agents, ascending.
        sample_time: t_s, in s.
        nominal: Key -> value at an agent without overrides, of all keys that have a default. None: as at this agent.
        target: Target of this agent, shape (2,), in m.
        prediction: Prediction of the agent's motion.
        cost: Weights of the agent's cost.
        barrier: Barrier constraints.

    Raises:
        ValueError: The target does not have two coordinates.

    Source: Memon et al., Section IV; barrier constraints after do Nascimento, Papachristodoulou, Margellos, CDC 2023.
    """

    SHARED = ("prediction.horizon", *(f"barrier.{each.name}" for each in fields(DiamondOptions)))  # same constraints
    RENAMED: ClassVar[Mapping[str, str]] = RENAMED

    def __init__(
        self,
        agent: int,
        agents: tuple[int, ...],
        sample_time: float,
        nominal: Mapping[str, Any] | None = None,
        *,
        target: tuple[float, ...],
        prediction: PredictionOptions = DEFAULT_PREDICTION,
        cost: CostOptions = DEFAULT_COST,
        barrier: DiamondOptions = DEFAULT_DIAMONDS,
    ) -> None:
        if len(target) < 2:
            raise ValueError(f"target must be [x, y] in m, not {list(target)}")
        self.agent = agent
        self.agents = agents
        self.horizon = prediction.horizon
        self.accel_max = prediction.accel_max
        self.velocity_lag = prediction.velocity_lag
        self.radii = barrier.radii
        self.barrier_decay = barrier.decay
        self.barrier_margin = barrier.margin
        self.obstacles = tuple(map(Obstacle.of, barrier.obstacles))
        self.sample_time = sample_time
        self.target = read_only(target[:2])
        self.gather_at = read_only(cost.gather_at)
        self.pairs = tuple(combinations(agents, 2))
        self.rows = (len(self.pairs) + len(agents) * len(self.obstacles)) * self.horizon

        own = Prediction.of(sample_time, prediction, cost)
        self.powers, self.lifts, self.quadratic, self.linear = own
        self.end_map = self.lifts[-1][:2]  # Phi: u -> end position
        self.end_free = self.powers[-1][:2]  # state -> end position without input
        self.gather_map = (2 * cost.gather / len(agents) ** 2) * self.end_map.T

        self.barrier_input, self.barrier_state = _barrier_maps(own, self.barrier_decay)
        agreed = own if nominal is None else Prediction.of(sample_time, nominal["prediction"], nominal["cost"])
        self.row_scale = self._row_scale(agreed, self.radii, 2)
        self.obstacle_scales = [self._row_scale(agreed, each.radii, 1) for each in self.obstacles]
        for array in (self.gather_map, self.row_scale, *self.obstacle_scales, *self.barrier_input, *self.barrier_state):
            array.setflags(write=False)

    def _row_scale(self, agreed: Prediction, radii: tuple[float, float], movers: int) -> Array:
        """Return 1 / sqrt(movers r (2M)^-1 r') for each row r; with it the dual of a row has unit curvature.

        The scale does not depend on signs. Each of the `movers`, the agents that take part in a row, adds to the
        curvature as much as one with the `agreed` prediction; an agent with a higher input weight adds less.
        """
        weights = np.array([1 / radii[0], 1 / radii[1]])
        inverse = np.linalg.inv(2 * agreed.quadratic)
        rows = [weights @ matrix for matrix in _barrier_maps(agreed, self.barrier_decay)[0]]
        return np.array([1 / np.sqrt(movers * row @ inverse @ row) for row in rows])

    def check_starts(self, starts: Mapping[int, Array]) -> dict[int, str]:
        """Return agent -> text, for starts in an obstacle or too close to an agent with a lower id."""
        found = {i: f"expected [x, y], in m, not {start.tolist()}" for i, start in starts.items() if len(start) < 2}
        if found:
            return found
        (r1, r2), least = self.radii, self.barrier_margin
        for i, j in combinations(sorted(starts), 2):
            apart = abs(starts[i][:2] - starts[j][:2])
            if (h := float(barrier_value(apart, self.radii))) < least - SAME_COORDINATE:
                found[j] = (
                    f"agent {j} would start in the safety region of agent {i}: h = {h:.3g}, expected at least {least:g}"
                    f" (they are {apart[0]:.3g} m apart in x and {apart[1]:.3g} m in y; radii {r1:g} m and {r2:g} m)"
                )
        for i, start in starts.items():
            for number, obstacle in enumerate(self.obstacles, 1):
                if (h := float(obstacle.barrier(start))) < least - SAME_COORDINATE:
                    found[i] = f"agent {i} would start in obstacle {number}: h = {h:.3g}, expected at least {least:g}"
        return found

    def separation(self, own: Array, other: Array) -> Array:
        """Return the barrier value h of pairs of positions, shape (...), at positions of shape (..., d), m."""
        return barrier_value(own[..., :2] - other[..., :2], self.radii)

    def outline(self, position: Array) -> Array:
        """Return the corners of the diamond around an agent at `position`, shape (4, 2), m."""
        return outline(position[:2], self.radii)

    def clearances(self, position: Array) -> Array:
        """Return the barrier value h with each obstacle, shape (..., obstacles), at positions of shape (..., d), m."""
        found = np.empty((*position.shape[:-1], len(self.obstacles)))
        for number, obstacle in enumerate(self.obstacles):
            found[..., number] = obstacle.barrier(position)
        return found

    def obstacle_outlines(self) -> Sequence[Array]:
        """Return the corners of each obstacle, each of shape (4, 2), m."""
        return [obstacle.outline() for obstacle in self.obstacles]

    def deadlock(self, starts: Mapping[int, Array], targets: Mapping[int, Array]) -> str | None:
        """Return a note if all agents go straight across one circle, in a way that is known to end in a deadlock."""
        ways = [(starts[i][:2], targets[i][:2]) for i in starts if min(len(starts[i]), len(targets[i])) > 1]
        if len(ways) == len(starts) and straight_across(*np.array(ways, dtype=float).swapaxes(0, 1)):
            return "all go straight across one circle, which is known to end in a deadlock"
        return None

    def toward(self, target: Array) -> "PositionSwap":
        """Return the same problem with another target, shape (2,), in m."""
        other = copy.copy(self)
        other.target = read_only(target)
        return other

    def distance_to_go(self, state: State) -> float:
        """Return the distance to the target in the plane, in m."""
        return float(np.hypot(*(state.position[:2] - self.target)))

    def ahead(self, state: State, flown: Setpoint | None, delay: float) -> Array:
        """Return the state [position, velocity] after `delay` (s) with the setpoint `flown`, by the agent's model."""
        return state_ahead(state, flown, delay, self.velocity_lag)

    def signs(self, states: Mapping[int, Array]) -> dict[tuple[int, int], Array]:
        """Return the sides on which this agent and each other agent pass one another.

        Args:
            states: Agent -> [position, velocity], shape (2 d,) with d 2 or 3, of some agents.

        Returns:
            Pair i < j -> signs of p_i - p_j in x and y, shape (2,), each 1 or -1; equal coordinates count as 1. Only
            pairs with this agent, and with both states given.
        """
        own = [pair for pair in self.pairs if self.agent in pair and pair[0] in states and pair[1] in states]
        return {(i, j): side(states[i][:2] - states[j][:2]) for i, j in own}

    def at(
        self,
        states: Mapping[int, Array],
        *,
        signs: Mapping[tuple[int, int], Array] = _NO_SIGNS,
        lost: Collection[int] = (),
    ) -> "SwapGame":
        """Return the game of one control step.

        Args:
            states: Agent -> [position, velocity], shape (2 d,) with d 2 or 3, of every agent.
            signs: Pair i < j -> signs to be used for it instead of those of `states`. Both agents of a pair must use
                the same.
            lost: Agents that take no part. The others keep clear of their positions, which are assumed not to change.
        """
        flat = {agent: planar(state) for agent, state in states.items()}
        return SwapGame(self, flat, {**self.signs(flat), **signs}, lost)


class SwapGame(CoupledGame):
    """One agent's view of the game of one control step.

    Local cost f(u) = u'Mu + 2g'u, contribution phi(u) = Phi u + phi0 to the mean end position sigma, box
    |u| <= accel_max, and its share A u - b of the coupling constraints sum_i (A_i u_i - b_i) <= 0, whose rows are
    ordered by pair of ids, then by stage; after them those of agent and obstacle, ordered in the same way.

    Attributes:
        A: Shape (rows, 2 H).
        b: Shape (rows,).
        rows: Number of coupling constraints.
    """

    def __init__(
        self,
        problem: PositionSwap,
        states: Mapping[int, Array],
        signs: Mapping[tuple[int, int], Array],
        lost: Collection[int],
    ) -> None:
        self._problem = problem
        self.lost = lost
        self._state = states[problem.agent]
        deviation = self._state - np.array([*problem.target, 0.0, 0.0])
        self._hessian = 2 * problem.quadratic
        self._slope = 2 * problem.linear @ deviation
        self._end_free = problem.end_free @ self._state
        self.rows = problem.rows
        self.A, self.b = self._barriers(states, signs, lost)

    def _barriers(
        self, states: Mapping[int, Array], signs: Mapping[tuple[int, int], Array], lost: Collection[int]
    ) -> tuple[Array, Array]:
        """Return A and b, the agent's share of the barrier rows, with signs held over the horizon.

        With w = (s_x / r1, s_y / r2) and delta the position difference of a pair, the barrier
        h = |delta_x| / r1 + |delta_y| / r2 - 1 is at least w . delta - 1, and the rows keep
        w . (delta[l+1] - (1 - gamma) delta[l]) - gamma >= 0, half of gamma charged to each of the two. A share
        alone has no meaning, because it depends on the origin; so the share of a lost agent or an obstacle, which
        stands still (u_j = 0), is charged to the agent as well.
        """
        problem, radii = self._problem, np.array(self._problem.radii)
        A, b = np.zeros((self.rows, 2 * problem.horizon)), np.zeros(self.rows)
        floor = problem.barrier_decay * (1 + problem.barrier_margin)  # gamma (1 + margin): h stays above the margin

        def fill(place: int, w: Array, scale: Array, obstacle: Array | None) -> None:
            """Write the rows at `place`: one agent's half, or all of them with an `obstacle` at that position."""
            for stage in range(problem.horizon):
                row = place * problem.horizon + stage
                A[row] = -scale[stage] * (w @ problem.barrier_input[stage])
                kept = w @ problem.barrier_state[stage] @ self._state - floor / 2
                if obstacle is not None:
                    kept -= w @ problem.barrier_state[stage] @ np.array([*obstacle, 0.0, 0.0]) + floor / 2
                b[row] = scale[stage] * kept

        for place, (i, j) in enumerate(problem.pairs):
            if problem.agent in (i, j):
                other, sign = (j, 1.0) if problem.agent == i else (i, -1.0)
                fill(place, sign * signs[i, j] / radii, problem.row_scale, states[other][:2] if other in lost else None)
        place = len(problem.pairs) + problem.agents.index(problem.agent) * len(problem.obstacles)
        for each, scale in zip(problem.obstacles, problem.obstacle_scales, strict=True):
            fill(place, side(self._state[:2] - each.at) / each.radii, scale, each.at)
            place += 1
        return A, b

    def start(self, last: Array | None) -> Array:
        """Return the start of the iteration: the last plan shifted by one stage, or no input at all."""
        if last is None:
            return np.zeros(2 * self._problem.horizon)
        return np.concatenate((last[2:], last[-2:]))

    def contribution(self, u: Array) -> Array:
        """Return phi(u), the predicted end position, shape (2,), in m."""
        return self._problem.end_map @ u + self._end_free

    def coupling(self, u: Array) -> Array:
        """Return A u - b, shape (rows,)."""
        return self.A @ u - self.b

    def gradient(self, u: Array, sigma: Array) -> Array:
        """Return the pseudo-gradient 2Mu + 2g + (2 p_a / N²) Phi'(sigma - p_o), shape (2 H,).

        p_a / N comes from the cost and 1 / N from sigma's dependence on u, as in Carnevale et al., eq. (3).
        """
        problem = self._problem
        slope: Array = self._hessian @ u + self._slope + problem.gather_map @ (sigma - problem.gather_at)
        return slope

    def project(self, u: Array) -> Array:
        """Return the nearest input within the bound."""
        bound = self._problem.accel_max
        return np.minimum(np.maximum(u, -bound), bound)

    def brake(self) -> Array:
        """Return the accelerations that stop the body as fast as its limit allows."""
        problem, velocity, plan = self._problem, self._state[2:], []
        for _ in range(problem.horizon):
            plan.append((-velocity / problem.sample_time).clip(-problem.accel_max, problem.accel_max))
            velocity = velocity + problem.sample_time * plan[-1]
        return np.concatenate(plan)

    def share(self) -> Share:
        """Return the problem as arrays."""
        problem, bound = self._problem, np.full(len(self._slope), self._problem.accel_max)
        return Share(
            self._hessian,
            self._slope - problem.gather_map @ problem.gather_at,
            -bound,
            bound,
            K=problem.gather_map,
            Phi=problem.end_map,
            phi=self._end_free,
            A=self.A,
            b=self.b,
        )

    def setpoint(self, decision: Array, stage: int) -> Setpoint | None:
        """Return the acceleration of `stage`, and the prediction at its end; None beyond the horizon.

        With a lag the velocity is the command to the body, which the body does not quite reach.
        """
        problem = self._problem
        if stage >= problem.horizon:
            return None
        ahead = problem.powers[stage + 1] @ self._state + problem.lifts[stage + 1] @ decision
        acceleration, velocity = decision[2 * stage : 2 * stage + 2], ahead[2:]
        if problem.velocity_lag is not None:
            before = problem.powers[stage] @ self._state + problem.lifts[stage] @ decision
            velocity = before[2:] + problem.sample_time * acceleration
        return Setpoint(ahead[:2], velocity, acceleration)


def planar(state: Array) -> Array:
    """Return [px, py, vx, vy] of [position, velocity], shape (2 d,) with d 2 or 3."""
    half = len(state) // 2
    return np.array([*state[:2], *state[half : half + 2]])


def _barrier_maps(prediction: Prediction, decay: float) -> tuple[list[Array], list[Array]]:
    """Return the matrices from input and from state to p[l+1] - (1 - gamma) p[l], l = 0 .. H-1, in the prediction."""
    powers, lifts, keep = prediction.powers, prediction.lifts, 1 - decay
    stages = range(len(lifts) - 1)
    return (
        [(lifts[step + 1] - keep * lifts[step])[:2] for step in stages],
        [(powers[step + 1] - keep * powers[step])[:2] for step in stages],
    )
