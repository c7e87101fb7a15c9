"""Copy of a fleet in its run directory, with everything that is needed to repeat the run."""

import hashlib
import importlib.util
import json
import os
import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from dcf_zenoh.configuration.loaded_fleet import LoadedFleet
from dcf_zenoh.configuration.reading.fault_shorthand import RULE_KEYS
from dcf_zenoh.configuration.reading.validation import validate
from dcf_zenoh.configuration.toml_writer import table_of, toml
from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.errors import ConfigurationError, PluginError, RecordingError
from dcf_zenoh.plugins import load, split
from dcf_zenoh.plugins.modules_beside import COPIES, modules_in_use
from dcf_zenoh.plugins.plugin_file import original


def freeze(fleet: LoadedFleet, run_directory: Path) -> LoadedFleet:
    """Write into `run_directory` everything that is needed to repeat a run: the fleet file, and the files it names.

    Writes ``fleet.toml``, with all defaults; ``plugins/*.py`` and ``profiles/*``, copies of plug-ins and of files that
    faults read, which the fleet file then refers to; ``modules/*``, copies of the modules next to the fleet file that
    are in use; ``plugins.json``, the SHA-256 of each copy, and of the source of each plug-in that is a module, by its
    name; and ``sources.json``, the path of each copied plug-in, for tracebacks.

    Returns:
        The frozen fleet, which is not checked again.

    Raises:
        PluginError: The file of a plug-in cannot be read.
        RecordingError: The directory cannot be written.
    """
    try:
        file = _write_all(fleet, run_directory)
    except OSError as error:
        raise RecordingError(f"{run_directory}: cannot be written: {error.strerror}") from error
    spec = validate(tomllib.loads(file.read_text(encoding="utf-8")), diagnostics := Diagnostics())
    if spec is None or diagnostics:
        raise ConfigurationError(diagnostics.lines, str(file))
    return LoadedFleet(spec, run_directory, str(file), fleet.notes)


def _write_all(fleet: LoadedFleet, run_directory: Path) -> Path:
    """Write all files; return the path of the fleet file."""
    table = table_of(fleet.spec)
    copies: dict[Path, str] = {}
    digests: dict[str, str] = {}
    sources: dict[str, str] = {}

    def copy(file: str, to: str, owner: str) -> str:
        """Copy a file, once; return the name of the copy."""
        path = (fleet.folder / file).resolve()
        if path not in copies:
            copies[path] = name = _free_name(f"{to}/{path.name}", copies.values())
            sources[name] = original(path)
            digests[name] = _copy(path, run_directory / name, owner)
        return copies[path]

    for choice in _faults(table):
        for key in getattr(load("faults", choice["kind"], fleet.folder), "FILES", ()):
            if isinstance(choice.get(key), str):
                choice[key] = copy(choice[key], "profiles", choice["kind"])
    for choice in (*_kinds(table), *_faults(table)):
        kind: str = choice["kind"]
        if in_file := split(kind):
            choice["kind"] = f"./{copy(in_file[0], 'plugins', kind)}:{in_file[1]}"
        elif ":" in kind and (source := _source_of(kind.partition(":")[0])):
            digests[kind.partition(":")[0]] = hashlib.sha256(source.read_bytes()).hexdigest()
    for name, path in modules_in_use(fleet.folder):
        digests[f"{COPIES}/{name}"] = _copy(path, run_directory / COPIES / name, name)
    _write(run_directory / "sources.json", (json.dumps(sources, indent=2) + "\n").encode())
    _write(run_directory / "plugins.json", (json.dumps(digests, indent=2) + "\n").encode())
    _write(run_directory / "fleet.toml", toml(table).encode())
    return run_directory / "fleet.toml"


def _write(file: Path, content: bytes) -> None:
    """Write a file in one step: several agents may write the same file at the same time."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.{os.getpid()}")
    temporary.write_bytes(content)
    temporary.replace(file)


def _kinds(table: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield all tables that choose a plug-in, but those of faults."""
    yield from (table[key] for key in ("topology", "problem", "algorithm", "controller") if key in table)
    for family in ("algorithms", "plants"):
        yield from table.get(family, {}).values()


def _faults(table: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the tables of all faults."""
    faults = table.get("faults", {})
    for owner in (faults, *faults.get("rule", ())):
        yield from (each for key, each in owner.items() if key not in ("rule", *RULE_KEYS) and each)


def _free_name(name: str, taken: Iterable[str]) -> str:
    """Return `name`, or with ``_2``, ``_3`` and so on after its stem if it is taken."""
    names: Sequence[str] = list(taken)
    path, number = PurePosixPath(name), 1
    while name in names:
        number += 1
        name = str(path.with_stem(f"{path.stem}_{number}"))
    return name


def _copy(path: Path, to: Path, kind: str) -> str:
    """Copy a file, and return its SHA-256."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PluginError(f"{kind}: cannot read {path}: {error.strerror}") from error
    _write(to, content)
    return hashlib.sha256(content).hexdigest()


def _source_of(module: str) -> Path | None:
    """Return the file of an importable module; None if it has none."""
    loaded = sys.modules.get(module)
    try:
        spec = loaded.__spec__ if loaded else importlib.util.find_spec(module)
    except ImportError:
        return None
    return Path(spec.origin) if spec and spec.origin and Path(spec.origin).is_file() else None
