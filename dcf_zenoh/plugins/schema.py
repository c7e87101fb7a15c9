"""The keys that a plug-in accepts: the keyword-only parameters of its signature, with type and default."""

import inspect
import json
import math
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
from pydantic import PlainValidator, PydanticSchemaGenerationError, TypeAdapter, ValidationError

from dcf_zenoh.diagnostics import expected, show, unknown_key
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plant import Array, read_only

REQUIRED: Any = inspect.Parameter.empty


@dataclass(frozen=True)
class Parameter:
    """One key.

    Attributes:
        name: The key.
        type: What its values are checked against.
        default: `REQUIRED` if there is none.
    """

    name: str
    type: Any
    default: Any

    def convert(self, value: Any) -> Any:
        """The value that the plug-in gets for `value` of a fleet file.

        TOML has no tuples and no arrays: lists become what the type says. Nothing else is converted, but whole
        numbers are numbers.

        Raises:
            ValueError: It is not of that type; the message says what was expected.
        """
        try:
            adapter: TypeAdapter[Any] = TypeAdapter(_checkable(self.type))
            _refuse_infinite(value)
        except PydanticSchemaGenerationError:  # a type of the plug-in's own: for its constructor to judge
            return value
        try:  # strict JSON is what TOML is: lists for tuples, and neither strings nor booleans for numbers
            return adapter.validate_json(json.dumps(value, default=str), strict=True)
        except ValidationError as error:
            own = [each["msg"].partition(", ")[2] for each in error.errors() if each["type"] == "value_error"]
            text = f"expected {expected(self.type)}, not {show(value)}"
            raise ValueError("; ".join([text, *own])) from None


@dataclass(frozen=True)
class Schema:
    """All keys of a plug-in.

    Attributes:
        plugin: Its name in messages.
        parameters: In the order of its signature.
        shared: Keys that must have the same value at every agent.
    """

    plugin: str
    parameters: tuple[Parameter, ...]
    shared: tuple[str, ...] = ()

    @property
    def first(self) -> str:
        """The key that a bare value in place of a table is for; ``value`` if there are no keys."""
        return self.parameters[0].name if self.parameters else "value"

    def convert(self, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
        """The values the plug-in gets, and key -> what is wrong with it."""
        known = {parameter.name: parameter for parameter in self.parameters}
        values, problems = {}, {}
        for key, value in options.items():
            if key not in known:
                problems[key] = unknown_key(self.plugin, key, known)
                continue
            try:
                values[key] = known[key].convert(value)
            except ValueError as error:
                problems[key] = str(error)
        return values, problems

    def complete(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """The values the plug-in gets for `options`, and the defaults of all others that have one."""
        defaults = {p.name: p.default for p in self.parameters if p.default is not REQUIRED}
        return defaults | self.convert(options)[0]

    def missing(self, given: Iterable[str]) -> dict[str, str]:
        """Key -> what is missing, of those that have no default and are not `given`."""
        lacking = {p.name: p for p in self.parameters if p.default is REQUIRED}
        for key in given:
            lacking.pop(key, None)
        return {key: f"missing; {self.plugin} needs {expected(p.type)}" for key, p in lacking.items()}


def accepted(plugin: Callable[..., Any]) -> Schema:
    """The keys of `plugin`, from its signature.

    A parameter without annotation takes values of the type of its default. The plug-in may name keys that must not
    differ from agent to agent in an attribute ``SHARED``.

    Raises:
        PluginError: An annotation cannot be resolved, or there is no signature.
    """
    return Schema(name_of(plugin), tuple(_parameters(plugin)), tuple(getattr(plugin, "SHARED", ())))


def name_of(plugin: Callable[..., Any]) -> str:
    """What the plug-in is called in messages."""
    return str(getattr(plugin, "__name__", plugin))


def signature_of(plugin: Callable[..., Any]) -> inspect.Signature:
    """The signature of a function, or of a class's constructor."""
    try:
        return inspect.signature(plugin)
    except (TypeError, ValueError) as error:
        raise PluginError(f"{name_of(plugin)} has no signature that can be read: {error}") from error


def _parameters(plugin: Callable[..., Any]) -> Iterable[Parameter]:
    function = inspect.unwrap(plugin.__init__ if isinstance(plugin, type) else plugin)  # type: ignore[misc]
    names = getattr(function, "__globals__", {})
    for parameter in signature_of(plugin).parameters.values():
        if parameter.kind is not parameter.KEYWORD_ONLY:
            continue
        if parameter.annotation is REQUIRED:
            kind = _type_of(parameter.default)
        else:
            try:
                # One by one: the annotations of other parameters need not exist at run time.
                one = SimpleNamespace(__annotations__={"it": parameter.annotation})
                kind = typing.get_type_hints(one, names, include_extras=True)["it"]
            except Exception as error:
                raise PluginError(
                    f"{name_of(plugin)}: type {parameter.annotation!r} of {parameter.name} cannot be resolved: {error}"
                ) from error
        yield Parameter(parameter.name, kind, parameter.default)


def _type_of(default: Any) -> Any:
    kind = type(default)
    return kind if kind in (bool, int, float, str, list, tuple, dict, np.ndarray) else Any


def _checkable(annotation: Any) -> Any:
    """The same type with arrays in a form that pydantic can check."""
    if (get_origin(annotation) or annotation) is np.ndarray:
        return _ARRAY
    if get_origin(annotation) in (Union, UnionType):
        return Union[tuple(map(_checkable, get_args(annotation)))]  # noqa: UP007
    return annotation


def _array(value: Any) -> Array:
    numbers = np.array(value, dtype=object).ravel()
    if not isinstance(value, list) or not all(type(each) in (int, float) for each in numbers):
        raise ValueError("its items must be numbers, its rows of equal length")
    return read_only(value)


_ARRAY = Annotated[Any, PlainValidator(_array)]


def _refuse_infinite(value: Any) -> None:
    """TOML can write nan and inf; no key means them."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"expected a finite number, not {value}")
    if isinstance(value, list):
        for each in value:
            _refuse_infinite(each)
