"""Layouts that are known to end in a deadlock: everybody stands still in somebody's way."""

import numpy as np

from dcf_zenoh.plant import Array
from dcf_zenoh.spec import FleetSpec

_ALIKE = 0.05  # of the radius; how nearly a circle, and straight across it
_TURNED = (0.12, 0.55)  # rad from an axis; a square in between gets stuck, others do not (docs/algorithms.md)


def check_layout(spec: FleetSpec, notes: list[str]) -> None:
    """Note a position swap without detours that is known to get stuck: everybody straight across a circle."""
    controller = spec.controller_kind
    if (
        spec.problem.kind != "position_swap"
        or controller.kind != "receding_horizon"
        or controller.options.get("detour")
    ):
        return
    ways = [(own.start, spec.agent(i).problem.options.get("target")) for i, own in spec.agents.items()]
    known = [(start[:2], target[:2]) for start, target in ways if start and target and min(len(start), len(target)) > 1]
    if len(known) == len(ways) >= 4 and _gets_stuck(*np.array(known, dtype=float).swapaxes(0, 1)):
        notes.append(
            "agents: all go straight across one circle, which is known to end in a deadlock; controller.detour = true"
            " leads out of it"
        )


def _gets_stuck(starts: Array, targets: Array) -> bool:
    """Whether agents at `starts` are known not to reach `targets`, both of shape (N, 2), m."""
    arms = starts - starts.mean(axis=0)
    radius = float(np.linalg.norm(arms, axis=1).mean())
    across = targets - (starts.mean(axis=0) - arms)
    uneven = abs(np.linalg.norm(arms, axis=1) - radius)
    if max(uneven.max(), np.linalg.norm(across, axis=1).max()) > _ALIKE * radius:
        return False
    turned = np.arctan2(arms[0, 1], arms[0, 0]) % (np.pi / 2)
    return len(starts) > 4 or _TURNED[0] <= min(turned, np.pi / 2 - turned) <= _TURNED[1]
