"""Loading of plug-ins: from the kinds of a fleet file to classes and functions."""

import functools
import importlib
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint, EntryPoints, PackageNotFoundError, distribution, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from dcf_zenoh.diagnostics import listed, nearest, reason
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins.modules_beside import add_to_path, import_beside, import_ours
from dcf_zenoh.plugins.plugin_file import import_file, split

Plugin = Callable[..., Any]


@functools.cache
def known(group: str) -> Mapping[str, EntryPoint]:
    """Return the installed kinds of a group, by name; a built-in one wins over another of the same name."""
    points = installed().select(group=f"dcf_zenoh.{group}")
    return {point.name: point for point in sorted(points, key=lambda point: (_is_ours(point), point.name))}


@functools.cache
def installed() -> EntryPoints:
    """Return the entry points of all installed distributions; reading them is slow, so they are cached."""
    return cast(EntryPoints, entry_points())


@functools.cache
def _our_points() -> frozenset[EntryPoint]:
    try:
        return frozenset(distribution("dcf-zenoh").entry_points)
    except PackageNotFoundError:
        return frozenset()


def _is_ours(point: EntryPoint) -> bool:
    return point in _our_points()


def is_built_in(group: str, kind: str) -> bool:
    """Return whether `kind` is part of dcf-zenoh, so that loading it runs no third-party code."""
    return kind in (points := known(group)) and _is_ours(points[kind])


def load(group: str, kind: str, folder: Path) -> Plugin:
    """Return the class or function that `kind` names.

    Args:
        group: Group of the plug-in, such as ``algorithms``.
        kind: Entry point, ``package.module:Name`` or ``./file.py:Name``.
        folder: Folder of the fleet file. Paths of files are relative to it, and modules in it come before others.

    Raises:
        PluginError: There is no such kind, or it cannot be imported; the message gives the reason.
    """
    if in_file := split(kind):
        path, name = folder / in_file[0], in_file[1]
        add_to_path(folder)
        plugin = _attribute(import_file(path, kind), name, kind)
    elif ":" in kind:
        module, _, name = kind.partition(":")
        plugin = _attribute(_import(lambda: import_beside(module, folder), module, kind), name, kind)
    else:
        check_known(group, kind)
        point = known(group)[kind]
        how = import_ours if _is_ours(point) else importlib.import_module
        plugin = _attribute(_import(lambda: how(point.module), point.module, kind), point.attr or "", kind)
    if not callable(plugin):
        raise PluginError(f"{kind} is {type(plugin).__name__}, not a class or function")
    return cast(Plugin, plugin)


def check_known(group: str, kind: str) -> None:
    """Raise an error for a kind without ``:`` that is not installed, without importing anything.

    Raises:
        PluginError: There is no such kind; the message has the known kinds and the nearest spelling.
    """
    names = sorted(known(group))
    if ":" not in kind and kind not in names:
        raise PluginError(
            f"unknown kind {kind!r}{nearest(kind, names)} known {group}: {listed(names)};"
            " or 'package.module:Name', './file.py:Name'"
        )


def _attribute(module: ModuleType, name: str, kind: str) -> object:
    if not hasattr(module, name):
        own = module.__name__
        names = [each for each, value in vars(module).items() if getattr(value, "__module__", None) == own]
        origin = getattr(module, "__file__", None) or own
        raise PluginError(f"{kind}: {origin} has no {name!r}{nearest(name, names)} it defines: {listed(names)}")
    return getattr(module, name)


def _import(how: Callable[[], ModuleType], module: str, kind: str) -> ModuleType:
    try:
        return how()
    except PluginError as error:
        raise PluginError(f"{kind}: {error}") from error
    except (Exception, SystemExit) as error:  # a script may exit
        raise PluginError(f"{kind}: importing {module} failed: {reason(error)}") from error
