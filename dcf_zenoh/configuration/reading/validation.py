"""Validation: from the tables of a fleet file to a specification, with errors in terms of the fleet file."""

import json
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import ValidationError

from dcf_zenoh.diagnostics import Diagnostics, expected, show, unknown_key
from dcf_zenoh.spec import FleetSpec, Table

RENAMED = {  # keys of earlier fleet files
    ("exchange", "silent_after"): "skip_after_rounds",
    ("zenoh", "silence_timeout"): "receive_timeout",
}


def validate(table: dict[str, Any], diagnostics: Diagnostics) -> FleetSpec | None:
    """Return the specification in `table`.

    Values that are refused are added to `diagnostics` and removed from `table`, so that the rest can still be checked.

    Returns:
        The specification; None if a required key is missing, so that nothing more can be checked.
    """
    for _ in range(3):
        try:  # strict JSON is what TOML is: lists for tuples, and neither strings nor booleans for numbers
            return FleetSpec.model_validate_json(json.dumps(table, default=str), strict=True)
        except ValidationError as error:
            for each in error.errors(include_url=False, include_context=False):
                place = _find(each["loc"])
                value = _take(table, place.path)
                inside = len(each["loc"]) > len(place.path)  # an error in a part of a value is reported for the value
                diagnostics.add(".".join(place.path), _text(place, "" if inside else each["type"], value))
            table.setdefault("name", "unnamed")
    return None


@dataclass(frozen=True)
class _Place:
    """A key of a fleet file: its path, the type and description of its value, and the keys that its table accepts."""

    path: tuple[str, ...]
    type: Any
    metadata: tuple[Any, ...]
    description: str
    accepted: tuple[str, ...]


def _find(location: tuple[int | str, ...]) -> _Place:
    """Follow the location of a pydantic error through tables and lists of tables, but not into other lists.

    Items of a list are numbered from 1 on.
    """
    path: tuple[str, ...] = ()
    place = _Place(path, FleetSpec, (), "", ())
    for here in location:
        kind = _bare(place.type)
        part = str(here + 1 if isinstance(here, int) and get_origin(kind) is tuple else here)
        path = (*path, part)
        if get_origin(kind) is tuple and _is_table(get_args(kind)[0]):
            place = _Place(path, get_args(kind)[0], (), "", ())
        elif _is_table(kind):
            fields = {field.alias or name: field for name, field in kind.model_fields.items()}
            field = fields.get(part)
            if field is None:
                return _Place(path, Any, (), "", tuple(fields))
            place = _Place(path, field.annotation, tuple(field.metadata), field.description or "", tuple(fields))
        elif get_origin(kind) is dict:
            place = _Place(path, get_args(kind)[1], (), "", ())
        else:
            break
    return place


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Table)


def _bare(annotation: Any) -> Any:
    """Return a type without its bounds, and without None."""
    if get_origin(annotation) is Annotated:
        return _bare(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return _bare(next(each for each in get_args(annotation) if each is not NoneType))
    return annotation


def _take(table: Any, path: tuple[str, ...]) -> Any:
    """Remove the value at `path` from `table` and return it; None if it is not there."""
    for key in path[:-1]:
        table = table[int(key) - 1] if isinstance(table, list) else table.get(key, {})
    if isinstance(table, list):  # the other items keep their numbers
        place = int(path[-1]) - 1
        value, table[place] = table[place], {}
        return value
    return table.pop(path[-1], None)


def _text(place: _Place, error: str, value: Any) -> str:
    if error == "extra_forbidden":
        owner = f"[{'.'.join(place.path[:-1])}]" if len(place.path) > 1 else "a fleet file"
        if place.path in RENAMED:
            return f"{owner} has no key {place.path[-1]!r} any more: it is called {RENAMED[place.path]!r}"
        return unknown_key(owner, place.path[-1], place.accepted)
    what = expected(place.type, place.metadata) + (f" ({place.description})" if place.description else "")
    return f"missing; expected {what}" if error == "missing" else f"expected {what}, not {show(value)}"
