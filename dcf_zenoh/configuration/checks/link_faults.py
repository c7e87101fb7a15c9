"""Checks of the faults of a fleet file: kinds exist and accept their keys, rules apply to existing links."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcf_zenoh.configuration.building.fault_links import Recipe
from dcf_zenoh.configuration.checks.agent_faults import HOW_TO_GO_ON, check_window
from dcf_zenoh.configuration.checks.plugin_lookup import PluginLookup
from dcf_zenoh.configuration.checks.times import LONGEST
from dcf_zenoh.configuration.reading.fault_shorthand import RULE_KEYS
from dcf_zenoh.diagnostics import Diagnostics, listed, nearest, reason
from dcf_zenoh.errors import PluginError
from dcf_zenoh.faults.chain import ALWAYS
from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.graph import Graph
from dcf_zenoh.plugins import Plugin, Schema, is_built_in, known, load
from dcf_zenoh.spec import FaultRule, FaultTable, FleetSpec, Switch

Pairs = Sequence[tuple[int, int]]
MOST_LINKS = 12  # in a message


@dataclass(frozen=True)
class _Rule:
    """A rule with its place in the file and its links.

    Attributes:
        key: ``faults`` for the faults of all links, or ``faults.rule.N``.
        rule: The rule, as in the file.
        links: Links that it applies to.
    """

    key: str
    rule: FaultRule
    links: Pairs

    @property
    def window(self) -> tuple[float, float]:
        """Begin and end of the time in which the rule applies, s."""
        return self.rule.during or ALWAYS

    def overlaps(self, other: "_Rule") -> bool:
        """Return whether this rule applies to some of the links and times of another."""
        (begin, end), (other_begin, other_end) = self.window, other.window
        return begin < other_end and other_begin < end and not set(self.links).isdisjoint(other.links)

    def covered_by(self, others: Sequence["_Rule"]) -> bool:
        """Return whether other rules together apply to all links and times of this one."""
        windows: dict[tuple[int, int], list[tuple[float, float]]] = {link: [] for link in self.links}
        for other in others:
            for link in windows.keys() & set(other.links):
                windows[link].append(other.window)
        return all(_filled(self.window, each) for each in windows.values())


def check_link_faults(spec: FleetSpec, graph: Graph | None, lookup: PluginLookup) -> list[str]:
    """Check [faults].

    Args:
        spec: Specification of the fleet.
        graph: Communication graph; None if it is not known.
        lookup: Lookup of the kinds, which gets the errors and notes.

    Returns:
        Keys of the faults that can lose messages.
    """
    pairs = sorted(graph.links) if graph else [(i, j) for i in spec.ids for j in spec.ids if i != j]
    rules = []
    for number, rule in enumerate(spec.faults.rules):
        key = f"faults.rule.{number}" if number else "faults"
        rules.append(_Rule(key, rule, [link for link in pairs if rule.covers(*link)]))
    names = {name for each in rules for name, fault in each.rule.faults.items() if fault}
    losers = []
    for each in rules:
        if each.key != "faults":
            _check_rule(spec, each, pairs if graph else [], lookup.diagnostics)
        for name, fault in each.rule.faults.items():
            key = f"{each.key}.{name}"
            plugin = (
                _check_fault(spec, key, fault, each.links, lookup) if _is_known(key, fault, names, lookup) else None
            )
            if plugin is not None and getattr(plugin, "LOSES", True):
                losers.append(key)
                _note_cut(spec, key, plugin, each.rule, lookup.notes)
    _check_overruled(rules, lookup.diagnostics)
    return losers


def _is_known(key: str, fault: Switch, names: set[str], lookup: PluginLookup) -> bool:
    """Return whether a fault of this name exists; if not, add an error."""
    name = key.rpartition(".")[2]
    kinds = sorted(known("faults"))
    if name in kinds or (fault.kind != name if fault else name in names):
        return True
    others = RULE_KEYS if key.startswith("faults.rule.") else ("rule",)
    lookup.diagnostics.add(
        key,
        f"unknown fault {name!r}{nearest(name, [*kinds, *others])} known faults: {listed(kinds)};"
        " or a table with kind = 'package.module:Name' or './file.py:Name'",
    )
    return False


def _check_fault(spec: FleetSpec, key: str, fault: Switch, links: Pairs, lookup: PluginLookup) -> Plugin | None:
    """Check one table; return the plug-in if it could be loaded."""
    if not fault or (schema := lookup.schema("faults", fault.kind, key)) is None:
        return None
    lookup.compare(schema, fault.options, lambda option: f"{key}.{option}")
    lookup.add_all(schema.missing(fault.options), lambda option: f"{key}.{option}")
    if not (lookup.run or is_built_in("faults", fault.kind)):
        return None
    plugin = load("faults", fault.kind, lookup.folder)
    if not lookup.diagnostics.within(key):
        _check_named(spec, key, plugin, fault.options, lookup)
    if not lookup.diagnostics.within(key):
        _check_made(key, fault, schema, links, lookup)
    return plugin


def _check_named(spec: FleetSpec, key: str, plugin: Plugin, options: dict[str, Any], lookup: PluginLookup) -> None:
    """Check the files and agents that a fault names."""
    if getattr(plugin, "NEEDS_POSITIONS", False) and not spec.has_plants:
        lookup.diagnostics.add(key, "needs the positions of the agents, and without plants they have none")
    for option in getattr(plugin, "FILES", ()):
        file = options.get(option)
        if isinstance(file, str) and not (lookup.folder / file).is_file():
            lookup.diagnostics.add(f"{key}.{option}", f"there is no file {lookup.folder / Path(file)}")
    for option in getattr(plugin, "AGENTS", ()):
        for agent in _flat(options.get(option)):
            if agent not in spec.agents:
                lookup.diagnostics.add(f"{key}.{option}", _no_agent(spec, agent))


def _check_made(key: str, fault: FaultTable, schema: Schema, links: Pairs, lookup: PluginLookup) -> None:
    """Construct the fault of each link, and add what its constructor refuses."""
    recipe = Recipe.of(key, fault, lookup.folder)
    for link in links if recipe.depends_on_link else links[:1]:
        try:
            recipe.make(*link)
        except PluginError as error:
            cause = error.__cause__
            text = reason(cause) if cause else str(error).removeprefix(f"{key}: ")
            option, _, rest = text.partition(" ")
            blamed = rest.startswith(("must ", "is ")) and option in {each.name for each in schema.parameters}
            lookup.diagnostics.add(f"{key}.{option}" if blamed else key, rest if blamed else text)
            return


def _check_rule(spec: FleetSpec, each: _Rule, pairs: Pairs, diagnostics: Diagnostics) -> None:
    """Check the links and the time of a rule."""
    rule, key = each.rule, each.key
    if not rule.faults:
        diagnostics.add(key, f"a rule without a fault; known faults: {listed(sorted(known('faults')))}")
    senders, receivers = _ids(rule.from_), _ids(rule.to)
    for end, ids in (("from", senders), ("to", receivers)):
        if ids == ():
            diagnostics.add(f"{key}.{end}", "expected at least one agent; without this key it is for all")
        for agent in ids or ():
            if agent not in spec.agents:
                diagnostics.add(f"{key}.{end}", _no_agent(spec, agent))
    if senders and senders == receivers and len(set(senders)) == 1:
        diagnostics.add(f"{key}.to", f"expected another agent than {senders[0]}, as from; none has a link to itself")
    if not each.links and pairs and not diagnostics.within(key):
        near = [link for link in pairs if link[0] in (senders or ()) or link[1] in (receivers or ())]
        shown = listed(f"{i} -> {j}" for i, j in near[:MOST_LINKS]) + (", ..." if len(near) > MOST_LINKS else "")
        diagnostics.add(
            key,
            f"no link from {_or_any(senders)} to {_or_any(receivers)} in topology {spec.topology.kind!r};"
            f" links there are: {shown}",
        )
    if rule.during is not None:
        check_window(spec, f"{key}.during", rule.during, diagnostics)


def _filled(window: tuple[float, float], others: Sequence[tuple[float, float]]) -> bool:
    """Return whether `others` leave no gap in `window`."""
    reached, end = window
    for begin, until in sorted(others):
        if begin > reached:
            return False
        reached = max(reached, until)
    return bool(others) and reached >= end


def _check_overruled(rules: Sequence[_Rule], diagnostics: Diagnostics) -> None:
    """Add an error for each fault that can never act because of later rules."""
    for place, each in enumerate(rules):
        for name in each.rule.faults:
            later = [other for other in rules[place + 1 :] if name in other.rule.faults and other.overlaps(each)]
            if each.links and each.covered_by(later):
                winners = [other for other in later if each.covered_by([other])][:1] or later
                come = "comes later," if len(winners) == 1 else "come later, together"
                diagnostics.add(
                    f"{each.key}.{name}",
                    f"never acts, as {listed(f'{other.key}.{name}' for other in winners)} {come}"
                    " for at least the same links and times",
                )


def _note_cut(spec: FleetSpec, key: str, plugin: Plugin, rule: FaultRule, notes: list[str]) -> None:
    silent = spec.safety.neighbour_silent
    lasts = LONGEST if rule.during is None else rule.during[1] - rule.during[0]
    if silent.then == "land" and lasts > silent.after and getattr(plugin, "STAGE", None) is Stage.CUT:
        notes.append(f"{key}: the run ends when a link is cut for more than {silent.after:g} s{HOW_TO_GO_ON}")


def _no_agent(spec: FleetSpec, agent: object) -> str:
    return f"there is no agent {agent}; agents are {listed(spec.ids)}"


def _ids(ids: int | tuple[int, ...] | None) -> tuple[int, ...] | None:
    return (ids,) if isinstance(ids, int) else ids


def _or_any(ids: tuple[int, ...] | None) -> str:
    return "any agent" if ids is None else listed(ids)


def _flat(value: Any) -> Iterator[Any]:
    """Yield the items of a list and of the lists in it; a single value is yielded itself, None is not."""
    if isinstance(value, list | tuple):
        for each in value:
            yield from _flat(each)
    elif value is not None:
        yield value
