"""Writing of a specification as a fleet file."""

import re
from typing import Any

import tomli_w

from dcf_zenoh.spec import FleetSpec


def to_toml(spec: FleetSpec) -> str:
    """Return the fleet file of `spec`, with all its keys; it loads to an equal specification."""
    return toml(table_of(spec))


def table_of(spec: FleetSpec) -> dict[str, Any]:
    """Return all keys of a specification but empty tables."""
    table = spec.model_dump(by_alias=True, exclude_none=True)
    table["agents"] = {str(agent): own for agent, own in table["agents"].items()}
    if rules := table["faults"].pop("rule"):
        table["faults"]["rule"] = rules  # after the faults of all links
    for owner in (table, table["zenoh"], *table["agents"].values()):
        for key in [key for key, value in owner.items() if value == {}]:
            del owner[key]
    return table


def toml(table: dict[str, Any]) -> str:
    """Return `table` in TOML, lists on one line. Strings have their line breaks escaped, so all others are layout."""
    text = tomli_w.dumps(table)
    return re.sub(r",\n +", ", ", re.sub(r"\[\n +", "[", re.sub(r",?\n *\]", "]", text)))
