"""The error tree. Everything this project raises on purpose derives from `DcfError`."""

from collections.abc import Sequence


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
    """An algorithm broke the contract (see `dcf_zenoh.algorithms.algorithm`), or cannot solve this problem."""


class NumericalError(DcfError):
    """A plant, a controller or an algorithm produced a value that is not a number."""


class NeighbourLost(DcfError):
    """A neighbour died, froze or left in the middle of a run."""


class NetworkError(DcfError):
    """The Zenoh session could not be opened, or an endpoint is not usable."""


class NotReady(NetworkError, TimeoutError):
    """The neighbours did not all report ready before the deadline."""


class Silence(NeighbourLost, TimeoutError):
    """A message that the model requires did not come in time, although its sender is said to be alive."""


class RecordingError(DcfError):
    """A run directory or log cannot be written, or is not one of ours."""
