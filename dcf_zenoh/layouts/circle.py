"""Layout: agents on a circle that exchange their places."""

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
    """Agents at equal distances on a circle, counter-clockwise; the target of each is the start of another.

    Args:
        agents: Number of agents.
        radius: Radius of the circle, in m.
        turn: Angle of the first agent from the x axis, in rad.
        ahead: Number of places from a start to its target; None: half of all, which is straight across for an even
            number of agents.
        centre: Centre of the circle, in m.

    Raises:
        ValueError: The targets are the starts.
    """
    shift = agents // 2 if ahead is None else ahead
    if shift % agents == 0:
        raise ValueError(f"every agent would be at its target: {shift} of {agents} places further on")
    angles = turn + 2 * np.pi * np.arange(agents) / agents
    starts = np.array(centre) + radius * np.column_stack((np.cos(angles), np.sin(angles)))
    return Places(starts, np.roll(starts, -shift, axis=0))
