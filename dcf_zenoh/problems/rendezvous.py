"""Agents meet where the sum of the squares of their ways is least."""

from collections.abc import Mapping

from dcf_zenoh.plant import Array, State
from dcf_zenoh.problems.formation import CentreConsensus, Formation


class Rendezvous:
    """In every control step all agree on the mean of their positions, and fly there: a formation without offsets.

    Attributes:
        local: An agent poses its part from its own state alone.

    Args:
        agent: Id of this agent.
        sample_time: t_s, s.
        dimensions: Of the place to meet; of a body in more dimensions, the first ones are flown.
        pace: How fast it is flown to, rad/s; see `Approach`.
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
        """The problem of one control step, given agent -> [position, velocity], of this agent at least."""
        return self._formation.at(states)

    def distance_to_go(self, state: State) -> float:
        """Distance to where the agent was sent last, m; infinite before that."""
        return self._formation.distance_to_go(state)
