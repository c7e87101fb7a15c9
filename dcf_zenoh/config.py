"""Fleet files: read, check, write out complete, freeze."""

import hashlib
import importlib.util
import json
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from dcf_zenoh.checks import check
from dcf_zenoh.draft import read
from dcf_zenoh.errors import ConfigurationError, PluginError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plugins import is_built_in, split
from dcf_zenoh.plugins import load as load_plugin
from dcf_zenoh.schema import accepted
from dcf_zenoh.spec import FleetSpec, Kind
from dcf_zenoh.topology import draw, weights_of
from dcf_zenoh.validation import validate
from dcf_zenoh.wording import Problems

__all__ = ["LoadedFleet", "freeze", "graph_of", "load", "to_toml", "weights_of"]


@dataclass(frozen=True)
class LoadedFleet:
    """A fleet file, checked.

    Attributes:
        spec: The fleet.
        folder: What the paths of plug-ins are relative to.
        source: The file.
        notes: What the user should know, one line each.
    """

    spec: FleetSpec
    folder: Path
    source: str
    notes: tuple[str, ...] = ()


def load(
    source: str | Path,
    *,
    changes: Iterable[str] = (),
    seed: int | None = None,
    clock: str | None = None,
    plant: str | None = None,
    algorithm: str | None = None,
    topology: str | None = None,
    run_plugins: bool = True,
) -> LoadedFleet:
    """Read and check a fleet file.

    Plug-ins in use are imported and their signatures checked; nothing is constructed but the topology. Files of
    plug-ins given by arguments are looked for in the working directory, then beside the fleet file.

    Args:
        source: A path, or the name of a built-in fleet.
        changes: Of single keys, ``key.path=value``, applied in order after all other arguments.
        seed: In place of the file's.
        clock: In place of the file's.
        plant: Name of a table in [plants], or a kind, for all agents.
        algorithm: Name of a table in [algorithms], or a kind, in place of [algorithm].
        topology: A kind, in place of the file's.
        run_plugins: Import plug-ins that are not part of dcf-zenoh; without it, what their text tells is checked.

    Raises:
        ConfigurationError: With all problems of the file, one line each.
    """
    draft = read(source)
    if plant is not None:
        draft.choose_plant(plant)
    if algorithm is not None:
        draft.choose_algorithm(algorithm)
    for path, value in ((("topology", "kind"), topology), (("seed",), seed), (("time", "clock"), clock)):
        if value is not None:
            draft.assign(path, value)
    for change in changes:
        draft.change(change)
    draft.complete()
    spec = validate(draft.table, draft.problems)
    if spec is not None:
        check(spec, draft.folder, draft.problems, draft.notes, run_plugins=run_plugins)
    if spec is None or draft.problems:
        raise ConfigurationError(draft.problems.lines, draft.source)
    spec = _with_defaults(spec, draft.folder, run_plugins=run_plugins)
    return LoadedFleet(spec, draft.folder, draft.source, tuple(draft.notes))


def _with_defaults(spec: FleetSpec, folder: Path, *, run_plugins: bool) -> FleetSpec:
    """The same fleet with the defaults of its plug-ins written out, as far as TOML can write them."""

    def fill(group: str, kind: Kind) -> Kind:
        if not (run_plugins or is_built_in(group, kind.kind)):
            return kind
        defaults = {
            parameter.name: list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
            for parameter in accepted(load_plugin(group, kind.kind, folder)).parameters
            if isinstance(parameter.default, bool | int | float | str | tuple)
        }
        return kind.with_options({**defaults, **kind.options})

    users = {own.plant or spec.plant for own in spec.agents.values()}
    return spec.model_copy(
        update={
            "topology": fill("topologies", spec.topology),
            "problem": fill("problems", spec.problem),
            "algorithm": fill("algorithms", spec.algorithm),
            "controller": fill("controllers", spec.controller_kind),
            "plants": {
                name: fill("plants", kind) if name in users else kind for name, kind in spec.plants.items()
            },
        }
    )


