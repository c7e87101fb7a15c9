"""List of all kinds that a fleet file can name, with their keys."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from dcf_zenoh.diagnostics import show, type_name
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import REQUIRED, Parameter, accepted, known, load


def catalogue(groups: Iterable[str]) -> Iterator[str]:
    """Yield the lines of the list: each group, its kinds with their summaries, and the keys of each kind.

    A kind that cannot be used is listed with the reason.

    Args:
        groups: Groups of entry points, of `dcf_zenoh.plugins.GROUPS`.
    """
    for group in groups:
        names = sorted(known(group))
        width = max(map(len, names), default=0)
        yield group
        for name in names:
            summary, *keys = _kind(group, name)
            yield f"  {name:<{width}}   {summary}"
            yield from (f"    {key}" for key in keys)


def _kind(group: str, name: str) -> list[str]:
    """Return the summary of a kind, followed by one line for each key."""
    try:
        plugin = load(group, name, Path())
        keys = accepted(plugin).parameters
    except PluginError as error:
        return [f"cannot be used: {'; '.join(error.problems)}"]
    summary, *_ = (plugin.__doc__ or "").strip().splitlines() or ["(undocumented)"]
    return [summary, *(line for key in keys for line in _key(key))]


def _key(key: Parameter, path: str = "") -> Iterator[str]:
    """Yield ``accel_max: number = 2.0``; for a sub-table a line for each of its keys, ``weights.input: number``."""
    name = f"{path}{key.name}"
    if key.default is REQUIRED:
        yield f"{name}: {type_name(key.type)}, required"
    elif key.default is None:
        yield f"{name}: {type_name(key.type)}, optional"
    elif key.table is None:
        default = list(key.default) if isinstance(key.default, tuple) else key.default
        yield f"{name}: {type_name(key.type)} = {show(default)}"
    for each in key.table.parameters if key.table else ():
        yield from _key(each, f"{name}.")
