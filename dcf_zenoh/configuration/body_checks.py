"""What a fleet file must satisfy because of its bodies: where they are, and what moves in the real world."""

from collections.abc import Iterable

from dcf_zenoh.configuration.wording import Problems
from dcf_zenoh.spec import FleetSpec


def check_arena(spec: FleetSpec, problems: Problems) -> None:
    """Check that the arena is a box, and that every agent begins in it."""
    arena = spec.arena
    if arena is None:
        return
    if not arena.min or len(arena.min) != len(arena.max):
        problems.add(
            "arena", f"expected as many coordinates in min as in max, not {len(arena.min)} and {len(arena.max)}"
        )
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
    problems: Problems,
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
