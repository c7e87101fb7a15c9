"""All kinds that a fleet file can name, as text."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from dcf_zenoh.diagnostics import show, type_name
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import REQUIRED, Parameter, accepted, known, load


def catalogue(groups: Iterable[str]) -> Iterator[str]:
    """Line by line: each group, its kinds with what they are, and the keys that each accepts.

    A kind that cannot be used is listed with the reason.
    """
    for group in groups:
        names = sorted(known(group))
        width = max(map(len, names), default=0)
        yield group
        for name in names:
            what, *keys = _kind(group, name)
            yield f"  {name:<{width}}   {what}"
            yield from (f"    {key}" for key in keys)


def _kind(group: str, name: str) -> list[str]:
    """What it is, and one line for each key."""
    try:
        plugin = load(group, name, Path())
        keys = accepted(plugin).parameters
    except PluginError as error:
        return [f"cannot be used: {'; '.join(error.problems)}"]
    summary, *_ = (plugin.__doc__ or "").strip().splitlines() or ["(undocumented)"]
    return [summary, *map(_key, keys)]


def _key(key: Parameter) -> str:
    """``accel_max: number = 2.0``."""
    if key.default is REQUIRED:
        return f"{key.name}: {type_name(key.type)}, required"
    if key.default is None:
        return f"{key.name}: {type_name(key.type)}, optional"
    default = list(key.default) if isinstance(key.default, tuple) else key.default
    return f"{key.name}: {type_name(key.type)} = {show(default)}"
