"""Layouts in which agents that change places are known to end in a deadlock."""

import numpy as np

from dcf_zenoh.plant import Array

_FEWEST = 4  # agents
_ALIKE = 0.05  # of the radius; how nearly a circle, and straight across it
_TURNED = (0.12, 0.55)  # rad from an axis; a square in between gets stuck, others do not (docs/algorithms.md)


def straight_across(starts: Array, targets: Array) -> bool:
    """Return whether all go straight across one circle, and are known not to arrive with diamond-shaped regions.

    Args:
        starts: Shape (N, 2), m.
        targets: Shape (N, 2), m.
    """
    if len(starts) < _FEWEST:
        return False
    arms = starts - starts.mean(axis=0)
    radius = float(np.linalg.norm(arms, axis=1).mean())
    across = targets - (starts.mean(axis=0) - arms)
    uneven = abs(np.linalg.norm(arms, axis=1) - radius)
    if max(uneven.max(), np.linalg.norm(across, axis=1).max()) > _ALIKE * radius:
        return False
    turned = np.arctan2(arms[0, 1], arms[0, 0]) % (np.pi / 2)
    return len(starts) > _FEWEST or _TURNED[0] <= min(turned, np.pi / 2 - turned) <= _TURNED[1]
