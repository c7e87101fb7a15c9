"""Geometry of a problem: what of a run can be measured, drawn and explained in the plane or in space.

All of it is optional. A problem of any kind may have one of these methods, some, or all; its run is then measured by
them. A barrier value h is negative inside a region, 0 on its boundary and positive outside; it need not be a distance.
Positions are in m, in the world frame, in the dimensions that all agents of a run have.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from dcf_zenoh.plant import Array


@runtime_checkable
class SafetyRegion(Protocol):
    """A problem that keeps agents apart, pair by pair."""

    def separation(self, own: Array, other: Array) -> Array:
        """Return the barrier value h of pairs of positions, shape (...): negative where the two are too close.

        A run asks the agent of the pair that has the lower id.

        Args:
            own: Positions of this agent, shape (..., d), m.
            other: Positions of the other agent at the same instants, shape (..., d), m.
        """


@runtime_checkable
class RegionOutline(Protocol):
    """A problem whose safety region can be drawn."""

    def outline(self, position: Array) -> Array:
        """Return the corners of a polygon around this agent, shape (corners, 2), m: where others have h = 0.

        Args:
            position: Position of this agent, shape (d,), m.
        """


@runtime_checkable
class ObstacleClearance(Protocol):
    """A problem that keeps agents clear of obstacles."""

    def clearances(self, position: Array) -> Array:
        """Return the barrier value h of this agent with each obstacle, shape (..., obstacles): negative inside it.

        Args:
            position: Positions of this agent, shape (..., d), m.
        """


@runtime_checkable
class ObstacleOutlines(Protocol):
    """A problem whose obstacles can be drawn."""

    def obstacle_outlines(self) -> Sequence[Array]:
        """Return the corners of a polygon for each obstacle, each of shape (corners, 2), m.

        A run asks the agent with the lowest id.
        """


@runtime_checkable
class DeadlockLayout(Protocol):
    """A problem for which layouts are known that end in a deadlock: agents stand in each other's way for ever."""

    def deadlock(self, starts: Mapping[int, Array], targets: Mapping[int, Array]) -> str | None:
        """Return what is known to go wrong in a layout, for a note of ``agentd check``; None if nothing is known.

        The problem of one agent is asked for the fleet, and only if every agent has a start and a target.

        Args:
            starts: Agent -> start, shape (d,), m, of all agents.
            targets: Agent -> target, shape (d,), m, of all agents.
        """


PARTS: tuple[type, ...] = (SafetyRegion, RegionOutline, ObstacleClearance, ObstacleOutlines)  # what runs ask for
