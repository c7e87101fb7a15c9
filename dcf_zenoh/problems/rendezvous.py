"""Agents meet at the point with the least sum of squared distances to them."""

from collections.abc import Mapping

from dcf_zenoh.plant import Array, State
from dcf_zenoh.problems.formation import CentreConsensus, Formation


class Rendezvous:
    """Flight of all agents to the mean of their positions, agreed on in every step: a formation without offsets.

    Attributes:
        local: The problem of an agent follows from its own state alone.

    Args:
        agent: Id of this agent.
        sample_time: t_s, s.
        dimensions: Dimensions of the meeting point; of a body in more dimensions, the first ones are flown.
        pace: Bandwidth of the approach to it, rad/s; see `Approach`.
        accel_max: Bound on each component of the acceleration, m/s².

    Raises:
        ValueError: A number is out of its range.
    """

    local = True

    def __init__(
        self, agent: int, sample_time: float, *, dimensions: int = 2, pace: float = 1.5, accel_max: float = 2.0
    ) -> None:
        if dimensions < 1:
            raise ValueError(f"dimensions must be at least 1, not {dimensions}")
        offset = (0.0,) * dimensions
        self._formation = Formation(agent, sample_time, offset=offset, pace=pace, accel_max=accel_max)

    def at(self, states: Mapping[int, Array]) -> CentreConsensus:
        """Return the problem of one control step, given agent -> [position, velocity], of this agent at least."""
        return self._formation.at(states)

    def distance_to_go(self, state: State) -> float:
        """Return the distance to the last meeting point, m; infinite before the first step."""
        return self._formation.distance_to_go(state)
