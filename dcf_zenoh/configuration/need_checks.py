"""Whether an algorithm can solve this problem on this graph, as far as `dcf_zenoh.algorithms.needs` can tell before."""

import typing
from pathlib import Path

from dcf_zenoh.algorithms.needs import Needs, needs_of
from dcf_zenoh.configuration.drawing import weights_of
from dcf_zenoh.configuration.wording import Problems, listed
from dcf_zenoh.graph import Graph, Neighbourhood
from dcf_zenoh.plugins import Plugin, is_built_in, known, load
from dcf_zenoh.problems.problem import Problem
from dcf_zenoh.spec import FleetSpec


def check_needs(spec: FleetSpec, folder: Path, graph: Graph | None, problems: Problems, *, run_plugins: bool) -> None:
    """Note what the fleet's algorithm needs and does not find. One that says nothing, or cannot be run, passes.

    Args:
        spec: The fleet.
        folder: What the paths of plug-ins are relative to.
        graph: Who hears whom; None if that is not known.
        problems: What is wrong so far; what is needed is added.
        run_plugins: Plug-ins of others may be imported.
    """

    def loaded(group: str, kind: str, key: str) -> Plugin | None:
        usable = not problems.within(key) and (run_plugins or is_built_in(group, kind))
        return load(group, kind, folder) if usable else None

    needed = needs_of(loaded("algorithms", spec.algorithm.kind, "algorithm"))
    if needed is None:
        return
    if graph is not None and not problems.within("topology"):
        _check_links(needed, spec, graph, problems)
    if not problems.within("plant"):
        _check_problem(needed, spec, loaded("problems", spec.problem.kind, "problem"), problems)


def _check_links(needed: Needs, spec: FleetSpec, graph: Graph, problems: Problems) -> None:
    weights = weights_of(spec, graph)
    for agent in graph.agents:
        hood = Neighbourhood.of(graph, agent, weights)
        if wrong := needed.of_links(agent, hood, len(graph.agents)):
            problems.add("topology", wrong)
        elif wrong := needed.of_weights(hood):
            problems.add("topology.weights", wrong)


def _check_problem(needed: Needs, spec: FleetSpec, kind: Plugin | None, problems: Problems) -> None:
    name = spec.problem.kind
    if not isinstance(kind, type):
        return
    if spec.controller_kind.kind == "solve_once":
        if hasattr(kind, "at"):
            problems.add(
                "problem.kind", f"{name} is posed anew at every step, from where the agents are: they need plants"
            )
            return
        posed: type | None = kind
    elif spec.controller_kind.kind == "receding_horizon":
        if issubclass(kind, Problem) and not hasattr(kind, "at"):
            problems.add("problem.kind", f"{name} does not depend on where the agents are: leave out their plants")
            return
        posed = _posed_by(kind)
    else:
        return
    if posed is not None and (wrong := needed.of_problem(posed, name)):
        if issubclass(posed, Problem):
            able = [each for each in sorted(known("algorithms")) if _solves(each, posed)]
            wrong += f"; those that can solve it: {listed(able)}"
        problems.add("algorithm.kind", wrong)


def _posed_by(kind: type) -> type | None:
    """The class of what a problem poses in each step, if the annotation of its `at` tells."""
    try:
        posed = typing.get_type_hints(kind.at).get("return")  # type: ignore[attr-defined]
    except (AttributeError, NameError, TypeError):
        return None
    return posed if isinstance(posed, type) else None


def _solves(algorithm: str, posed: type) -> bool:
    """Whether a built-in algorithm solves such problems, whatever their numbers."""
    needed = needs_of(load("algorithms", algorithm, Path())) if is_built_in("algorithms", algorithm) else None
    if needed is None or needed.of_problem(posed, ""):
        return False
    return all(getattr(posed, trait, True) is True for trait in needed.traits)
