"""Agents on a circle, each wanting to be where another is."""

import numpy as np

from dcf_zenoh.layouts.places import Count, Places
from dcf_zenoh.spec import PositiveFloat


def circle(
    *,
    agents: Count,
    radius: PositiveFloat,
    turn: float = 0.0,
    ahead: int | None = None,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Places:
    """Agents at equal distances on a circle, counter-clockwise; each wants to be where one further on starts.

    Args:
        agents: How many.
        radius: Of the circle, in m.
        turn: Where the first agent is, as an angle from the x axis, in rad.
        ahead: How many places each target is further on; None: half of them, which is straight across if they are even.
        centre: Of the circle, in m.

    Raises:
        ValueError: The targets are the starts.
    """
    shift = agents // 2 if ahead is None else ahead
    if shift % agents == 0:
        raise ValueError(f"every agent would be at its target: {shift} of {agents} places further on")
    angles = turn + 2 * np.pi * np.arange(agents) / agents
    starts = np.array(centre) + radius * np.column_stack((np.cos(angles), np.sin(angles)))
    return Places(starts, np.roll(starts, -shift, axis=0))
