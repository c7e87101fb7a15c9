"""Fleet files on disk: where they are, and their text as tables."""

import tomllib
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from importlib import resources
from pathlib import Path
from typing import Any

from dcf_zenoh.diagnostics import listed, nearest
from dcf_zenoh.errors import ConfigurationError


def find(source: str | Path) -> Path:
    """Return the path of a fleet file.

    Args:
        source: A path, or the name of a built-in fleet.

    Raises:
        ConfigurationError: There is no such file, and no built-in fleet of this name.
    """
    path, names = Path(source), _built_in()
    if str(source) in names:
        return names[str(source)]
    if path.is_file():
        return path
    if path.suffix or len(path.parts) > 1:
        raise ConfigurationError("there is no such file", str(source))
    raise ConfigurationError(
        f"no file and no built-in fleet of this name{nearest(str(source), names)} built in: {listed(names)}",
        str(source),
    )


def parse(path: Path) -> dict[str, Any]:
    """Return the content of a fleet file as tables.

    Raises:
        ConfigurationError: The file cannot be read, or is not TOML.
    """
    try:
        data = path.read_bytes()
        utf_16 = len(data) > 2 and data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE)  # as some editors of Windows write it
        return tomllib.loads(data.decode("utf-16" if utf_16 else "utf-8-sig").replace("\r\n", "\n"))
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"not TOML: {error}", str(path)) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"not TOML, which is UTF-8: {error}", str(path)) from error
    except OSError as error:
        raise ConfigurationError(f"cannot be read: {error.strerror}", str(path)) from error


def _built_in() -> dict[str, Path]:
    """Return the fleet files that come with agentd, by name."""
    try:
        folder = resources.files("agentd.fleets")
    except ModuleNotFoundError:
        return {}
    paths = sorted(Path(str(each)) for each in folder.iterdir())
    return {path.stem: path for path in paths if path.suffix == ".toml"}
