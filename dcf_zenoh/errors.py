"""The errors of the project. Everything that it raises on purpose derives from `DcfError`."""

import os
import sysconfig
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

_LIBRARIES = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
_NOT_THE_USERS = tuple(os.path.join(folder, "") for folder in (str(Path(__file__).parent), *_LIBRARIES))  # noqa: PTH118


class DcfError(Exception):
    """Base class of all errors of dcf-zenoh."""


class ConfigurationError(DcfError):
    """A fleet file, an option or a plug-in is not usable. The error has all problems found, not only the first.

    Attributes:
        problems: One line per problem, which names the key, what was expected and what is allowed.
        source: File or other origin of the problems.
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

    An exception raised by it, its problem or its controller is the cause.
    """


class FaultError(DcfError):
    """A fault of a link raised an exception, which is the cause, or did not return deliveries."""


class PlantError(DcfError):
    """A plant raised an exception, which is the cause."""


class NumericalError(DcfError):
    """A plant, a controller or an algorithm produced a value that is not a number."""


class NeighbourLost(DcfError):
    """A neighbour crashed, froze or left in the middle of a run."""


class Landed(DcfError):
    """An agent ended its flight early, because a safety rule demanded it."""


class Stopped(DcfError):
    """An agent was requested to end early."""


class NetworkError(DcfError):
    """The Zenoh session could not be opened, or an endpoint is not usable."""


class NotReady(NetworkError, TimeoutError):
    """The neighbours did not all report ready before the deadline."""


class Silence(NeighbourLost, TimeoutError):
    """A required message did not come in time, although its sender is known to be alive."""


class Interrupted(DcfError):
    """A run was stopped from outside.

    Attributes:
        signal: Number of the signal that requested it.
    """

    def __init__(self, text: str, signal: int) -> None:
        self.signal = signal
        super().__init__(text)


class RecordingError(DcfError):
    """A run directory or log cannot be written, or was not written by dcf-zenoh."""


class HasFindings(DcfError):
    """A run has findings, such as a violation of a safety region, where none are allowed."""


class LogIncomplete(RecordingError):
    """An agent has reached its end, but records of its log are missing, because of a full disk, for example."""


@contextmanager
def blaming(kind: type[DcfError], where: str) -> Iterator[None]:
    """Turn any exception of the body other than a `DcfError` into a `kind` that names `where` and the line of code."""
    try:
        yield
    except DcfError:
        raise
    except (Exception, SystemExit) as error:
        raise kind(f"{where}: {account(error)}") from error


def account(error: BaseException) -> str:
    """Return type, text and line of an exception in one line: ``ZeroDivisionError: division by zero (mine.py:17)``.

    The line of code is the innermost one outside of this package and of installed ones, if there is any.
    """
    frames = traceback.extract_tb(error.__traceback__)
    users = [frame for frame in frames if not frame.filename.startswith(_NOT_THE_USERS)]
    at = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in (users or frames)[-1:])
    return " ".join(f"{type(error).__name__}: {error}".removesuffix(": ").split()) + at
