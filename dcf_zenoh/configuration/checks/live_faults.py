"""Checks of faults that are changed while a fleet runs: those of a rule of a fleet file, and some more."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from dcf_zenoh.configuration.building.fault_links import needs_positions
from dcf_zenoh.configuration.checks.all_checks import check
from dcf_zenoh.configuration.checks.times import check_timeout
from dcf_zenoh.configuration.loaded_fleet import LoadedFleet
from dcf_zenoh.configuration.reading.draft import Draft, read
from dcf_zenoh.configuration.reading.fault_shorthand import RULE_KEYS
from dcf_zenoh.configuration.reading.validation import validate
from dcf_zenoh.diagnostics import Diagnostics, listed, nearest
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.plugins import known, load
from dcf_zenoh.spec import FaultRule, FleetSpec, Switch

Ids = tuple[int, ...] | None


class CheckedRule(NamedTuple):
    """A change as a rule of the fleet file, and notes for the user."""

    rule: FaultRule
    notes: tuple[str, ...]


def check_change(fleet: LoadedFleet, senders: Ids, receivers: Ids, name: str, fault: Any) -> CheckedRule:
    """Check a change of a running fleet, as one more rule of its fleet file.

    Args:
        fleet: The fleet, as in its run directory.
        senders: Ids of the senders; None: all.
        receivers: Ids of the receivers; None: all.
        name: Name of the fault.
        fault: Value or table of the fault; False switches it off.

    Raises:
        ConfigurationError: The change is not valid; the message has the texts of fleet files, but the keys of the
            command line.
    """
    if name in RULE_KEYS:
        kinds = sorted(known("faults"))
        raise ConfigurationError(f"unknown fault {name!r}{nearest(name, kinds)} known faults: {listed(kinds)}")
    kind = fault.get("kind") if isinstance(fault, Mapping) else None
    if isinstance(kind, str) and ":" in kind and (found := _foreign(fleet.spec, name, kind)):
        raise ConfigurationError(found)  # its file is not even read
    number = len(fleet.spec.faults.rule) + 1
    draft = read(fleet.source)
    path = ("faults", "rule", str(number))
    for key, value in (("from", senders), ("to", receivers), (name, fault)):
        if value is not None:
            draft.assign((*path, key), list(value) if isinstance(value, tuple) else value)
    spec = _check(draft)
    prefix = ".".join(path)
    lines = [_plain(line, prefix) for line in draft.diagnostics.lines if _is_of(line, prefix)]
    if spec is None or lines:
        raise ConfigurationError(lines or draft.diagnostics.lines)
    rule = spec.faults.rule[-1]
    if found := refusals(fleet.spec, fleet.folder, name, rule.faults[name]):
        raise ConfigurationError(found)
    return CheckedRule(rule, tuple(_plain(line, prefix) for line in draft.notes if line.startswith(prefix)))


def check_ends(fleet: LoadedFleet, senders: Ids, receivers: Ids) -> FaultRule:
    """Check that there are agents of these ids, and links between them; return a rule for these links.

    Raises:
        ConfigurationError: An agent does not exist, or there are no such links.
    """
    return check_change(fleet, senders, receivers, next(iter(known("faults"))), False).rule


def check_rules(fleet: LoadedFleet, rules: Iterable[dict[str, Any]]) -> list[str]:
    """Return what is wrong with the fleet file if `rules` are added at its end, one line each."""
    draft = read(fleet.source)
    for number, rule in enumerate(rules, len(fleet.spec.faults.rule) + 1):
        draft.assign(("faults", "rule", str(number)), rule)
    _check(draft)
    return draft.diagnostics.lines


def _foreign(spec: FleetSpec, name: str, kind: str) -> list[str]:
    """Return why a running fleet must not load a kind, in one line; no line if it may."""
    own = {each.kind for rule in spec.faults.rules for each in rule.faults.values() if each}
    if kind in own | known("faults").keys():
        return []
    return [
        f"{name}.kind: expected a kind that is installed or that the fleet file names, not {kind!r}:"
        " a fleet loads no other code while it runs"
    ]


def refusals(spec: FleetSpec, folder: Path, name: str, fault: Switch) -> list[str]:
    """Return why a fault cannot be added to a running fleet although a fleet file could have it, one line each.

    Only code is loaded that is installed or belongs to the run.

    Args:
        spec: Specification of the fleet.
        folder: Folder that paths of plug-ins are relative to.
        name: Name of the fault.
        fault: Table of the fault.

    Raises:
        PluginError: The fault cannot be loaded.
    """
    diagnostics = Diagnostics()
    if not fault:
        return []
    if found := _foreign(spec, name, fault.kind):
        return found
    plugin = load("faults", fault.kind, folder)
    if getattr(plugin, "LOSES", True):
        check_timeout(spec, diagnostics, [name])
    if getattr(plugin, "NEEDS_POSITIONS", False) and not needs_positions(spec, folder):
        diagnostics.add(
            name, "needs the positions of the agents, which messages carry only if the fleet file has it too"
        )
    return diagnostics.lines


def _check(draft: Draft) -> FleetSpec | None:
    draft.complete()
    spec = validate(draft.table, draft.diagnostics)
    if spec is not None:
        check(spec, draft.folder, draft.diagnostics, draft.notes, run_plugins=True)
    return spec


def _is_of(line: str, prefix: str) -> bool:
    """Return whether a line is about the rule, and not about what it overrules."""
    return line.startswith((f"{prefix}.", f"{prefix}:", "exchange.round_timeout:"))


def _plain(line: str, prefix: str) -> str:
    """Return a line without the place in the file."""
    text = line.removeprefix(f"{prefix}: ").replace(f"{prefix}.", "")
    return (
        f"--{text}" if text.startswith(("from", "to")) and text.partition(":")[0].split(".")[0] in RULE_KEYS else text
    )
