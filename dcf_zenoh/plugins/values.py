"""Values of a fleet file, checked against the types of a signature and converted to them."""

import json
import math
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
from pydantic import PlainValidator, PydanticSchemaGenerationError, TypeAdapter, ValidationError

from dcf_zenoh.diagnostics import expected, is_union, show
from dcf_zenoh.plant import Array, read_only


def convert(value: Any, annotation: Any) -> Any:
    """Return what a plug-in gets for `value`.

    TOML has no tuples and no arrays: lists become what `annotation` requires. Whole numbers are accepted as numbers.
    Nothing else is converted. A type unknown to pydantic is left to the constructor of the plug-in.

    Raises:
        ValueError: The value is not of that type; the message states what was expected.
    """
    try:
        adapter: TypeAdapter[Any] = TypeAdapter(_checkable(annotation))
        _refuse_infinite(value)
    except PydanticSchemaGenerationError:
        return value
    try:  # strict JSON is what TOML is: lists for tuples, and neither strings nor booleans for numbers
        return adapter.validate_json(json.dumps(value, default=str), strict=True)
    except ValidationError as error:
        own = [each["msg"].partition(", ")[2] for each in error.errors() if each["type"] == "value_error"]
        text = f"expected {expected(annotation)}, not {show(value)}"
        raise ValueError("; ".join([text, *own])) from None


def _checkable(annotation: Any) -> Any:
    """Return the same type with arrays in a form that pydantic can check."""
    if (get_origin(annotation) or annotation) is np.ndarray:
        return _ARRAY
    if is_union(annotation):
        return Union[tuple(map(_checkable, get_args(annotation)))]  # noqa: UP007
    return annotation


def _array(value: Any) -> Array:
    numbers = np.array(value, dtype=object).ravel()
    if not isinstance(value, list) or not all(type(each) in (int, float) for each in numbers):
        raise ValueError("its items must be numbers, its rows of equal length")
    return read_only(value)


_ARRAY = Annotated[Any, PlainValidator(_array)]


def _refuse_infinite(value: Any) -> None:
    """Raise ValueError for nan and inf, which TOML can write and no key accepts."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"expected a finite number, not {value}")
    if isinstance(value, list):
        for each in value:
            _refuse_infinite(each)
