"""Small fleet files, made of what a test is about."""

from collections.abc import Mapping
from typing import Any

from dcf_zenoh.configuration.toml_writer import toml

TRIO: Mapping[str, Any] = {
    "plant": "point",
    "problem": {"kind": "position_swap"},
    "algorithm": {"kind": "trades"},
    "plants": {"point": {"kind": "point_mass"}},
    "agents": {
        "1": {"start": [0.0, 1.0], "target": [0.0, -1.0]},
        "2": {"start": [0.0, -1.0], "target": [0.0, 1.0]},
        "3": {"start": [1.0, 0.0], "target": [-1.0, 0.0]},
    },
}


def small_fleet(name: str, /, **tables: Any) -> str:
    """Return a fleet file, as TOML, of three point masses that change places.

    Args:
        name: Name of the fleet.
        tables: Top-level keys and tables, instead of those of the trio or in addition to them; None leaves one out.
    """
    keys = {"name": name, **TRIO, **tables}
    return toml({key: value for key, value in keys.items() if value is not None})
