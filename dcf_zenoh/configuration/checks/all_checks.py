"""All checks of a specification beyond its types: names exist, plug-ins accept their keys, the graph is connected."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from dcf_zenoh.configuration.building.graph import draw, weights_of
from dcf_zenoh.configuration.checks.agent_faults import check_agent_faults
from dcf_zenoh.configuration.checks.bodies import check_arena, check_body, shared_devices
from dcf_zenoh.configuration.checks.endpoints import check_endpoints
from dcf_zenoh.configuration.checks.layouts import check_layout
from dcf_zenoh.configuration.checks.link_faults import check_link_faults
from dcf_zenoh.configuration.checks.needs import check_needs
from dcf_zenoh.configuration.checks.plugin_lookup import PluginLookup
from dcf_zenoh.configuration.checks.round_times import check_round_times
from dcf_zenoh.configuration.checks.times import check_activations, check_time, check_timeout
from dcf_zenoh.configuration.checks.values import check_values
from dcf_zenoh.diagnostics import Diagnostics, listed, nearest
from dcf_zenoh.errors import PluginError, TopologyError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plugins import Schema, is_built_in
from dcf_zenoh.spec import FleetSpec, Kind, merged


def check(
    spec: FleetSpec, folder: Path, diagnostics: Diagnostics, notes: list[str], *, run_plugins: bool, unused: bool = True
) -> None:
    """Check a specification, and add the findings to `diagnostics` and `notes`.

    Args:
        spec: Specification whose types are right.
        folder: Folder that paths of plug-ins are relative to.
        diagnostics: Errors.
        notes: Remarks about what is permitted but may surprise.
        run_plugins: Import plug-ins that are not part of dcf-zenoh. Without it only the text of their files is read.
        unused: Also check algorithms and plants that no agent uses.
    """
    _check_plant_names(spec, diagnostics)
    _check_starts(spec, diagnostics)
    check_arena(spec, diagnostics)
    check_time(spec, diagnostics, notes)
    check_activations(spec, diagnostics, notes)
    check_endpoints(spec, diagnostics, notes)
    lookup = PluginLookup(folder, run_plugins, diagnostics, notes)
    _check_problem(spec, lookup)
    _check_plants(spec, lookup, unused=unused)
    if not diagnostics:
        shared = shared_devices(spec, lambda kind: lookup.plugin("plants", kind))
        notes += [f"{each.key}: {each.text}" for each in shared if not each.apart]
    lookup.check("algorithms", spec.algorithm, "algorithm")
    for name, kind in spec.algorithms.items():
        if unused and kind != spec.algorithm:
            lookup.check("algorithms", kind, f"algorithms.{name}", used=False)
    if not diagnostics.within("plant"):
        lookup.check("controllers", spec.controller_kind, "controller")
    lookup.check("topologies", spec.topology, "topology")
    graph = None
    if not diagnostics.within("topology") and (run_plugins or is_built_in("topologies", spec.topology.kind)):
        graph = _check_graph(spec, folder, diagnostics)
    check_values(spec, folder, diagnostics, notes, run_plugins=run_plugins)
    if not diagnostics:
        check_layout(spec, lookup)
    check_needs(spec, folder, graph, diagnostics, run_plugins=run_plugins)
    losers = [*check_link_faults(spec, graph, lookup), *check_agent_faults(spec, diagnostics, notes)]
    check_timeout(spec, diagnostics, losers)
    check_round_times(spec, folder, graph, diagnostics, notes, losers)


def _check_plant_names(spec: FleetSpec, diagnostics: Diagnostics) -> None:
    def check_name(key: str, name: str) -> None:
        if name not in spec.plants:
            near = nearest(name, spec.plants)
            diagnostics.add(key, f"there is no [plants.{name}]{near} there are: {listed(spec.plants)}")

    if spec.plant is not None:
        check_name("plant", spec.plant)
    for agent, own in spec.agents.items():
        if own.plant is not None:
            check_name(f"agents.{agent}.plant", own.plant)
        elif spec.plant is None and spec.plants:
            diagnostics.add(
                f"agents.{agent}.plant",
                f"missing; either all agents have a plant or none: choose one of {listed(spec.plants)} here, for all"
                " agents by plant = ..., or by --plant",
            )
        for name in own.plants:
            check_name(f"agents.{agent}.plants.{name}", name)


def _check_starts(spec: FleetSpec, diagnostics: Diagnostics) -> None:
    first: tuple[int, int] | None = None
    places: dict[tuple[float, ...], int] = {}
    for agent, own in spec.agents.items():
        plant = own.plant or spec.plant
        if own.start is None:
            if plant is not None:
                diagnostics.add(f"agents.{agent}.start", f"missing; plant {plant!r} starts at a position, in m")
            continue
        if not own.start:
            diagnostics.add(f"agents.{agent}.start", "expected at least one component, in m, not []")
            continue
        if plant is not None and own.start in places:
            diagnostics.add(f"agents.{agent}.start", f"the same place as agents.{places[own.start]}.start")
        places.setdefault(own.start, agent)
        first = first or (agent, len(own.start))
        if len(own.start) != first[1]:
            diagnostics.add(
                f"agents.{agent}.start",
                f"expected {first[1]} components as in agents.{first[0]}.start, not {len(own.start)}",
            )


def _check_problem(spec: FleetSpec, lookup: PluginLookup) -> None:
    overrides = {agent: dict(own.problem) for agent, own in spec.agents.items()}
    for agent, own in spec.agents.items():
        if own.target is not None:
            if "target" in own.problem:
                lookup.diagnostics.add(f"agents.{agent}.problem.target", f"given twice: also as agents.{agent}.target")
            overrides[agent]["target"] = own.target

    def key(agent: int, option: str) -> str:
        short = option == "target" and "target" not in spec.agents[agent].problem
        return f"agents.{agent}.{'target' if short else f'problem.{option}'}"

    schema = lookup.schema("problems", spec.problem.kind, "problem")
    _check_overridden(lookup, schema, spec.problem, "problem", overrides=overrides, users=spec.agents, key=key)


def _check_plants(spec: FleetSpec, lookup: PluginLookup, *, unused: bool) -> None:
    owners: dict[tuple[object, str, str], int] = {}
    for name, kind in spec.plants.items():
        users = [agent for agent, own in spec.agents.items() if (own.plant or spec.plant) == name]
        if not (users or unused):
            continue
        overrides = {agent: own.plants[name] for agent, own in spec.agents.items() if name in own.plants}

        def key(agent: int, option: str, name: str = name) -> str:
            return f"agents.{agent}.plants.{name}.{option}"

        schema = lookup.schema("plants", kind.kind, f"plants.{name}", used=bool(users))
        _check_overridden(lookup, schema, kind, f"plants.{name}", overrides=overrides, users=users, key=key)
        if users and schema and (plugin := lookup.plugin("plants", kind.kind)):
            check_body(plugin, spec, lookup.diagnostics, name, users, owners)


def _check_overridden(
    lookup: PluginLookup,
    schema: Schema | None,
    base: Kind,
    where: str,
    *,
    overrides: Mapping[int, Mapping[str, Any]],
    users: Iterable[int],
    key: Callable[[int, str], str],
) -> None:
    """Check a table and what agents override of it; each error is added under the key that causes it."""
    for agent, options in overrides.items():
        if "kind" in options:
            lookup.diagnostics.add(
                key(agent, "kind"), f"expected other keys of [{where}]; the kind is given there alone"
            )
    if schema is None:
        return
    usual = schema.convert(base.options)[1]
    lookup.add_all(usual, lambda option: f"{where}.{option}")
    for agent, options in overrides.items():
        for option, text in schema.convert(merged(base.options, options))[1].items():
            given = _get(options, option)
            if given is not None and not (isinstance(given, Mapping) and usual.get(option) == text):
                lookup.diagnostics.add(key(agent, option), text)
        for option in (each for each in schema.shared if _get(options, each) is not None):
            lookup.diagnostics.add(key(agent, option), f"must be the same at every agent; set it in [{where}]")
    missing = {agent: schema.missing(merged(base.options, overrides.get(agent, {}))) for agent in users}
    for agent, texts in missing.items():
        for option, text in texts.items():
            everywhere = all(option in each for each in missing.values())
            lookup.diagnostics.add(f"{where}.{option}" if everywhere else key(agent, option), text)


def _get(options: Mapping[str, Any], key: str) -> Any:
    """Return the value of a key, which may be the path of a key in a sub-table; None if it is not given."""
    head, _, rest = key.partition(".")
    inner = options.get(head)
    return options[key] if key in options else _get(inner, rest) if rest and isinstance(inner, Mapping) else None


def _check_graph(spec: FleetSpec, folder: Path, diagnostics: Diagnostics) -> Graph | None:
    try:
        graph = draw(spec, folder)
    except (PluginError, TopologyError) as error:
        diagnostics.add("topology", "; ".join(error.problems).removeprefix("topology: "))
        return None
    if spec.exchange.max_rounds <= graph.diameter:
        diagnostics.add(
            "exchange.max_rounds",
            f"expected more than {graph.diameter} (the diameter of the graph: sharing states and agreeing take so many"
            f" rounds), not {spec.exchange.max_rounds}",
        )
    try:
        weights_of(spec, graph)
    except TopologyError as error:
        diagnostics.add("topology.weights", str(error))
    return graph
