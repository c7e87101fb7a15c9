"""Compilation to machine code, for functions that run a thousand times per simulated second."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def _folder() -> str:
    """Return the folder for the machine code of the present sources; empty if there is none that can be written.

    It is next to the sources or, in an installation that cannot be written, in the user's cache.

    numba recompiles a function when its file has changed, but not when only a file of functions that it calls has. So
    the name of the folder is a hash of the names and texts of all modules of this package, which contains all compiled
    functions.
    """
    here = Path(__file__).parent
    total = hashlib.sha256()
    for path in sorted(here.glob("*.py")):
        total.update(f"{path.name}\0".encode() + path.read_bytes())
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - without a home it stays as it is
    for parent in (here / "__pycache__", Path(cache) / "dcf-zenoh"):
        folder = parent / f"model-{total.hexdigest()[:16]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:  # it cannot be written
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return ""


FOLDER = _folder()


def compiled(function: F) -> F:
    """Return the function, compiled on its first call and cached on disk for the next process, if there is a place.

    It uses one thread, and IEEE arithmetic in the order written (`fastmath` off), so that runs are reproducible bit for
    bit.
    """
    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = FOLDER or before
    try:
        return cast(F, numba.njit(cache=bool(FOLDER), fastmath=False)(function))
    finally:
        settings.CACHE_DIR = before
