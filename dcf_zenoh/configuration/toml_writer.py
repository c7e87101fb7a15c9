"""A specification as a fleet file."""

import re
from typing import Any

import tomli_w

from dcf_zenoh.spec import FleetSpec


def to_toml(spec: FleetSpec) -> str:
    """The fleet file of `spec`, with all defaults written out; it loads to an equal specification."""
    return toml(table_of(spec))


def table_of(spec: FleetSpec) -> dict[str, Any]:
    """All keys of a fleet file but empty tables."""
    table = spec.model_dump(by_alias=True, exclude_none=True)
    table["agents"] = {str(agent): own for agent, own in table["agents"].items()}
    if rules := table["faults"].pop("rule"):
        table["faults"]["rule"] = rules  # after those of all links
    for owner in (table, table["zenoh"], *table["agents"].values()):
        for key in [key for key, value in owner.items() if value == {}]:
            del owner[key]
    return table


def toml(table: dict[str, Any]) -> str:
    """`table` in TOML, lists on one line. Strings hold no raw line breaks, so those in sight are structure."""
    text = tomli_w.dumps(table)
    return re.sub(r",\n +", ", ", re.sub(r"\[\n +", "[", re.sub(r",?\n *\]", "]", text)))
