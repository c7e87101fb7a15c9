"""Geometry of a whole fleet, asked of the problems of its agents."""

import logging
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dcf_zenoh.configuration.building.problem_and_plant import problem_of
from dcf_zenoh.diagnostics import reason
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import is_built_in, load
from dcf_zenoh.problems.geometry import PARTS, ObstacleClearance, ObstacleOutlines, RegionOutline, SafetyRegion
from dcf_zenoh.spec import FleetSpec

log = logging.getLogger(__name__)


class FleetGeometry:
    """Safety regions and obstacles of a fleet, as far as its problems offer them (`dcf_zenoh.problems.geometry`).

    What a problem does not offer is None or empty. So is what cannot be found out, as the code of the problem must not
    be run, cannot be loaded or fails; then `unknown` gives the reason, and a warning is logged.

    Args:
        kind: Kind of the problem, for messages.
        problems: Agent -> its problem; empty if they cannot be asked.

    Attributes:
        unknown: Why something is not known; None if all is known.
    """

    def __init__(self, kind: str, problems: Mapping[int, object]) -> None:
        self._kind = kind
        self._problems = problems
        self.unknown: str | None = None

    @classmethod
    def of(cls, spec: FleetSpec, folder: Path, *, run_plugins: bool) -> "FleetGeometry":
        """Make the problems of a fleet, if their kind has a geometry.

        Args:
            spec: A checked fleet.
            folder: What the paths of plug-ins are relative to.
            run_plugins: Whether the code of plug-ins that are not part of dcf-zenoh may be run.
        """
        kind = spec.problem.kind
        if not (run_plugins or is_built_in("problems", kind)):
            return cls._unknown(kind, f"{kind} was not run")
        try:
            plugin = load("problems", kind, folder)
            offered = not isinstance(plugin, type) or any(isinstance(plugin, part) for part in PARTS)
            return cls(kind, {i: problem_of(spec, folder, i) for i in spec.ids} if offered else {})
        except PluginError as error:
            return cls._unknown(kind, "; ".join(error.problems))

    @classmethod
    def _unknown(cls, kind: str, why: str) -> "FleetGeometry":
        geometry = cls(kind, {})
        geometry._lose(why)
        return geometry

    @property
    def has_regions(self) -> bool:
        """Agents have safety regions."""
        return any(isinstance(each, SafetyRegion) for each in self._problems.values())

    def separation(self, pair: tuple[int, int], first: Array, second: Array) -> Array | None:
        """Return the barrier value h of a pair of agents, shape (...).

        Args:
            pair: Ids, the lower one first.
            first: Positions of the first agent, shape (..., d), m.
            second: Positions of the second agent, shape (..., d), m.
        """
        return self._ask(pair[0], SafetyRegion, "separation", first, second, shape=first.shape[:-1])

    def clearances(self, agent: int, position: Array) -> Array | None:
        """Return the barrier value h of an agent with each obstacle, shape (..., obstacles).

        Args:
            agent: Id of the agent.
            position: Its positions, shape (..., d), m.
        """
        return self._ask(agent, ObstacleClearance, "clearances", position, shape=(*position.shape[:-1], None))

    def outline(self, agent: int, position: Array) -> Array | None:
        """Return the corners of the safety region of an agent, shape (corners, 2), m.

        Args:
            agent: Id of the agent.
            position: Its position, shape (d,), m.
        """
        return self._ask(agent, RegionOutline, "outline", position, shape=(None, 2))

    @cached_property
    def obstacles(self) -> tuple[Array, ...]:
        """Corners of each obstacle, each of shape (corners, 2), m."""
        asked = self._problems.get(min(self._problems, default=0))
        if not isinstance(asked, ObstacleOutlines):
            return ()
        try:
            return tuple(_checked(each, (None, 2)) for each in asked.obstacle_outlines())
        except Exception as error:
            self._lose(f"{self._kind}: obstacle_outlines() failed: {reason(error)}")
            return ()

    def _ask(
        self, agent: int, part: type, method: str, *positions: Array, shape: tuple[int | None, ...]
    ) -> Array | None:
        """Call a method of an agent's problem, if it has that part of a geometry."""
        problem: Any = self._problems.get(agent)
        if not isinstance(problem, part):
            return None
        try:
            return _checked(getattr(problem, method)(*positions), shape)
        except Exception as error:
            self._lose(f"{self._kind}: {method}() failed: {reason(error)}")
            return None

    def _lose(self, why: str) -> None:
        """Note, once, that something is not known."""
        text = f"the geometry of the problem is not known: {why}"
        if self.unknown is None:
            self.unknown = text
            log.warning("%s", text)


def _checked(values: Any, shape: tuple[int | None, ...]) -> Array:
    """Return `values` as an array of the expected shape; None in it stands for any number."""
    array = np.asarray(values, dtype=np.float64)
    fits = len(array.shape) == len(shape) and all(
        expected in (None, length) for length, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        sizes = ", ".join("any" if each is None else str(each) for each in shape)
        raise ValueError(f"expected shape ({sizes}), not {array.shape}")
    return array
