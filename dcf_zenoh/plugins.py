"""Names to objects: how the kinds of a fleet file become algorithms, controllers, problems, plants and topologies.

A kind is the name of a built-in or installed entry point (group ``dcf_zenoh.<group>``), ``package.module:Name``, or
``./file.py:Name`` relative to the fleet file. A plug-in in a file stands alone: it can import whatever is installed,
but not the files beside it.
"""

import functools
import importlib
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugin_file import import_file, peek, split
from dcf_zenoh.schema import accepted, name_of, signature_of
from dcf_zenoh.wording import listed, nearest, reason

__all__ = [
    "CONTEXT",
    "accepted",
    "bind",
    "check_known",
    "check_options",
    "check_positional",
    "check_signature",
    "create",
    "is_built_in",
    "known",
    "load",
    "peek",
    "split",
]

Plugin = Callable[..., Any]

# What the framework fills the positional parameters of a plug-in with, by name.
CONTEXT: Mapping[str, tuple[str, ...]] = {
    "algorithms": (),
    "controllers": ("problem", "algorithm", "me", "sample_time"),
    "problems": ("agent", "agents", "sample_time"),
    "plants": ("agent", "start", "sample_time", "rng"),
    "topologies": ("agents",),
}


@functools.cache
def known(group: str) -> Mapping[str, EntryPoint]:
    """The installed kinds of a group, by name; a built-in one wins over another of the same name."""
    points = entry_points(group=f"dcf_zenoh.{group}")
    return {point.name: point for point in sorted(points, key=lambda point: (_is_ours(point), point.name))}


def _is_ours(point: EntryPoint) -> bool:
    return point.dist is not None and point.dist.name.lower().replace("_", "-") == "dcf-zenoh"


def is_built_in(group: str, kind: str) -> bool:
    """Whether `kind` comes with dcf-zenoh: loading it runs no code of others."""
    return kind in (points := known(group)) and _is_ours(points[kind])


def load(group: str, kind: str, folder: Path) -> Plugin:
    """The class or function that `kind` names.

    Args:
        group: Such as ``algorithms``.
        kind: Entry point, ``package.module:Name`` or ``./file.py:Name``.
        folder: What the paths of files are relative to.

    Raises:
        PluginError: There is no such kind, or it cannot be imported; the message says why.
    """
    if in_file := split(kind):
        path, name = folder / in_file[0], in_file[1]
        plugin = _attribute(import_file(path, kind), name, kind)
    elif ":" in kind:
        module, _, name = kind.partition(":")
        plugin = _attribute(_import(module, kind), name, kind)
    else:
        check_known(group, kind)
        point = known(group)[kind]
        plugin = _attribute(_import(point.module, kind), point.attr, kind)
    if not callable(plugin):
        raise PluginError(f"{kind} is {type(plugin).__name__}, not a class or function")
    return cast(Plugin, plugin)


def check_known(group: str, kind: str) -> None:
    """Refuse a kind without ``:`` that is not installed, without importing anything.

    Raises:
        PluginError: With the kinds that there are and the nearest spelling.
    """
    names = sorted(known(group))
    if ":" not in kind and kind not in names:
        raise PluginError(
            f"unknown kind {kind!r}{nearest(kind, names)} known {group}: {listed(names)};"
            " or 'package.module:Name', './file.py:Name'"
        )


def create(plugin: Plugin, context: Mapping[str, Any], options: Mapping[str, Any], where: str) -> Any:
    """Call `plugin`: positional parameters by name from `context`, keyword-only ones from `options`.

    Raises:
        PluginError: Options do not fit, a positional parameter is not in the context, or the call fails.
    """
    values, problems = check_options(plugin, options, where)
    problems += [f"{where}: {problem}" for problem in check_positional(plugin, context)]
    if problems:
        raise PluginError(problems)
    try:
        return plugin(*(context[name] for name in _positional(plugin)), **values)
    except Exception as error:
        raise PluginError(f"{where}: {name_of(plugin)} refused its options: {reason(error)}") from error


def bind(plugin: Plugin, options: Mapping[str, Any], where: str) -> Plugin:
    """An algorithm with its options bound, to be called with problem and me.

    Raises:
        PluginError: Options do not fit.
    """
    values, problems = check_options(plugin, options, where)
    if problems:
        raise PluginError(problems)
    return functools.partial(plugin, **values)


def check_options(plugin: Plugin, options: Mapping[str, Any], where: str) -> tuple[dict[str, Any], list[str]]:
    """The values that `plugin` gets for `options`, and one line for each key that does not fit or is missing."""
    schema = accepted(plugin)
    values, problems = schema.convert(options)
    problems |= schema.missing(options)
    return values, [f"{where}.{key}: {text}" for key, text in problems.items()]


def check_positional(plugin: Plugin, context: Iterable[str]) -> list[str]:
    """One line for each positional parameter that the framework does not know."""
    names = list(context)
    return [
        f"{name_of(plugin)} has a positional parameter {name!r}{nearest(name, names)} allowed: {listed(names)};"
        " keys of the fleet file go after '*'"
        for name in _positional(plugin)
        if name not in names
    ]


def check_signature(group: str, plugin: Plugin) -> list[str]:
    """One line for each thing about the positional parameters that does not fit `group`."""
    if group != "algorithms":
        return check_positional(plugin, CONTEXT[group])
    names = _positional(plugin)
    if len(names) == 2:
        return []
    return [f"{name_of(plugin)}: an algorithm's signature is (problem, me, *, options), not ({listed(names)}, ...)"]


def _positional(plugin: Plugin) -> list[str]:
    parameters = signature_of(plugin).parameters.values()
    return [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]


def _attribute(module: ModuleType, name: str, kind: str) -> object:
    if not hasattr(module, name):
        own = module.__name__
        names = [each for each, value in vars(module).items() if getattr(value, "__module__", None) == own]
        origin = getattr(module, "__file__", None) or own
        raise PluginError(f"{kind}: {origin} has no {name!r}{nearest(name, names)} it defines: {listed(names)}")
    return getattr(module, name)


def _import(module: str, kind: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except Exception as error:
        raise PluginError(f"{kind}: importing {module} failed: {reason(error)}") from error
