"""Fleet files: read and check them, write them out complete, freeze them for a run."""

from collections.abc import Iterable
from pathlib import Path

from dcf_zenoh.configuration.building.graph import draw, weights_of
from dcf_zenoh.configuration.checks.all_checks import check
from dcf_zenoh.configuration.loaded_fleet import LoadedFleet
from dcf_zenoh.configuration.reading.draft import read
from dcf_zenoh.configuration.reading.layout import lay_out
from dcf_zenoh.configuration.reading.overrides import NO_OVERRIDES, Overrides
from dcf_zenoh.configuration.reading.plugin_defaults import with_defaults
from dcf_zenoh.configuration.reading.validation import validate
from dcf_zenoh.configuration.run_copy import freeze
from dcf_zenoh.configuration.toml_writer import to_toml
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.graph import Graph

__all__ = ["LoadedFleet", "Overrides", "freeze", "graph_of", "load", "to_toml", "weights_of"]


def load(
    source: str | Path,
    overrides: Overrides = NO_OVERRIDES,
    *,
    changes: Iterable[str] = (),
    run_plugins: bool = True,
    unused: bool = True,
) -> LoadedFleet:
    """Read and check a fleet file.

    Plug-ins in use are imported, their signatures checked and their defaults filled in. The topology, the faults, and
    built-in problems and plants are constructed, to see what they refuse; nothing else is. Files that `overrides` and
    `changes` name are looked for in the working directory, then next to the fleet file.

    Args:
        source: A path, or the name of a built-in fleet.
        overrides: Choices that replace those of the file.
        changes: Changes of single keys, ``key.path=value``, applied in order after `overrides`.
        run_plugins: Import plug-ins that are not part of dcf-zenoh. Without it, only the keys found in the text of
            their files are checked, and their defaults are not filled in.
        unused: Also check algorithms and plants that no agent uses, which imports those of dcf-zenoh.

    Raises:
        ConfigurationError: The file is not usable; the error has all problems, one line each.
    """
    draft = read(source, run_plugins=run_plugins)
    draft.override(overrides)
    for change in changes:
        draft.change(change)
    draft.complete()
    spec = validate(draft.table, draft.diagnostics) if lay_out(draft) else None
    if spec is not None:
        check(spec, draft.folder, draft.diagnostics, draft.notes, run_plugins=run_plugins, unused=unused)
    if spec is None or draft.diagnostics:
        raise ConfigurationError(draft.diagnostics.lines, draft.source)
    spec = with_defaults(spec, draft.folder, run_plugins=run_plugins)
    return LoadedFleet(spec, draft.folder, draft.source, tuple(draft.notes))


def graph_of(fleet: LoadedFleet) -> Graph:
    """Return the communication graph of a fleet.

    Raises:
        PluginError: The topology cannot be loaded, or refuses its options.
        TopologyError: The links do not make a strongly connected graph on the agents.
    """
    return draw(fleet.spec, fleet.folder)
