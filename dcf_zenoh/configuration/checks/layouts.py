"""Check for layouts that end in a deadlock according to the problem."""

from dcf_zenoh.configuration.building.problem_and_plant import ask_for_note, problem_of
from dcf_zenoh.configuration.checks.plugin_lookup import PluginLookup
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plant import read_only
from dcf_zenoh.plugins import accepted
from dcf_zenoh.problems.geometry import DeadlockLayout
from dcf_zenoh.spec import FleetSpec

DETOUR = "detour"  # key of controllers that lead agents out of a deadlock


def check_layout(spec: FleetSpec, lookup: PluginLookup) -> None:
    """Add a note about a layout that ends in a deadlock according to the problem, unless the controller makes detours.

    Args:
        spec: Specification without errors.
        lookup: Lookup of its plug-ins, which gets the note, or an error if the problem cannot be asked.
    """
    controller = spec.controller_kind
    if controller.options.get(DETOUR) or not isinstance(lookup.plugin("problems", spec.problem.kind), DeadlockLayout):
        return
    starts = {i: read_only(own.start) for i, own in spec.agents.items() if own.start}
    given = {i: spec.agent(i).problem.options.get("target") for i in spec.ids}
    targets = {i: read_only(target) for i, target in given.items() if target}
    if not len(starts) == len(targets) == len(spec.ids):
        return
    problem = problem_of(spec, lookup.folder, spec.ids[0])
    try:
        text = ask_for_note(problem, "deadlock", starts, targets)
    except PluginError as error:
        lookup.diagnostics.add("problem", "; ".join(error.problems))
        return
    if text:
        kind = lookup.plugin("controllers", controller.kind)
        detours = kind is not None and any(each.name == DETOUR for each in accepted(kind).parameters)
        remedy = f"; controller.{DETOUR} = true leads out of it" if detours and hasattr(problem, "toward") else ""
        lookup.notes.append(f"agents: {text}{remedy}")
