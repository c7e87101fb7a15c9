"""Checks of the plants of a fleet: positions in the arena, real hardware, keys that no two agents may share."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from dcf_zenoh.configuration.checks.endpoints import host_of
from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.plugins import Schema, accepted
from dcf_zenoh.spec import FleetSpec


def check_arena(spec: FleetSpec, diagnostics: Diagnostics) -> None:
    """Check that the arena is a box, and that every agent starts in it."""
    arena = spec.arena
    if arena is None:
        return
    if not 1 <= len(arena.min) == len(arena.max) <= 3:
        text = f"expected as many coordinates in min as in max, 1 to 3, not {len(arena.min)} and {len(arena.max)}"
        diagnostics.add("arena", text)
        return
    for low, high in zip(arena.min, arena.max, strict=True):
        if low >= high:
            diagnostics.add("arena", f"expected min < max on each axis, not {low:g} and {high:g} m")
            return
    for agent, own in spec.agents.items():
        for axis, value, low, high in zip("xyz", own.start or (), arena.min, arena.max, strict=False):
            if not low <= value <= high:
                diagnostics.add(
                    f"agents.{agent}.start", f"outside the arena: {axis} = {value:g} m, allowed {low:g} .. {high:g} m"
                )


def check_body(
    plugin: object,
    spec: FleetSpec,
    diagnostics: Diagnostics,
    name: str,
    users: Iterable[int],
    owners: dict[tuple[object, str, str], int],
) -> None:
    """Check what the kind of a plant requires.

    Args:
        plugin: Class of ``[plants.NAME]``.
        spec: Specification of the fleet.
        diagnostics: Errors, to which new ones are added.
        name: NAME of the plant.
        users: Agents that have the plant.
        owners: (kind, key, value) -> agent that has this value, which no other agent may have; over all plants of the
            fleet, and extended here.
    """
    if getattr(plugin, "real", False) and spec.time.clock == "virtual":
        diagnostics.add(
            f"plants.{name}", "moves in the real world, which knows no virtual time: launch it with --clock wall"
        )
    _check_height(plugin, spec, diagnostics, name, users)
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
                diagnostics.add(key, f"{value!r} is taken by agent {owners[taken]}; each needs its own")
            owners.setdefault(taken, agent)


class SharedDevice(NamedTuple):
    """Device that the bodies of two agents use.

    Attributes:
        key: Key of the fleet file that names it for the second agent.
        text: Description.
        apart: Whether the endpoints of the two agents are on different hosts, each of which has such a device.
    """

    key: str
    text: str
    apart: bool


def shared_devices(spec: FleetSpec, plugin_of: Callable[[str], object]) -> Iterator[SharedDevice]:
    """Yield the devices that several agents use, such as the radio of two drones.

    Args:
        spec: Specification of the fleet.
        plugin_of: Returns the class of a kind of plant; None if it is not known.
    """
    owners: dict[str, int] = {}
    for agent in spec.ids:
        plant = spec.agent(agent).plant
        plugin = plugin_of(plant.kind) if plant else None
        for key in getattr(plugin, "own_keys", ()) if hasattr(plugin, "device") else ():
            value = plant.options.get(key) if plant else None
            device = "" if value is None else plugin.device(key, value)  # type: ignore[attr-defined]
            owner = owners.setdefault(device, agent) if device else agent
            if owner != agent:
                name = spec.agents[agent].plant or spec.plant
                text = f"{device} is used by agent {owner}, too: on one computer each agent needs its own"
                hosts = {host_of(spec.agents[i].endpoint or "") for i in (owner, agent)}
                yield SharedDevice(f"agents.{agent}.plants.{name}.{key}", text, apart=len(hosts) > 1)


def _check_height(plugin: object, spec: FleetSpec, diagnostics: Diagnostics, name: str, users: Iterable[int]) -> None:
    """Check that plants that start in the plane and have a key `height`, perhaps in a sub-table, fly in the arena."""
    if spec.arena is None or len(spec.arena.min) < 3 or not callable(plugin):
        return
    low, high = spec.arena.min[2], spec.arena.max[2]
    key, default = _height_key(accepted(plugin))
    for agent in users if key else ():
        own = spec.agent(agent)
        height: Any = own.plant.options if own.plant else {}
        for part in key.split("."):
            height = height.get(part) if isinstance(height, Mapping) else None
        height = default if height is None else height
        if len(own.start) == 2 and isinstance(height, int | float) and not low <= height <= high:
            diagnostics.add(
                f"plants.{name}.{key}",
                f"agent {agent} would fly outside the arena: {height:g} m, allowed {low:g} .. {high:g} m",
            )
            return


def _height_key(schema: Schema) -> tuple[str, Any]:
    """Return the path of the key `height` of a plant, or of a sub-table, and its default; an empty path if none."""
    for each in schema.parameters:
        if each.name == "height":
            return "height", each.default
        for inner in each.table.parameters if each.table else ():
            if inner.name == "height":
                return f"{each.name}.height", inner.default
    return "", None
