"""Link profiles: files of measured latencies, from which the latency of simulated links can be drawn.

A profile is JSON: a schema, and for each directed link the ids of its agents, the numbers of messages sent and lost,
the mean number lost in a row, quantiles of the latency, and the largest error of the difference of the two clocks.
"""

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from sys import float_info
from typing import Any

from dcf_zenoh.faults.limits import at_least

SCHEMA = "dcf-zenoh link profile 1"


@dataclass(frozen=True)
class LinkProfile:
    """One measured directed link.

    Attributes:
        sender: Id of the sending agent.
        receiver: Id of the receiving agent.
        messages: Number of messages sent.
        lost: Number of them that were lost.
        mean_burst: Mean number of messages lost in a row; 0 if none was lost.
        latency: Quantiles at probabilities from 0 to 1, equally spaced, in s; at least two.
        offset_error: Largest error of the difference of the two clocks, in s.

    Raises:
        ValueError: A value is negative or of the wrong type, or the quantiles are too few or descend.
    """

    sender: int
    receiver: int
    messages: int
    lost: int
    mean_burst: float
    latency: tuple[float, ...]
    offset_error: float

    def __post_init__(self) -> None:
        for key in ("sender", "receiver", "messages", "lost"):
            value = getattr(self, key)
            if type(value) is not int or value < 0:
                raise ValueError(f"{_KEYS.get(key, key)} must be a whole number of at least 0, not {value!r:.40}")
        for key in ("mean_burst", "offset_error"):
            at_least(key, _number(key, getattr(self, key)), 0)
        if not isinstance(self.latency, tuple) or len(self.latency) < 2:
            raise ValueError(f"latency must be a list of at least two quantiles, in s, not {self.latency!r:.40}")
        for index, value in enumerate(self.latency):
            at_least(f"latency[{index}]", _number(f"latency[{index}]", value), 0, "s")
        for low, high in pairwise(self.latency):
            if low > high:
                raise ValueError(f"latency must not descend, as it does from {low} to {high}")


_KEYS = {"sender": "from", "receiver": "to"}  # in the file
_FIELDS = {_KEYS.get(name, name): name for name in LinkProfile.__dataclass_fields__}


def read_profile(path: Path) -> tuple[LinkProfile, ...]:
    """Read the links of a profile, at least one.

    Raises:
        ValueError: The file cannot be read, or is no profile; the message names it.
    """
    try:
        return _parse(path.read_bytes())
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise ValueError(f"{path} is not a link profile: {error}") from error


def write_profile(path: Path, profiles: Iterable[LinkProfile]) -> None:
    """Write a profile, a line for each link.

    Raises:
        ValueError: There are no links, or two entries for one.
        OSError: The file cannot be written.
    """
    found = _distinct(profiles)
    links = [json.dumps({key: getattr(each, name) for key, name in _FIELDS.items()}) for each in found]
    lines = ",\n  ".join(links)
    path.write_text(f'{{"schema": "{SCHEMA}", "links": [\n  {lines}\n]}}\n', encoding="utf-8")


@lru_cache(maxsize=4)  # all links of a fleet read the same file
def _parse(content: bytes) -> tuple[LinkProfile, ...]:
    try:
        table = json.loads(content)
    except RecursionError as error:
        raise ValueError("its JSON is nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"it is not JSON: {error}" if content.strip() else "it is empty") from error
    if not isinstance(table, dict) or table.get("schema") != SCHEMA:
        found = table.get("schema", "missing") if isinstance(table, dict) else table
        raise ValueError(f"its schema must be {SCHEMA!r}, not {found!r:.40}")
    links = table.get("links")
    if not isinstance(links, list):
        raise ValueError(f"links must be a list, not {links!r:.40}")
    return _distinct(_link(index, link) for index, link in enumerate(links))


def _link(index: int, link: Any) -> LinkProfile:
    if not isinstance(link, dict) or link.keys() != _FIELDS.keys():
        raise ValueError(f"links[{index}] must have the keys {', '.join(_FIELDS)}, and no others")
    values: dict[str, Any] = {
        _FIELDS[key]: tuple(value) if isinstance(value, list) else value for key, value in link.items()
    }
    try:
        return LinkProfile(**values)
    except ValueError as error:
        raise ValueError(f"links[{index}]: {error}") from error


def _distinct(profiles: Iterable[LinkProfile]) -> tuple[LinkProfile, ...]:
    """Return all profiles; raise ValueError if there are none, or two of one link."""
    found = tuple(profiles)
    if not found:
        raise ValueError("links must not be empty")
    for (sender, receiver), entries in Counter((each.sender, each.receiver) for each in found).items():
        if entries > 1:
            raise ValueError(f"links must have one entry from {sender} to {receiver}, not {entries}")
    return found


def _number(key: str, value: object) -> float:
    if not isinstance(value, float | int) or isinstance(value, bool) or not abs(value) <= float_info.max:
        raise ValueError(f"{key} must be a number, not {value!r:.40}")
    return value
