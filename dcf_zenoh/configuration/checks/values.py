"""Checks that only a plug-in can make of its values: it is constructed once, as at the beginning of a run."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from dcf_zenoh.configuration.building.problem_and_plant import ask_about_starts, plant_of, problem_of
from dcf_zenoh.configuration.checks.braking import check_braking
from dcf_zenoh.configuration.reading.layout import STARTS
from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plant import read_only
from dcf_zenoh.plugins import is_built_in, load
from dcf_zenoh.problems.geometry import DeadlockLayout
from dcf_zenoh.problems.problem import Problem
from dcf_zenoh.spec import FleetSpec

SIZES = {"size": "components of a decision", "rows": "shared constraints"}  # must be equal at all agents


def check_values(
    spec: FleetSpec, folder: Path, diagnostics: Diagnostics, notes: list[str], *, run_plugins: bool
) -> None:
    """Construct the plant and the problem of every agent, and add what they refuse to the diagnostics.

    Only built-in kinds are constructed, and third-party problems that have a method ``check_starts`` or that check
    layouts for deadlocks. ``check_starts`` gets agent -> start, of all agents, and returns agent -> what is wrong with
    its start in relation to the other starts; it is called on the problem of one agent. Tables that already have errors
    are not used.

    Args:
        spec: Specification of the fleet.
        folder: Folder that paths of plug-ins are relative to.
        diagnostics: Errors, to which new ones are added.
        notes: Remarks, to which new ones are added.
        run_plugins: Whether third-party code may run.
    """
    if diagnostics.within("time") or diagnostics.within("plant"):
        return
    sound = [i for i in spec.ids if not diagnostics.within(f"agents.{i}")]
    for name, kind in spec.plants.items():
        users = [i for i in sound if (spec.agents[i].plant or spec.plant) == name]
        if is_built_in("plants", kind.kind) and not diagnostics.within(f"plants.{name}"):
            refused = _refusals(users, lambda agent: plant_of(spec, folder, agent))
            special = [i for i in users if spec.agents[i].plants.get(name)]
            _note(refused, users, special, f"plants.{name}", diagnostics)
    if not diagnostics.within("problem") and _may_be_made(spec, folder, run_plugins=run_plugins):
        refused = _refusals(sound, lambda agent: problem_of(spec, folder, agent))
        _note(refused, sound, [i for i in sound if spec.agents[i].problem], "problem", diagnostics)
        starts = {i: spec.agents[i].start or () for i in spec.ids}
        if refused or len(sound) < len(spec.ids):
            return
        made = {i: problem_of(spec, folder, i) for i in spec.ids}
        _check_sizes(made, diagnostics)
        check_braking(spec, made, _real(spec, sound), diagnostics, notes)
        if all(starts.values()):
            _check_starts(made[spec.ids[0]], starts, diagnostics)


def _real(spec: FleetSpec, agents: Sequence[int]) -> list[int]:
    """Return the agents whose plant moves in the real world, as far as it is built in."""
    kinds = {i: own.kind for i in agents if (own := spec.agent(i).plant) is not None}
    return [
        i
        for i, kind in kinds.items()
        if is_built_in("plants", kind) and getattr(load("plants", kind, Path()), "real", False)
    ]


def _may_be_made(spec: FleetSpec, folder: Path, *, run_plugins: bool) -> bool:
    kind = spec.problem.kind
    if is_built_in("problems", kind) or not run_plugins:
        return is_built_in("problems", kind)
    plugin = load("problems", kind, folder)
    return hasattr(plugin, STARTS) or isinstance(plugin, DeadlockLayout)


def _refusals(agents: Sequence[int], make: Callable[[int], object]) -> dict[int, str]:
    """Return agent -> reason for which its plant or problem cannot be made."""
    refused = {}
    for agent in agents:
        try:
            make(agent)
        except PluginError as error:
            refused[agent] = "; ".join(error.problems).partition(": ")[2].partition(": ")[2]  # without agent and table
    return refused


def _note(
    refused: Mapping[int, str], users: Sequence[int], special: Sequence[int], table: str, diagnostics: Diagnostics
) -> None:
    """Add refusals: under `table` if all `users` have the same one and not all have their own keys (`special`)."""
    if len(refused) == len(users) > len(special) and len(set(refused.values())) == 1:
        diagnostics.add(table, next(iter(refused.values())))
        return
    for agent, text in refused.items():
        diagnostics.add(f"agents.{agent}.{table}", text)


def _check_sizes(made: Mapping[int, object], diagnostics: Diagnostics) -> None:
    """Check that all problems have the same sizes: numpy would broadcast arrays of different sizes."""
    for name, what in SIZES.items():
        sizes = {
            i: getattr(each, name) for i, each in made.items() if isinstance(each, Problem) and hasattr(each, name)
        }
        usual = Counter(sizes.values()).most_common(1)
        for agent, size in sizes.items():
            if size != usual[0][0]:
                like = next(i for i in sizes if sizes[i] == usual[0][0])
                diagnostics.add(
                    f"agents.{agent}.problem", f"{what}: expected {usual[0][0]}, as agent {like} has, not {size}"
                )


def _check_starts(problem: object, starts: Mapping[int, tuple[float, ...]], diagnostics: Diagnostics) -> None:
    if not hasattr(problem, STARTS):
        return
    try:
        found = ask_about_starts(problem, STARTS, {i: read_only(start) for i, start in starts.items()})
    except PluginError as error:
        diagnostics.add("problem", "; ".join(error.problems))
        return
    for agent, text in found.items():
        diagnostics.add(f"agents.{agent}.start", text)
