"""Checks that an algorithm can solve this problem on this graph, by `dcf_zenoh.algorithms.needs`."""

import typing
from collections.abc import Sequence
from pathlib import Path

from dcf_zenoh.algorithms.needs import Needs, needs_of
from dcf_zenoh.configuration.building.graph import weights_of
from dcf_zenoh.configuration.building.problem_and_plant import problem_of
from dcf_zenoh.diagnostics import Diagnostics, listed
from dcf_zenoh.graph import Graph, Neighbourhood
from dcf_zenoh.plugins import Plugin, is_built_in, known, load
from dcf_zenoh.problems.problem import Problem
from dcf_zenoh.spec import FleetSpec


def check_needs(
    spec: FleetSpec, folder: Path, graph: Graph | None, diagnostics: Diagnostics, *, run_plugins: bool
) -> None:
    """Check what the algorithm of the fleet needs. One that declares nothing, or must not be imported, passes.

    Args:
        spec: Specification of the fleet.
        folder: Folder that paths of plug-ins are relative to.
        graph: Communication graph; None if it is not known.
        diagnostics: Errors so far, to which new ones are added.
        run_plugins: Whether third-party plug-ins may be imported.
    """

    def loaded(group: str, kind: str, key: str) -> Plugin | None:
        usable = not diagnostics.within(key) and (run_plugins or is_built_in(group, kind))
        return load(group, kind, folder) if usable else None

    needed = needs_of(loaded("algorithms", spec.algorithm.kind, "algorithm"))
    if needed is None:
        return
    if graph is not None and not diagnostics.within("topology"):
        _check_links(needed, spec, graph, diagnostics)
    kind = loaded("problems", spec.problem.kind, "problem")
    if isinstance(kind, type) and not diagnostics.within("plant"):
        _check_problem(needed, spec, folder, kind, diagnostics)


def _check_links(needed: Needs, spec: FleetSpec, graph: Graph, diagnostics: Diagnostics) -> None:
    weights = weights_of(spec, graph)
    for agent in graph.agents:
        neighbourhood = Neighbourhood.of(graph, agent, weights)
        if wrong := needed.of_links(agent, neighbourhood, len(graph.agents)):
            diagnostics.add("topology", wrong)
        elif wrong := needed.of_weights(neighbourhood):
            diagnostics.add("topology.weights", wrong)


def _check_problem(needed: Needs, spec: FleetSpec, folder: Path, kind: type, diagnostics: Diagnostics) -> None:
    name, controller = spec.problem.kind, spec.controller_kind.kind
    posed: Sequence[object] = ()  # problems, or their class, as far as known
    if controller == "solve_once":
        if hasattr(kind, "at"):
            text = f"{name} is posed anew at every step, from where the agents are: they need plants"
            diagnostics.add("problem.kind", text)
        elif is_built_in("problems", name) and not diagnostics:
            posed = [problem_of(spec, folder, agent) for agent in spec.ids]
        else:
            posed = [kind]
    elif controller == "receding_horizon":
        if issubclass(kind, Problem) and not hasattr(kind, "at"):
            text = f"{name} does not depend on where the agents are: leave out their plants"
            diagnostics.add("problem.kind", text)
        else:
            posed = _posed_by(kind)
    wrong = next(filter(None, (needed.of_problem(each, name) for each in posed)), None)
    if wrong is not None:
        if issubclass(kind, Problem) or hasattr(kind, "at"):
            able = [each for each in sorted(known("algorithms")) if _solves(each, posed)]
            wrong += f"; those that can solve it: {listed(able)}"
        diagnostics.add("algorithm.kind", wrong)


def _posed_by(kind: type) -> list[type]:
    """Return the class of what a problem poses in each step, if its method `at` has that annotation."""
    try:
        posed = typing.get_type_hints(kind.at).get("return")  # type: ignore[attr-defined]
    except (AttributeError, NameError, TypeError):
        return []
    return [posed] if isinstance(posed, type) else []


def _solves(algorithm: str, posed: Sequence[object]) -> bool:
    """Return whether a built-in algorithm solves all of these problems, as far as known."""
    needed = needs_of(load("algorithms", algorithm, Path())) if is_built_in("algorithms", algorithm) else None
    return needed is not None and all(
        needed.of_problem(each, "") is None and all(getattr(each, trait, True) is True for trait in needed.traits)
        for each in posed
    )
