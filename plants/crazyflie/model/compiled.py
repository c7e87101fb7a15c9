"""Compilation to machine code: what takes a thousand small steps per simulated second cannot be interpreted."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def _folder() -> str:
    """Return where the machine code of the present sources is kept; empty for numba's own choice.

    numba compiles a function anew when its file changed, but not when only a file of functions that it calls did. So
    all modules of this package, which holds whatever is compiled, name the folder: their names and their texts.
    """
    here = Path(__file__).parent
    total = hashlib.sha256()
    for path in sorted(here.glob("*.py")):
        total.update(f"{path.name}\0".encode() + path.read_bytes())
    folder = here / "__pycache__" / f"model-{total.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # an installation that may not be written
        return ""
    return str(folder)


FOLDER = _folder()


def compiled(function: F) -> F:
    """The same function, compiled on its first call and kept on disk for the next process.

    One thread, and IEEE arithmetic in the order written (`fastmath` off), so that a run repeats to the last bit.
    """
    settings: Any = numba.config
    before = settings.CACHE_DIR
    settings.CACHE_DIR = FOLDER or before
    try:
        return cast(F, numba.njit(cache=True, fastmath=False)(function))
    finally:
        settings.CACHE_DIR = before
