"""Compilation to machine code, for functions that run a thousand times per simulated second."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def _folder() -> str:
    """Return the folder for the machine code of the present sources; empty for numba's own choice.

    numba recompiles a function when its file has changed, but not when only a file of functions that it calls has. So
    the name of the folder is a hash of the names and texts of all modules of this package, which contains all compiled
    functions.
    """
    here = Path(__file__).parent
    total = hashlib.sha256()
    for path in sorted(here.glob("*.py")):
        total.update(f"{path.name}\0".encode() + path.read_bytes())
    folder = here / "__pycache__" / f"model-{total.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # a read-only installation
        return ""
    return str(folder)


FOLDER = _folder()


def compiled(function: F) -> F:
    """Return the function, compiled on its first call and cached on disk for the next process.

    It uses one thread, and IEEE arithmetic in the order written (`fastmath` off), so that runs are reproducible bit for
    bit.
    """
    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = FOLDER or before
    try:
        return cast(F, numba.njit(cache=True, fastmath=False)(function))
    finally:
        settings.CACHE_DIR = before
