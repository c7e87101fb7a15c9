"""Base classes and types of the tables of a fleet file."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

PositiveFloat = Annotated[float, Field(gt=0)]
NonNegativeFloat = Annotated[float, Field(ge=0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=64)]
AgentId = Annotated[int, Field(ge=0)]
Vector = tuple[float, ...]


def nanoseconds(seconds: float) -> int:
    """Convert s to the nearest whole number of ns."""
    return round(seconds * 1e9)


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `table` with `changes`; where both have a table under one key, those are merged in the same way."""
    result = dict(table)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


class Table(BaseModel):
    """One table of a fleet file: frozen, and with known keys only."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)


class Kind(Table):
    """A table that chooses a plug-in: `kind`, and the keyword-only arguments of its constructor."""

    model_config = ConfigDict(frozen=True, extra="allow")

    kind: str = Field(description="name of a built-in or installed kind, 'package.module:Name', or './file.py:Name'")

    @property
    def options(self) -> dict[str, Any]:
        """Keys and values for the plug-in: all but those that are fields of the table."""
        return dict(self.model_extra or {})

    def with_options(self, changes: Mapping[str, Any]) -> "Kind":
        """Return the same table with some options replaced, sub-tables key by key."""
        return self.model_copy(update=merged(self.options, changes))
