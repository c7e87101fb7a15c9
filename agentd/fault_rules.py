"""Fault rules as TOML text, in the shortest form that a fleet file accepts."""

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from dcf_zenoh.spec import FaultTable


def rules_to_toml(rules: Iterable[Mapping[str, Any]]) -> str:
    """Return rules as ``[[faults.rule]]`` tables for the end of a fleet file."""
    return "\n".join(
        "[[faults.rule]]\n" + "".join(f"{_key(key)} = {inline_toml(value)}\n" for key, value in rule.items())
        for rule in rules
    )


def inline_toml(value: Any) -> str:
    """Return a value as TOML on one line."""
    if isinstance(value, Mapping):
        pairs = ", ".join(f"{_key(key)} = {inline_toml(each)}" for key, each in value.items())
        return f"{{ {pairs} }}" if value else "{}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(inline_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def short_table(name: str, fault: FaultTable) -> dict[str, Any]:
    """Return the table of the fault `name` without optional values, and without its kind where that is its name."""
    table: dict[str, Any] = fault.model_dump(exclude_none=True)
    return {key: value for key, value in table.items() if (key, value) != ("kind", name)}


def short_ids(ids: tuple[int, ...]) -> int | list[int]:
    """Return the value of a rule's `from` or `to`: one id alone, several as a list."""
    return ids[0] if len(ids) == 1 else list(ids)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else inline_toml(name)
