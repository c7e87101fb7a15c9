"""Reading of ``[layout]``: it becomes agents with starts and targets in a draft."""

from typing import Any

import numpy as np

from dcf_zenoh.configuration.building.problem_and_plant import ask_about_starts
from dcf_zenoh.configuration.reading.draft import Draft
from dcf_zenoh.diagnostics import listed, nearest, show
from dcf_zenoh.errors import PluginError
from dcf_zenoh.layouts import LAYOUTS
from dcf_zenoh.layouts.places import Clear
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.plugins import Plugin, accepted, create, is_built_in, load

STARTS = "check_starts"  # method of a problem: all agents and starts -> agent -> what is wrong with its start


def lay_out(draft: Draft) -> bool:
    """Replace the layout of a draft, if it has one, by agents with ids from 1 on.

    Keys in the table of an agent take precedence over the layout. Random places follow from the seed, and must be
    accepted by the method ``check_starts`` of the problem; this holds for targets, too.

    Returns:
        False if the layout has errors.
    """
    table: Any = draft.table.pop("layout", None)
    if table is None:
        return True
    options = dict(table) if isinstance(table, dict) else {}
    kind, seed = options.pop("kind", None), draft.table.get("seed", 0)
    if kind not in LAYOUTS:
        near = nearest(str(kind), LAYOUTS)
        draft.diagnostics.add("layout.kind", f"expected a layout, not {show(kind)}{near} there are: {listed(LAYOUTS)}")
        return False
    layout = LAYOUTS[kind]
    schema = accepted(layout)
    for key, text in {**schema.convert(options)[1], **schema.missing(options)}.items():
        draft.diagnostics.add(f"layout.{key}", text)
    if draft.diagnostics.within("layout"):
        return False
    problem = _problem(draft)
    rng = np.random.Generator(np.random.Philox([seed if isinstance(seed, int) and seed >= 0 else 0, 0, 3]))
    try:
        places = create(layout, {"rng": rng, "clear": _clear(draft, problem, options["agents"])}, options, "layout")
    except PluginError as error:
        draft.diagnostics.add("layout", "; ".join(error.problems).partition(": ")[2].partition(": ")[2])
        return False
    aimed = problem is None or "target" in {each.name for each in accepted(problem).parameters}
    agents: Any = draft.table.setdefault("agents", {})
    for number, (start, target) in enumerate(zip(*map(_plain, places), strict=True), 1):
        own: Any = agents.setdefault(str(number), {}) if isinstance(agents, dict) else None
        if isinstance(own, dict):
            own.setdefault("start", start)
            if aimed and "target" not in own.get("problem", {}):
                own.setdefault("target", target)
    return True


def _plain(places: Array) -> list[list[float]]:
    """Return places as lists, rounded to µm, without negative zeros."""
    rounded: list[list[float]] = (places.round(6) + 0.0).tolist()
    return rounded


def _problem(draft: Draft) -> Plugin | None:
    """Return the class of the problem; None if it must not be imported, or cannot be."""
    table: Any = draft.table.get("problem")
    kind = table.get("kind") if isinstance(table, dict) else None
    if not isinstance(kind, str):
        return None
    try:
        usable = draft.run_plugins or is_built_in("problems", kind)
        return load("problems", kind, draft.folder) if usable else None
    except PluginError:
        return None


def _clear(draft: Draft, problem: Plugin | None, count: int) -> Clear:
    """Return the test of whether the problem accepts starts; a problem that cannot be made accepts all."""
    ids = tuple(range(1, count + 1))
    if problem is None or not hasattr(problem, STARTS):
        return lambda _places: True
    known = {"agent": 1, "agents": ids, "sample_time": 0.2, "nominal": None}
    options = {key: value for key, value in draft.table["problem"].items() if key != "kind"}
    try:
        if "target" in accepted(problem).missing(options):
            options["target"] = [0.0, 0.0]
        made = create(problem, known, options, "problem")
    except PluginError:
        return lambda _places: True
    return lambda places: not ask_about_starts(made, STARTS, dict(zip(ids, map(read_only, places), strict=False)))
