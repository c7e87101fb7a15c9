"""Construction of the problem and the plant of one agent."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from dcf_zenoh.diagnostics import show
from dcf_zenoh.errors import PluginError, account
from dcf_zenoh.plant import NoPlant, Plant, read_only
from dcf_zenoh.plugins import accepted, create, load
from dcf_zenoh.spec import FleetSpec


def problem_of(spec: FleetSpec, folder: Path, agent: int) -> Any:
    """Make the problem of `agent`.

    Raises:
        PluginError: The problem cannot be loaded, or refuses its options.
    """
    own = spec.agent(agent).problem
    plugin = load("problems", own.kind, folder)
    nominal = {"nominal": accepted(plugin).complete(spec.problem.options)}
    return create(plugin, _known(spec, agent) | nominal, own.options, f"agents.{agent}: problem")


def ask_about_starts(problem: object, method: str, *arguments: object) -> dict[int, str]:
    """Ask a problem for what is wrong with the starts of a fleet.

    Args:
        problem: Problem of one agent.
        method: Name of the method.
        arguments: Arguments of the method.

    Returns:
        Agent -> text.

    Raises:
        PluginError: The method raised an exception, or returned something else.
    """
    found = _ask(problem, method, *arguments)
    if not (isinstance(found, Mapping) and all(type(i) is int and isinstance(text, str) for i, text in found.items())):
        expected = "agent -> text, of the agents whose start is wrong"
        raise PluginError(f"{type(problem).__name__}.{method}() returned {show(found)}; expected {expected}")
    return dict(found)


def ask_for_note(problem: object, method: str, *arguments: object) -> str | None:
    """Ask a problem for a note about a fleet; None if it has none. See `ask_about_starts`.

    Raises:
        PluginError: The method raised an exception, or returned something else.
    """
    found = _ask(problem, method, *arguments)
    if not (found is None or isinstance(found, str)):
        raise PluginError(f"{type(problem).__name__}.{method}() returned {show(found)}; expected text, or None")
    return found


def _ask(problem: object, method: str, *arguments: object) -> object:
    """Return what a method of a problem returns."""
    try:
        return getattr(problem, method)(*arguments)
    except Exception as error:
        raise PluginError(f"{type(problem).__name__}.{method}() failed: {account(error)}") from error


def plant_of(spec: FleetSpec, folder: Path, agent: int) -> Plant:
    """Make the plant of `agent`, not prepared; a `NoPlant` if the agent only computes.

    Raises:
        PluginError: The plant cannot be loaded, or refuses its options.
    """
    own = spec.agent(agent).plant
    if own is None:
        return NoPlant()
    plugin = load("plants", own.kind, folder)
    return cast(Plant, create(plugin, _known(spec, agent), own.options, f"agents.{agent}: plant"))


def _known(spec: FleetSpec, agent: int) -> dict[str, Any]:
    """Return the values of the positional arguments of plug-ins, by name."""
    return {
        "agent": agent,
        "agents": spec.ids,
        "sample_time": spec.time.sample_time,
        "start": read_only(spec.agent(agent).start),
        "rng": np.random.Generator(np.random.Philox([spec.seed, agent, 1])),
    }


def plant_classes(spec: FleetSpec, folder: Path) -> set[type[Plant]]:
    """Return the classes of all plants that agents of a fleet have.

    Raises:
        PluginError: A kind is unknown, or cannot be loaded.
    """
    kinds = {own.plant.kind for own in map(spec.agent, spec.ids) if own.plant}
    found = {load("plants", kind, folder) for kind in kinds}
    return {kind for kind in found if isinstance(kind, type) and issubclass(kind, Plant)}
