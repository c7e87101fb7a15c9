"""Reading of [faults]: an entry in short form, ``loss = 0.2``, becomes a table with kind and first key."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcf_zenoh.diagnostics import Diagnostics, expected, show
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import BARE, first_key, is_built_in, load, spelled_out
from dcf_zenoh.spec import FaultRule, Faults

RULE_KEYS = tuple(field.alias or name for name, field in FaultRule.model_fields.items())
_RULE = ("faults", "rule")

# While changes are applied, faults.rule is a table from numbers to rules: faults.rule.2 is the second rule.


def is_fault(path: Sequence[str]) -> bool:
    """Return whether `path` is the key of a fault: ``faults.loss``, ``faults.rule.2.loss``."""
    if tuple(path[:2]) == _RULE:
        return len(path) == 4 and path[3] not in RULE_KEYS
    return len(path) == 2 and path[0] == "faults"


def number_rules(table: dict[str, Any], diagnostics: Diagnostics) -> None:
    """Turn the list of rules into a table from ``"1"`` on, in the order of the file."""
    faults = table.get("faults")
    if not isinstance(faults, dict) or "rule" not in faults:
        return
    rules = faults["rule"]
    if isinstance(rules, list):
        faults["rule"] = {str(number): rule for number, rule in enumerate(rules, 1)}
    elif not isinstance(rules, dict) or not all(key.isdecimal() for key in rules):
        wanted = expected(Faults.model_fields["rule"].annotation)
        diagnostics.add("faults.rule", f"expected {wanted}, each under [[faults.rule]], not {show(rules)}")
        del faults["rule"]


def list_rules(table: dict[str, Any], diagnostics: Diagnostics) -> None:
    """Turn the numbered rules into a list again."""
    faults = table.get("faults")
    if not isinstance(faults, dict) or not isinstance(faults.get("rule"), dict):
        return
    rules = faults["rule"]
    for place, key in enumerate(sorted(rules, key=lambda key: (len(key), key)), 1):
        if key != str(place):
            diagnostics.add(f"faults.rule.{key}", f"cannot be set: the next rule is faults.rule.{place}")
            del rules[key]
            break
    faults["rule"] = [rules[key] for key in sorted(rules, key=int)]


def _entries(table: dict[str, Any]) -> Iterator[tuple[tuple[str, ...], dict[str, Any]]]:
    """Yield the path of each fault, and the table that it is in."""
    faults = table.get("faults")
    if not isinstance(faults, dict):
        return
    yield from ((("faults", name), faults) for name in list(faults) if name != "rule")
    rules = faults.get("rule")
    for number, rule in rules.items() if isinstance(rules, dict) else ():
        if isinstance(rule, dict):
            yield from (((*_RULE, number, name), rule) for name in list(rule) if name not in RULE_KEYS)


@dataclass(frozen=True)
class FaultShorthand:
    """Reads faults that are written short.

    Attributes:
        folder: What the paths of plug-ins are relative to.
        run: Import plug-ins that are not part of dcf-zenoh, to find their first keys. Without it only their text is
            read.
    """

    folder: Path
    run: bool

    def spell_out_all(self, table: dict[str, Any]) -> None:
        """Replace each fault of a fleet file by its table, with kind and first key; ``false`` stays.

        A fault without a kind has that of [faults.NAME], or NAME itself.
        """
        for path, owner in _entries(table):
            name, fault = path[-1], owner[path[-1]]
            if fault is not False:
                everywhere = table["faults"].get(name)
                usual = everywhere.get("kind", name) if isinstance(everywhere, dict) else name
                full = {"kind": usual, **(fault if isinstance(fault, dict) else {BARE: fault})}
                owner[name] = spelled_out("faults", full, self.folder, run=self.run)

    def check(self, table: dict[str, Any], diagnostics: Diagnostics) -> None:
        """Remove entries that are no faults, and add them to `diagnostics`. All faults are spelled out."""
        for path, owner in _entries(table):
            key, name, fault = ".".join(path), path[-1], owner[path[-1]]
            if len(path) == 2 and name in RULE_KEYS:
                diagnostics.add(key, "expected in a [[faults.rule]]; faults in [faults] itself are those of all links")
                del owner[name]
            elif fault and not isinstance(fault["kind"], str):
                diagnostics.add(f"{key}.kind", f"expected a string, not {show(fault['kind'])}")
                del owner[name]
            elif fault and BARE in fault:
                first = first_key("faults", fault["kind"], self.folder, run=self.run)
                if first != BARE:
                    diagnostics.add(f"{key}.{BARE}", f"given twice: also as {key}.{first}")
                    del fault[BARE]

    def files(self, table: dict[str, Any], changed: Sequence[str]) -> Iterator[tuple[dict[str, Any], str]]:
        """Yield the faults in, at or above the path that was changed, with their keys there that name files.

        All faults are spelled out.
        """
        for path, owner in _entries(table):
            both = min(len(path), len(changed))
            if path[:both] != tuple(changed[:both]) or owner[path[-1]] is False:
                continue
            fault = owner[path[-1]]
            for key in self._files(fault["kind"]):
                if isinstance(fault.get(key), str) and changed[len(path) :] in ((), (key,)):
                    yield fault, key

    def _files(self, kind: Any) -> tuple[str, ...]:
        """Return the keys of a kind that name files; none if they cannot be found."""
        if not isinstance(kind, str) or not (self.run or is_built_in("faults", kind)):
            return ()
        try:
            return tuple(getattr(load("faults", kind, self.folder), "FILES", ()))
        except PluginError:  # reported by the checks
            return ()