def graph_of(fleet: LoadedFleet) -> Graph:
    """Who hears whom.

    Raises:
        PluginError: The topology cannot be loaded, or refuses its options.
        TopologyError: The links do not make a strongly connected graph on the agents.
    """
    return draw(fleet.spec, fleet.folder)


def to_toml(spec: FleetSpec) -> str:
    """The fleet file of `spec`, with all defaults written out; it loads to an equal specification."""
    return _text(_table_of(spec))


def freeze(fleet: LoadedFleet, run_directory: Path) -> LoadedFleet:
    """Write into `run_directory` all that a run needs to be repeated: the fleet file, and plug-ins that are files.

    Writes ``fleet.toml``, with all defaults; ``plugins/*.py``, copies that it refers to; and ``plugins.json``, the
    SHA-256 of each copy, and by its name of the source of each plug-in that is a module.

    Returns:
        The frozen fleet, not checked again.

    Raises:
        PluginError: The file of a plug-in cannot be read.
    """
    table = _table_of(fleet.spec)
    copies: dict[Path, str] = {}
    digests: dict[str, str] = {}
    for choice in _kinds(table):
        kind: str = choice["kind"]
        if in_file := split(kind):
            path = (fleet.folder / in_file[0]).resolve()
            if path not in copies:
                copies[path] = _free_name(path.stem, copies.values())
                digests[copies[path]] = _copy(path, run_directory / copies[path], kind)
            choice["kind"] = f"./{copies[path]}:{in_file[1]}"
        elif ":" in kind and (source := _source_of(kind.partition(":")[0])):
            digests[kind.partition(":")[0]] = hashlib.sha256(source.read_bytes()).hexdigest()
    run_directory.mkdir(parents=True, exist_ok=True)
    (run_directory / "plugins.json").write_text(json.dumps(digests, indent=2) + "\n", encoding="utf-8")
    file = run_directory / "fleet.toml"
    file.write_text(_text(table), encoding="utf-8")
    spec = validate(tomllib.loads(file.read_text(encoding="utf-8")), problems := Problems())
    if spec is None or problems:
        raise ConfigurationError(problems.lines, str(file))
    return LoadedFleet(spec, run_directory, str(file), fleet.notes)


def _table_of(spec: FleetSpec) -> dict[str, Any]:
    """All keys of a fleet file but empty tables."""
    table = spec.model_dump(by_alias=True, exclude_none=True)
    table["agents"] = {str(agent): own for agent, own in table["agents"].items()}
    for owner in (table, table["zenoh"], *table["agents"].values()):
        for key in [key for key, value in owner.items() if value == {}]:
            del owner[key]
    return table


def _text(table: dict[str, Any]) -> str:
    """`table` in TOML, lists on one line. Strings hold no raw line breaks, so those in sight are structure."""
    text = tomli_w.dumps(table)
    return re.sub(r",?\n *\]", "]", re.sub(r",\n +", ", ", re.sub(r"\[\n +", "[", text)))


def _kinds(table: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """All tables that choose a plug-in."""
    yield from (table[key] for key in ("topology", "problem", "algorithm", "controller") if key in table)
    for family in ("algorithms", "plants"):
        yield from table.get(family, {}).values()


def _free_name(stem: str, taken: Iterable[str]) -> str:
    """``plugins/STEM.py``, or with a number where that is taken."""
    names: Sequence[str] = list(taken)
    number, name = 1, f"plugins/{stem}.py"
    while name in names:
        number += 1
        name = f"plugins/{stem}_{number}.py"
    return name


def _copy(path: Path, to: Path, kind: str) -> str:
    """Copy a file, and return its SHA-256."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PluginError(f"{kind}: cannot read {path}: {error.strerror}") from error
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def _source_of(module: str) -> Path | None:
    """The file of an importable module; None if it has none."""
    loaded = sys.modules.get(module)
    try:
        spec = loaded.__spec__ if loaded else importlib.util.find_spec(module)
    except ImportError:
        return None
    return Path(spec.origin) if spec and spec.origin and Path(spec.origin).is_file() else None
