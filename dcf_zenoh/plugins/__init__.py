"""Plug-ins: how the kinds of a fleet file become algorithms, problems, plants, faults and so on.

A kind is the name of a built-in or installed entry point (group ``dcf_zenoh.<group>``), ``package.module:Name``, or
``./file.py:Name`` relative to the fleet file. A plug-in in a file stands alone: it can import installed packages, but
not the files next to it.
"""

from dcf_zenoh.plugins.bare_value import BARE, first_key, spelled_out
from dcf_zenoh.plugins.calling import (
    CONTEXT,
    GROUPS,
    bind,
    check_options,
    check_positional,
    check_signature,
    create,
    positional,
)
from dcf_zenoh.plugins.loading import Plugin, check_known, is_built_in, known, load
from dcf_zenoh.plugins.plugin_file import peek, split
from dcf_zenoh.plugins.schema import REQUIRED, Parameter, Schema, accepted

__all__ = [
    "BARE",
    "CONTEXT",
    "GROUPS",
    "REQUIRED",
    "Parameter",
    "Plugin",
    "Schema",
    "accepted",
    "bind",
    "check_known",
    "check_options",
    "check_positional",
    "check_signature",
    "create",
    "first_key",
    "is_built_in",
    "known",
    "load",
    "peek",
    "positional",
    "spelled_out",
    "split",
]
