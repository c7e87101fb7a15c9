"""Layout: agents at random places in a box."""

from typing import Literal

import numpy as np

from dcf_zenoh.layouts.places import Clear, Count, Places
from dcf_zenoh.plant import Array
from dcf_zenoh.spec import NonNegativeFloat

ATTEMPTS = 50  # attempts to place all agents
TRIES = 200  # draws per agent in an attempt


def scattered(
    rng: np.random.Generator,
    clear: Clear,
    *,
    agents: Count,
    low: tuple[float, float],
    high: tuple[float, float],
    spacing: NonNegativeFloat = 0.0,
    targets: Literal["exchanged", "anywhere"] = "exchanged",
) -> Places:
    """Random places, rounded to mm; the target of every agent is the start of another, or another random place.

    Args:
        rng: Source of all random numbers.
        clear: Function that returns whether the first agents can be at given places.
        agents: Number of agents.
        low: Least coordinates of the box, in m.
        high: Greatest coordinates of the box, in m.
        spacing: Least distance of two starts, and of two targets, in m, in addition to what `clear` requires.
        targets: "exchanged": the starts in another order, in which no agent stays. "anywhere": drawn like the starts.

    Raises:
        ValueError: The box is empty, or no room was found in it for so many agents.
    """
    if not (low[0] < high[0] and low[1] < high[1]):
        raise ValueError(f"expected low < high on both axes, not {list(low)} and {list(high)} m")
    if targets == "exchanged" and agents == 1:
        raise ValueError("one agent has nobody to change places with; targets = 'anywhere' needs nobody")
    box = np.array((low, high))
    starts = _drawn(rng, clear, agents, box, spacing)
    if targets == "anywhere":
        return Places(starts, _drawn(rng, clear, agents, box, spacing))
    order = np.arange(agents)
    while (order == np.arange(agents)).any():
        order = rng.permutation(agents)
    return Places(starts, starts[order])


def _drawn(rng: np.random.Generator, clear: Clear, agents: int, box: Array, spacing: float) -> Array:
    for _ in range(ATTEMPTS):
        places: Array = np.empty((0, 2))
        for _ in range(TRIES * agents):
            more = np.vstack((places, np.round(rng.uniform(box[0], box[1]), 3)))
            if (np.hypot(*(places - more[-1]).T) >= spacing).all() and clear(more):
                places = more
            if len(places) == agents:
                return places
    width, height = box[1] - box[0]
    raise ValueError(
        f"no room found for {agents} agents in {width:g} m x {height:g} m: they need a larger box, less spacing or"
        " smaller safety regions"
    )
