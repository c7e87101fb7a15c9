"""Modules next to a fleet file: plug-ins such as ``my_lab.tracking:fn``, and what plug-ins import."""

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType

from dcf_zenoh.errors import PluginError

COPIES = "modules"  # folder of their copies in a run directory
OURS = ("agentd", "dcf_zenoh", "plants", "topologies")  # packages of dcf-zenoh
_HOME = Path(__file__).resolve().parents[2]  # folder that these packages are in


def add_to_path(folder: Path) -> None:
    """Let modules next to a fleet file be imported, where there is none of their name elsewhere."""
    for each in (folder, folder / COPIES):
        path = str(each.resolve())
        if each.is_dir() and path not in sys.path:
            sys.path.append(path)


def import_beside(module: str, folder: Path) -> ModuleType:
    """Import a module from next to a fleet file if there is one of this name, or else from anywhere.

    Args:
        module: Name of the module.
        folder: Folder of the fleet file.

    Raises:
        ImportError: There is no such module.
        PluginError: A module of this name was imported from elsewhere before.
    """
    add_to_path(folder)
    top = module.partition(".")[0]
    places = [str(each.resolve()) for each in (folder, folder / COPIES)]
    spec = None if top in OURS else PathFinder.find_spec(top, places)
    if spec is None or spec.origin is None:
        return importlib.import_module(module)
    if top not in sys.modules:
        loaded = importlib.util.module_from_spec(spec)
        sys.modules[top] = loaded
        try:
            if spec.loader is not None:
                spec.loader.exec_module(loaded)
        except BaseException:
            sys.modules.pop(top, None)
            raise
    elif not _alike(origin := getattr(sys.modules[top], "__file__", None), spec.origin):
        raise PluginError(f"{top} next to the fleet file, {spec.origin}, is not the {top} in use, {origin}: rename it")
    return importlib.import_module(module)


def _alike(file: str | None, other: str) -> bool:
    """Return whether two files are the same, or one is a copy of the other in a run directory."""
    return file == other or (file is not None and Path(file).read_bytes() == Path(other).read_bytes())


def import_ours(module: str) -> ModuleType:
    """Import a module of dcf-zenoh.

    Raises:
        ImportError: The installation is incomplete.
        PluginError: A module elsewhere has the name of one of its packages, and hides it.
    """
    top = module.partition(".")[0]
    if top in sys.modules:
        origin = getattr(sys.modules[top], "__file__", None)
    else:
        spec = PathFinder.find_spec(top)
        origin = spec.origin if spec else None
    if origin is not None and Path(origin).resolve().parent != _HOME / top:
        raise PluginError(
            f"{origin} hides the package {top!r} of dcf-zenoh: rename it, or start Python in another folder"
        )
    return importlib.import_module(module)


def modules_in_use(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield name and file of the modules next to a fleet file that are in use, with the rest of their packages.

    Args:
        folder: Folder of the fleet file.

    Yields:
        Path below `folder`, with slashes, and the file.
    """
    folder = folder.resolve()
    tops = {name.partition(".")[0] for name, module in list(sys.modules.items()) if _is_in(name, module, folder)}
    for top in sorted(tops - set(OURS)):
        package = folder / top
        files = sorted(package.rglob("*.py")) if package.is_dir() else [folder / f"{top}.py"]
        yield from ((each.relative_to(folder).as_posix(), each) for each in files)


def _is_in(name: str, module: ModuleType, folder: Path) -> bool:
    """Return whether a module was imported relative to `folder`."""
    origin = getattr(module, "__file__", None)
    below = folder.joinpath(*name.split("."))
    return origin is not None and Path(origin).resolve() in (below.with_suffix(".py"), below / "__init__.py")
