"""Replacements of values of a fleet file: choices such as ``--plant``, and changes ``--set key.path=value``."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Overrides:
    """Choices that replace those of a fleet file; None keeps that of the file.

    Attributes:
        seed: Seed of the fleet.
        clock: ``wall`` or ``virtual``.
        plant: Name of a table in [plants], or a kind, for all agents.
        algorithm: Name of a table in [algorithms], or a kind, in place of [algorithm].
        topology: Kind of the topology.
    """

    seed: int | None = None
    clock: str | None = None
    plant: str | None = None
    algorithm: str | None = None
    topology: str | None = None


NO_OVERRIDES = Overrides()


def path_of(key: str) -> tuple[str, ...]:
    """Return the parts of a dotted key; no parts if the text is not a key."""
    try:
        nested: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError:  # keys of Zenoh have slashes
        parts = tuple(part.strip() for part in key.split("."))
        return parts if all(parts) else ()
    path = []
    while isinstance(nested, dict) and len(nested) == 1:
        ((part, nested),) = nested.items()
        path.append(part)
    return tuple(path)


def value_of(text: str) -> Any:
    """Return the value of a text in TOML, or the text itself if it is not TOML."""
    try:
        table = tomllib.loads(f"it = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return table["it"] if len(table) == 1 else text


def with_plain_id(path: Sequence[str]) -> tuple[str, ...]:
    """Return a path with a plain agent id: ``agents.01.start`` is ``agents.1.start``."""
    head, *rest = path
    if head == "agents" and rest and rest[0].isascii() and rest[0].isdecimal():
        rest[0] = str(int(rest[0]))
    return (head, *rest)
