"""What a fleet file must satisfy because of its bodies: where they are, and what moves in the real world."""

import inspect
from collections.abc import Iterable

from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.spec import FleetSpec


def check_arena(spec: FleetSpec, problems: Diagnostics) -> None:
    """Check that the arena is a box, and that every agent begins in it."""
    arena = spec.arena
    if arena is None:
        return
    if not 1 <= len(arena.min) == len(arena.max) <= 3:
        text = f"expected as many coordinates in min as in max, 1 to 3, not {len(arena.min)} and {len(arena.max)}"
        problems.add("arena", text)
        return
    for low, high in zip(arena.min, arena.max, strict=True):
        if low >= high:
            problems.add("arena", f"expected min < max on each axis, not {low:g} and {high:g} m")
            return
    for agent, own in spec.agents.items():
        for axis, value, low, high in zip("xyz", own.start or (), arena.min, arena.max, strict=False):
            if not low <= value <= high:
                problems.add(
                    f"agents.{agent}.start", f"outside the arena: {axis} = {value:g} m, allowed {low:g} .. {high:g} m"
                )


def check_body(
    plugin: object,
    spec: FleetSpec,
    problems: Diagnostics,
    name: str,
    users: Iterable[int],
    owners: dict[tuple[object, str, str], int],
) -> None:
    """Check what the kind of a body asks for.

    Args:
        plugin: The kind of ``[plants.NAME]``.
        spec: The fleet.
        problems: What is wrong.
        name: Of the plant.
        users: Agents that have it.
        owners: Kind, key and value -> who has what no other may have, over all plants of the fleet; is added to.
    """
    if getattr(plugin, "real", False) and spec.time.clock == "virtual":
        problems.add(
            f"plants.{name}", "moves in the real world, which knows no virtual time: launch it with --clock wall"
        )
    _check_height(plugin, spec, problems, name, users)
    for option in getattr(plugin, "own_keys", ()):
        owned = getattr(plugin, "owned", lambda _key, value: value)
        for agent in users:
            own = spec.agent(agent).plant
            if own is None or option not in own.options:
                continue
            value = own.options[option]
            taken = plugin, option, repr(owned(option, value))
            if taken in owners:
                key = f"agents.{agent}.plants.{name}.{option}"
                problems.add(key, f"{value!r} is taken by agent {owners[taken]}; each needs its own")
            owners.setdefault(taken, agent)


def _check_height(plugin: object, spec: FleetSpec, problems: Diagnostics, name: str, users: Iterable[int]) -> None:
    """Check that bodies which start in the plane and fly at a height of their own do so in the arena."""
    if spec.arena is None or len(spec.arena.min) < 3 or not callable(plugin):
        return
    default = inspect.signature(plugin).parameters.get("height")
    low, high = spec.arena.min[2], spec.arena.max[2]
    for agent in users if default is not None else ():
        own = spec.agent(agent)
        height = own.plant.options.get("height", default.default) if own.plant and default else None
        if len(own.start) == 2 and isinstance(height, int | float) and not low <= height <= high:
            problems.add(
                f"plants.{name}.height",
                f"agent {agent} would fly outside the arena: {height:g} m, allowed {low:g} .. {high:g} m",
            )
            return
