"""Calls of plug-ins: positional arguments come from the framework, keyword arguments from the fleet file."""

import functools
from collections.abc import Iterable, Mapping
from typing import Any

from dcf_zenoh.diagnostics import listed, nearest, reason
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins.loading import Plugin
from dcf_zenoh.plugins.schema import accepted, name_of, signature_of

# Names of the positional parameters that the framework can fill, by group.
CONTEXT: Mapping[str, tuple[str, ...]] = {
    "algorithms": (),
    "controllers": ("problem", "algorithm", "me", "sample_time"),
    "problems": ("agent", "agents", "sample_time", "nominal"),
    "plants": ("agent", "start", "sample_time", "rng"),
    "topologies": ("agents",),
    "faults": ("link", "sender", "receiver", "folder"),
}
GROUPS = tuple(CONTEXT)


def create(plugin: Plugin, context: Mapping[str, Any], options: Mapping[str, Any], where: str) -> Any:
    """Call `plugin`: positional parameters by name from `context`, keyword-only ones from `options`.

    Raises:
        PluginError: Options do not fit, a positional parameter is not in the context, or the call fails.
    """
    values, errors = check_options(plugin, options, where)
    errors += [f"{where}: {text}" for text in check_positional(plugin, context)]
    if errors:
        raise PluginError(errors)
    try:
        return plugin(*(context[name] for name in positional(plugin)), **values)
    except Exception as error:
        raise PluginError(f"{where}: {name_of(plugin)} refused its options: {reason(error)}") from error


def bind(plugin: Plugin, options: Mapping[str, Any], where: str) -> Plugin:
    """Return an algorithm with its options bound, to be called with problem and me.

    Raises:
        PluginError: Options do not fit.
    """
    values, errors = check_options(plugin, options, where)
    if errors:
        raise PluginError(errors)
    return functools.partial(plugin, **values)


def check_options(plugin: Plugin, options: Mapping[str, Any], where: str) -> tuple[dict[str, Any], list[str]]:
    """Return the values that `plugin` gets for `options`, and one line for each key that does not fit or is missing."""
    schema = accepted(plugin)
    values, errors = schema.convert(options)
    errors |= schema.missing(options)
    return values, [f"{where}.{key}: {text}" for key, text in errors.items()]


def check_positional(plugin: Plugin, context: Iterable[str]) -> list[str]:
    """Return one line for each positional parameter that the framework cannot fill."""
    names = list(context)
    return [
        f"{name_of(plugin)} has a positional parameter {name!r}{nearest(name, names)} allowed: {listed(names)};"
        " keys of the fleet file go after '*'"
        for name in positional(plugin)
        if name not in names
    ]


def check_signature(group: str, plugin: Plugin) -> list[str]:
    """Return one line for each error in the positional parameters of a plug-in of `group`."""
    if group != "algorithms":
        return check_positional(plugin, CONTEXT[group])
    names = positional(plugin)
    if len(names) == 2:
        return []
    return [f"{name_of(plugin)}: an algorithm's signature is (problem, me, *, options), not ({listed(names)}, ...)"]


def positional(plugin: Plugin) -> list[str]:
    """Return the names of the parameters that the framework fills."""
    parameters = signature_of(plugin).parameters.values()
    return [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
