"""A bare value in place of the table of a plug-in: ``loss = 0.2`` is ``loss = { kind = "loss", probability = 0.2 }``.

It stands for the first key of the kind. Until that key is known, the value has the key `BARE` in the table.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins.loading import is_built_in, load
from dcf_zenoh.plugins.plugin_file import peek, split
from dcf_zenoh.plugins.schema import accepted

BARE = "value"


def spelled_out(group: str, table: Mapping[str, Any], folder: Path, *, run: bool) -> dict[str, Any]:
    """Return a table with its bare value under the first key of its kind.

    A table that has both a bare value and the first key stays as it is, and so does one whose first key cannot be
    found.

    Args:
        group: Group of the plug-in, such as ``faults``.
        table: Kind and keys of the plug-in.
        folder: What the paths of plug-ins are relative to.
        run: Import plug-ins that are not part of dcf-zenoh. Without it only the text of files is read.
    """
    first = first_key(group, table["kind"], folder, run=run) if BARE in table else BARE
    if first in table:
        return dict(table)
    return {first if key == BARE else key: value for key, value in table.items()}


def first_key(group: str, kind: object, folder: Path, *, run: bool) -> str:
    """Return the first key of a kind; `BARE` if it cannot be found, or if there are no keys."""
    if not isinstance(kind, str):
        return BARE
    try:
        may_run = run or is_built_in(group, kind)
        schema = accepted(load(group, kind, folder)) if may_run else peek(kind, folder) if split(kind) else None
    except PluginError:  # reported by the checks
        return BARE
    return schema.parameters[0].name if schema and schema.parameters else BARE
