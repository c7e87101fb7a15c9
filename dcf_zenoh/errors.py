"""The error tree. Everything this project raises on purpose derives from `DcfError`."""

import os
import sysconfig
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_LIBRARIES = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
_NOT_THE_USERS = tuple(os.path.join(folder, "") for folder in (str(Path(__file__).parent), *_LIBRARIES))  # noqa: PTH118


class DcfError(Exception):
    """Base of all errors of dcf-zenoh."""


class ConfigurationError(DcfError):
    """A fleet file, an option or a plug-in is not usable. Carries all problems found, not the first alone.

    Attributes:
        problems: One line per problem; each names the key, what was expected and what is allowed.
        source: The file (or other origin) the problems are in.
    """

    def __init__(self, problems: str | Sequence[str], source: str = "") -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(problems)
        self.source = source
        prefix = f"{source}: " if source else ""
        super().__init__("\n".join(prefix + problem for problem in self.problems))


class TopologyError(ConfigurationError):
    """A communication graph is malformed, or not connected."""


class PluginError(ConfigurationError):
    """A kind is unknown, cannot be loaded, or refuses its options."""


class MessageError(DcfError):
    """Bytes received are not a message of this version, or a payload cannot be sent."""


class AlgorithmError(DcfError):
    """An algorithm broke the contract (see `dcf_zenoh.algorithms.algorithm`), or cannot solve this problem.

    Where it, its problem or its controller raised an exception, that is the cause.
    """


class FaultError(DcfError):
    """A fault of a link raised an exception, which is the cause, or returned something else than deliveries."""


class PlantError(DcfError):
    """A plant raised an exception; that is the cause."""


class NumericalError(DcfError):
    """A plant, a controller or an algorithm produced a value that is not a number."""


class NeighbourLost(DcfError):
    """A neighbour died, froze or left in the middle of a run."""


class Landed(DcfError):
    """An agent ended its flight before its time, because something happened that must not."""


class Stopped(DcfError):
    """An agent was told to end before its time."""


class NetworkError(DcfError):
    """The Zenoh session could not be opened, or an endpoint is not usable."""


class NotReady(NetworkError, TimeoutError):
    """The neighbours did not all report ready before the deadline."""


class Silence(NeighbourLost, TimeoutError):
    """A message that the model requires did not come in time, although its sender is said to be alive."""


class Interrupted(DcfError):
    """Somebody stopped a run.

    Attributes:
        signal: Number of the signal that asked for it.
    """

    def __init__(self, text: str, signal: int) -> None:
        self.signal = signal
        super().__init__(text)


class RecordingError(DcfError):
    """A run directory or log cannot be written, or is not one of ours."""


@contextmanager
def blaming(kind: type[DcfError], where: str) -> Iterator[None]:
    """Turn any exception of the body but our own into a `kind` that names `where` and the line of code."""
    try:
        yield
    except DcfError:
        raise
    except (Exception, SystemExit) as error:
        raise kind(f"{where}: {account(error)}") from error


def account(error: BaseException) -> str:
    """What code of others raised, and where, in one line: ``ZeroDivisionError: division by zero (mine.py:17)``.

    The line is the innermost one that is neither of this package nor of an installed one, if there is any.
    """
    frames = traceback.extract_tb(error.__traceback__)
    users = [frame for frame in frames if not frame.filename.startswith(_NOT_THE_USERS)]
    at = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in (users or frames)[-1:])
    return " ".join(f"{type(error).__name__}: {error}".removesuffix(": ").split()) + at
