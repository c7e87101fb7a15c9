"""What a specification must satisfy beyond its types: names that exist, plug-ins that accept their keys, a graph."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcf_zenoh.configuration.drawing import draw, weights_of
from dcf_zenoh.configuration.wording import Problems, listed, nearest
from dcf_zenoh.errors import PluginError, TopologyError
from dcf_zenoh.plugins import Schema, accepted, check_known, check_signature, is_built_in, load, peek, split
from dcf_zenoh.spec import FleetSpec, Kind

LONGEST = 1e8  # s; some three years


def check(spec: FleetSpec, folder: Path, problems: Problems, notes: list[str], *, run_plugins: bool) -> None:
    """Add to `problems` and `notes` whatever is to be said about `spec`.

    Args:
        spec: A fleet whose types are right.
        folder: What the paths of plug-ins are relative to.
        problems: What is wrong.
        notes: What is allowed, but should be known.
        run_plugins: Import the plug-ins of others; without it they are looked at only.
    """
    _check_plant_names(spec, problems)
    _check_starts(spec, problems)
    _check_time(spec, problems, notes)
    _check_endpoints(spec, problems)
    shelf = _Shelf(folder, run_plugins, problems, notes)
    _check_problem(spec, shelf)
    _check_plants(spec, shelf)
    shelf.check("algorithms", spec.algorithm, "algorithm")
    for name, kind in spec.algorithms.items():
        if kind != spec.algorithm:
            shelf.check("algorithms", kind, f"algorithms.{name}", used=False)
    if not problems.within("plant"):
        shelf.check("controllers", spec.controller_kind, "controller")
    shelf.check("topologies", spec.topology, "topology")
    if not problems.within("topology") and (run_plugins or is_built_in("topologies", spec.topology.kind)):
        _check_graph(spec, folder, problems)


def _check_plant_names(spec: FleetSpec, problems: Problems) -> None:
    def check_name(key: str, name: str) -> None:
        if name not in spec.plants:
            near = nearest(name, spec.plants)
            problems.add(key, f"there is no [plants.{name}]{near} there are: {listed(spec.plants)}")

    if spec.plant is not None:
        check_name("plant", spec.plant)
    for agent, own in spec.agents.items():
        if own.plant is not None:
            check_name(f"agents.{agent}.plant", own.plant)
        elif spec.plant is None and spec.plants:
            problems.add(
                f"agents.{agent}.plant",
                f"missing; either all agents have a plant or none: choose one of {listed(spec.plants)} here, for all"
                " agents by plant = ..., or by --plant",
            )
        for name in own.plants:
            check_name(f"agents.{agent}.plants.{name}", name)


def _check_starts(spec: FleetSpec, problems: Problems) -> None:
    first: tuple[int, int] | None = None
    places: dict[tuple[float, ...], int] = {}
    for agent, own in spec.agents.items():
        plant = own.plant or spec.plant
        if own.start is None:
            if plant is not None:
                problems.add(f"agents.{agent}.start", f"missing; plant {plant!r} starts at a position, in m")
            continue
        if not own.start:
            problems.add(f"agents.{agent}.start", "expected at least one component, in m, not []")
            continue
        if plant is not None and own.start in places:
            problems.add(f"agents.{agent}.start", f"the same place as agents.{places[own.start]}.start")
        places.setdefault(own.start, agent)
        first = first or (agent, len(own.start))
        if len(own.start) != first[1]:
            problems.add(
                f"agents.{agent}.start",
                f"expected {first[1]} components as in agents.{first[0]}.start, not {len(own.start)}",
            )


def _check_time(spec: FleetSpec, problems: Problems, notes: list[str]) -> None:
    rounds, sample_time = spec.exchange, spec.time.sample_time
    for key, value in {
        "time.sample_time": sample_time,
        "time.duration": spec.time.duration,
        "exchange.budget": rounds.budget,
        "exchange.round_timeout": rounds.round_timeout,
        "exchange.compute_time": rounds.compute_time,
        "safety.neighbour_silent.after": spec.safety.neighbour_silent.after,
        "zenoh.ready_timeout": spec.zenoh.ready_timeout,
        "zenoh.silence_timeout": spec.zenoh.silence_timeout,
    }.items():
        if value is not None and value > LONGEST:
            problems.add(key, f"expected at most {LONGEST:g} s, not {value:g}")
    if spec.seed >= 2**63:
        problems.add("seed", f"expected less than 2^63, not {spec.seed}")
    budget = rounds.step_budget(sample_time)
    if budget > sample_time:
        problems.add("exchange.budget", f"expected at most time.sample_time = {sample_time:g} s, not {budget:g} s")
    if rounds.round_timeout is not None and rounds.max_rounds * rounds.round_timeout > budget * (1 + 1e-9):
        worst = rounds.max_rounds * rounds.round_timeout
        notes.append(
            f"exchange: worst case {rounds.max_rounds} x {rounds.round_timeout * 1e3:g} ms = {worst:.3f} s"
            f" > budget {budget:.3f} s: a step may end by time, not by agreement"
        )


def _check_endpoints(spec: FleetSpec, problems: Problems) -> None:
    owners: dict[str, int] = {}
    for agent, own in spec.agents.items():
        if own.endpoint in owners:
            problems.add(
                f"agents.{agent}.endpoint",
                f"{own.endpoint} is taken by agent {owners[own.endpoint]}; each needs its own",
            )
        if own.endpoint is not None:
            owners[own.endpoint] = agent


@dataclass(frozen=True)
class _Shelf:
    """Where plug-ins are looked up, and what is found wrong with them is noted."""

    folder: Path
    run: bool
    problems: Problems
    notes: list[str]

    def check(self, group: str, kind: Kind, key: str, *, used: bool = True) -> None:
        """Check a table that nothing overrides."""
        if schema := self.schema(group, kind.kind, key, used=used):
            self.compare(schema, kind.options, lambda option: f"{key}.{option}")
            self.add_all(schema.missing(kind.options), lambda option: f"{key}.{option}")

    def schema(self, group: str, kind: str, key: str, *, used: bool = True) -> Schema | None:
        """The keys that `kind` accepts; None if they cannot be told. What nobody uses is not imported."""
        try:
            if (self.run and used) or is_built_in(group, kind):
                plugin = load(group, kind, self.folder)
                for text in check_signature(group, plugin):
                    self.problems.add(f"{key}.kind", text)
                return accepted(plugin)
            if not self.run:
                self.notes.append(f"{key}: {kind} was not run, so its keys are checked by name at most")
            if split(kind):
                return peek(kind, self.folder)
            check_known(group, kind)
        except PluginError as error:
            self.problems.add(f"{key}.kind", "; ".join(error.problems))
        return None

    def compare(self, schema: Schema, options: Mapping[str, Any], key: Callable[[str], str]) -> None:
        """Note the options that `schema` does not accept, under ``key(option)``."""
        self.add_all(schema.convert(options)[1], key)

    def add_all(self, texts: Mapping[str, str], key: Callable[[str], str]) -> None:
        """Note all `texts`, by option, under ``key(option)``."""
        for option, text in texts.items():
            self.problems.add(key(option), text)


def _check_problem(spec: FleetSpec, shelf: _Shelf) -> None:
    overrides = {agent: dict(own.problem) for agent, own in spec.agents.items()}
    for agent, own in spec.agents.items():
        if own.target is not None:
            if "target" in own.problem:
                shelf.problems.add(f"agents.{agent}.problem.target", f"given twice: also as agents.{agent}.target")
            overrides[agent]["target"] = own.target

    def key(agent: int, option: str) -> str:
        short = option == "target" and "target" not in spec.agents[agent].problem
        return f"agents.{agent}.{'target' if short else f'problem.{option}'}"

    schema = shelf.schema("problems", spec.problem.kind, "problem")
    _check_overridden(shelf, schema, spec.problem, "problem", overrides=overrides, users=spec.agents, key=key)


def _check_plants(spec: FleetSpec, shelf: _Shelf) -> None:
    for name, kind in spec.plants.items():
        users = [agent for agent, own in spec.agents.items() if (own.plant or spec.plant) == name]
        overrides = {agent: own.plants[name] for agent, own in spec.agents.items() if name in own.plants}

        def key(agent: int, option: str, name: str = name) -> str:
            return f"agents.{agent}.plants.{name}.{option}"

        schema = shelf.schema("plants", kind.kind, f"plants.{name}", used=bool(users))
        _check_overridden(shelf, schema, kind, f"plants.{name}", overrides=overrides, users=users, key=key)


def _check_overridden(
    shelf: _Shelf,
    schema: Schema | None,
    base: Kind,
    where: str,
    *,
    overrides: Mapping[int, Mapping[str, Any]],
    users: Iterable[int],
    key: Callable[[int, str], str],
) -> None:
    """Check a table and what agents override of it; each problem under the key it comes from."""
    for agent, options in overrides.items():
        if "kind" in options:
            shelf.problems.add(key(agent, "kind"), f"expected other keys of [{where}]; the kind is given there alone")
    if schema is None:
        return
    shelf.compare(schema, base.options, lambda option: f"{where}.{option}")
    for agent, options in overrides.items():
        shelf.compare(schema, options, lambda option, agent=agent: key(agent, option))  # type: ignore[misc]
        for option in (each for each in options if each in schema.shared):
            shelf.problems.add(key(agent, option), f"must be the same at every agent; set it in [{where}]")
    missing = {agent: schema.missing((*base.options, *overrides.get(agent, {}))) for agent in users}
    for agent, texts in missing.items():
        for option, text in texts.items():
            everywhere = all(option in each for each in missing.values())
            shelf.problems.add(f"{where}.{option}" if everywhere else key(agent, option), text)


def _check_graph(spec: FleetSpec, folder: Path, problems: Problems) -> None:
    try:
        graph = draw(spec, folder)
    except (PluginError, TopologyError) as error:
        problems.add("topology", "; ".join(error.problems).removeprefix("topology: "))
        return
    if spec.exchange.max_rounds <= graph.diameter:
        problems.add(
            "exchange.max_rounds",
            f"expected more than {graph.diameter} (the diameter of the graph: sharing states and agreeing take so many"
            f" rounds), not {spec.exchange.max_rounds}",
        )
    try:
        weights_of(spec, graph)
    except TopologyError as error:
        problems.add("topology.weights", str(error))
