"""The keys that a plug-in accepts: the keyword-only parameters of its signature, with type and default.

A parameter whose type is a frozen dataclass is a sub-table: the fields of the dataclass are its keys.
"""

import dataclasses
import inspect
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import NoneType, SimpleNamespace
from typing import Annotated, Any, get_args, get_origin

import numpy as np

from dcf_zenoh.diagnostics import expected, is_union, listed, reason, show, unknown_key
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins.values import convert

REQUIRED: Any = inspect.Parameter.empty


@dataclass(frozen=True)
class Parameter:
    """One key of a plug-in or of a sub-table.

    Attributes:
        name: Name of the key.
        type: Type of its values.
        default: Default value; `REQUIRED` if there is none.
        table: Keys of the sub-table that is the value of this key; None: the value is no sub-table.
    """

    name: str
    type: Any
    default: Any
    table: "Schema | None" = None


@dataclass(frozen=True)
class Schema:
    """All keys of a plug-in, or of one of its sub-tables.

    A key of a sub-table is named by its path, such as ``weights.input``.

    Attributes:
        owner: Name of the plug-in or of the sub-table, for messages.
        parameters: The keys, in the order of the signature.
        shared: Keys that must have the same value at every agent.
        renamed: Key of an earlier version -> its present name or path, for messages.
        renamed_values: Key -> value of an earlier version -> its present name, for messages.
        make: Function that makes the value of a sub-table from the values of its keys; None for a plug-in.
    """

    owner: str
    parameters: tuple[Parameter, ...]
    shared: tuple[str, ...] = ()
    renamed: Mapping[str, str] = field(default_factory=dict)
    renamed_values: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    make: Callable[..., Any] | None = None

    @property
    def defaults(self) -> dict[str, Any]:
        """Key -> default, of the keys that have one."""
        return {each.name: each.default for each in self.parameters if each.default is not REQUIRED}

    def convert(self, options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the values that the plug-in gets, and key -> what is wrong with it.

        A sub-table becomes an object of its dataclass, with the default of each key that is not given. One without
        a required key is left out of the values; `missing` reports it.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        values: dict[str, Any] = {}
        errors: dict[str, str] = {}
        for key, value in options.items():
            if key not in known:
                errors[key] = self._unknown(key, known)
                continue
            try:
                if (table := known[key].table) is None:
                    values[key] = convert(value, known[key].type)
                elif not isinstance(value, Mapping):
                    moved = f"; that value is called {self.renamed[key]!r} now" if key in self.renamed else ""
                    raise ValueError(f"expected a table, not {show(value)}{moved}")
                else:
                    inner, found = table.convert(value)
                    errors |= {f"{key}.{name}": text for name, text in found.items()}
                    if table.make is not None and not found and not table.missing(value):
                        values[key] = table.make(**(table.defaults | inner))
            except ValueError as error:
                errors[key] = f"{error}{self._renamed(key, value)}"
        return values, errors

    def _renamed(self, key: str, value: object) -> str:
        earlier = self.renamed_values.get(key, {})
        return f"; it is called {earlier[value]!r} now" if isinstance(value, str) and value in earlier else ""

    def _unknown(self, key: str, known: Iterable[str]) -> str:
        if key in self.renamed:
            return f"{self.owner} has no key {key!r} any more: it is called {self.renamed[key]!r}"
        return unknown_key(self.owner, key, known)

    def complete(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that the plug-in gets for `options`, and the defaults of all other keys that have one."""
        return self.defaults | self.convert(options)[0]

    def missing(self, options: Mapping[str, Any]) -> dict[str, str]:
        """Return key -> text for each key that has no default and is not in `options`."""
        found: dict[str, str] = {}
        for each in self.parameters:
            given = options.get(each.name)
            if each.table is not None and isinstance(given, Mapping):
                found |= {f"{each.name}.{key}": text for key, text in each.table.missing(given).items()}
            elif each.default is REQUIRED and each.name not in options:
                keys = f" with the keys {listed(p.name for p in each.table.parameters)}" if each.table else ""
                found[each.name] = f"missing; {self.owner} needs {expected(each.type)}{keys}"
        return found


def accepted(plugin: Callable[..., Any]) -> Schema:
    """Return the keys of `plugin`, from its signature.

    A parameter without annotation takes values of the type of its default. The plug-in may name keys that must not
    differ from agent to agent in an attribute ``SHARED``, and the present names of earlier keys in a mapping
    ``RENAMED``, those of earlier values in a mapping ``RENAMED_VALUES`` by key.

    Raises:
        PluginError: An annotation cannot be resolved, or there is no signature.
    """
    shared = tuple(getattr(plugin, "SHARED", ()))
    renamed, renamed_values = getattr(plugin, "RENAMED", {}), getattr(plugin, "RENAMED_VALUES", {})
    return Schema(name_of(plugin), tuple(_parameters(plugin)), shared, renamed, renamed_values)


def name_of(plugin: Callable[..., Any]) -> str:
    """Return the name of `plugin` in messages."""
    return str(getattr(plugin, "__name__", plugin))


def signature_of(plugin: Callable[..., Any]) -> inspect.Signature:
    """Return the signature of a function, or of a class's constructor."""
    try:
        return inspect.signature(plugin)
    except (TypeError, ValueError) as error:
        raise PluginError(f"{name_of(plugin)} has no signature that can be read: {error}") from error


def _parameters(plugin: Callable[..., Any]) -> Iterable[Parameter]:
    function = inspect.unwrap(plugin.__init__ if isinstance(plugin, type) else plugin)  # type: ignore[misc]
    names = getattr(function, "__globals__", {})
    owner = name_of(plugin)
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
                    f"{owner}: type {parameter.annotation!r} of {parameter.name} cannot be resolved: {error}"
                ) from error
        yield _parameter(owner, parameter.name, kind, parameter.default)


def _parameter(owner: str, name: str, kind: Any, default: Any) -> Parameter:
    nested = _dataclass_of(kind)
    if nested is None:
        return Parameter(name, kind, default)
    if not _is_frozen(nested):
        raise PluginError(
            f"{owner}: the dataclass {nested.__name__} of {name} must be frozen: agents share its default"
        )
    parameters = tuple(_fields(nested, default if isinstance(default, nested) else None, f"{owner}.{name}"))
    return Parameter(name, kind, default, Schema(name, parameters, make=_maker(nested)))


def _fields(nested: Any, default: Any, owner: str) -> Iterable[Parameter]:
    """Yield the keys of a sub-table; their defaults are the values of `default`, if it is not None."""
    try:
        types = typing.get_type_hints(nested, include_extras=True)
    except Exception as error:
        raise PluginError(f"{owner}: the types of {nested.__name__} cannot be resolved: {error}") from error
    for each in dataclasses.fields(nested):
        if not each.init:
            continue
        if default is not None:
            value = getattr(default, each.name)
        elif each.default_factory is not dataclasses.MISSING:
            value = each.default_factory()
        else:
            value = REQUIRED if each.default is dataclasses.MISSING else each.default
        yield _parameter(owner, each.name, types[each.name], value)


def _is_frozen(kind: Any) -> bool:
    return bool(getattr(getattr(kind, "__dataclass_params__", None), "frozen", False))


def _maker(nested: Callable[..., Any]) -> Callable[..., Any]:
    def make(**values: Any) -> Any:
        try:
            return nested(**values)
        except Exception as error:
            raise ValueError(reason(error)) from error

    return make


def _dataclass_of(kind: Any) -> Any:
    """Return the dataclass that `kind` is, or is next to None; None if it is another type."""
    if get_origin(kind) is Annotated:
        return _dataclass_of(get_args(kind)[0])
    if is_union(kind):
        choices = [each for each in get_args(kind) if each is not NoneType]
        return _dataclass_of(choices[0]) if len(choices) == 1 else None
    return kind if isinstance(kind, type) and dataclasses.is_dataclass(kind) else None


def _type_of(default: Any) -> Any:
    kind = type(default)
    plain = kind in (bool, int, float, str, list, tuple, dict, np.ndarray)
    return kind if plain or _is_frozen(kind) else Any
