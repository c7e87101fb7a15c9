"""Agents fly in a formation, whose place they agree on."""

from collections.abc import Mapping

import numpy as np

from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.problems.average import Average
from dcf_zenoh.problems.problem import ConsensusProblem, MeanProblem
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.approach import Approach


class Formation:
    """Each agent has a place in the formation; in every control step all agree on the position of its centre.

    The centre is the mean of the agents' proposals. An agent at p proposes p - offset, so that it need not move; one
    with a goal proposes a point on the way from there to the goal. Then each flies to the centre + offset, and the
    formation moves to the goal. The agents do not avoid collisions on the way.

    Args:
        agent: Id of this agent.
        sample_time: t_s, s.
        offset: Place of the agent relative to the centre, shape (d,), m. Of a body in more dimensions, the first d are
            flown.
        goal: Goal of the centre, shape (d,), m; None: the agent has none.
        pull: Share of the way to the goal that the agent proposes: 1 is the goal itself, more is beyond it, which is
            faster where other agents have no goal.
        pace: Bandwidth of the approach to the places, rad/s; see `Approach`.
        accel_max: Bound on each component of the acceleration, m/s².

    Attributes:
        local: The problem of an agent follows from its own state alone.
        place: Place to which the agent flew in the last step, shape (d,), m; None before the first one.

    Raises:
        ValueError: A number is out of its range, or `goal` and `offset` differ in length.
    """

    local = True

    def __init__(
        self,
        agent: int,
        sample_time: float,
        *,
        offset: tuple[float, ...],
        goal: tuple[float, ...] | None = None,
        pull: float = 1.0,
        pace: float = 1.5,
        accel_max: float = 2.0,
    ) -> None:
        if not offset:
            raise ValueError("offset must have at least one component, in m")
        if goal is not None and len(goal) != len(offset):
            raise ValueError(f"goal has {len(goal)} components, offset has {len(offset)}")
        if not pull > 0:
            raise ValueError(f"pull must be positive, not {pull}")
        self.agent = agent
        self.offset = read_only(offset)
        self.place: Array | None = None
        self.approach = Approach.of(sample_time, pace, accel_max)
        self._goal = None if goal is None else read_only(goal)
        self._pull = pull

    def at(self, states: Mapping[int, Array]) -> "CentreConsensus":
        """Return the problem of one control step, given agent -> [position, velocity], of this agent at least."""
        d = len(self.offset)
        position, velocity = (part[:d] for part in np.split(states[self.agent], 2))
        wanted = position - self.offset
        if self._goal is not None:
            wanted = wanted + self._pull * (self._goal - wanted)
        return CentreConsensus(self, position, velocity, wanted)

    def distance_to_go(self, state: State) -> float:
        """Return the distance to the place at the goal, m; without a goal, to `place` (infinite before step 0)."""
        end = self.place if self._goal is None else self._goal + self.offset
        return float("inf") if end is None else float(np.linalg.norm(state.position[: len(end)] - end))


class CentreConsensus(MeanProblem, ConsensusProblem):
    """One agent's part in the choice of the centre, in one control step.

    Attributes:
        value: Proposal of the agent, shape (d,), m.
    """

    def __init__(self, formation: Formation, position: Array, velocity: Array, wanted: Array) -> None:
        self._formation = formation
        self._position, self._velocity = position, velocity
        self._mean = Average(value=wanted.tolist())
        self.value, self.size = self._mean.value, self._mean.size

    def cost(self, x: Array) -> float:
        """Return half the square of the distance to the proposal."""
        return self._mean.cost(x)

    def gradient(self, x: Array) -> Array:
        """Return the gradient, x minus the proposal."""
        return self._mean.gradient(x)

    def argmin(self, slope: Array, weight: float) -> Array:
        """Return the x where the gradient is 0."""
        return self._mean.argmin(slope, weight)

    def share(self) -> Share:
        """Return the problem as arrays."""
        return self._mean.share()

    def setpoint(self, decision: Array, stage: int) -> Setpoint:
        """Return the setpoint on the way to the agent's place, with `decision` as the centre."""
        formation = self._formation
        formation.place = read_only(decision + formation.offset)
        return formation.approach.setpoint(self._position, self._velocity, formation.place, stage)
