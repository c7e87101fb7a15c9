"""Latency: messages take time to get to the receiver."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from dcf_zenoh.faults.fault import Fault, FaultLink, Stage
from dcf_zenoh.faults.limits import at_least, positive
from dcf_zenoh.faults.profile import read_profile
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.spec import nanoseconds

Distribution: TypeAlias = Literal["constant", "uniform", "normal", "gamma", "empirical"]
Draw: TypeAlias = Callable[[np.random.Generator], float]


class Latency(Fault):
    """Every message is delayed by a latency that is drawn for it alone.

    ============  ============  ====================================================================================
    distribution  keys          latency
    ============  ============  ====================================================================================
    constant      mean          always the same
    uniform       low, high     uniform between the two
    normal        mean, std     normal, drawn again while negative: truncated, not clipped, at 0. `mean` and `std` are
                                those of the whole normal distribution; the truncated one has a slightly larger mean
                                and a smaller standard deviation
    gamma         mean, std     never negative, with a long tail; `mean` and `std` are those of this distribution
    empirical     file          as measured: linear between the quantiles of this link in a profile; for a link that was
                                not measured, those of all links of the profile, with equal probability
    ============  ============  ====================================================================================

    Args:
        link: Link of this fault; `file` is relative to its folder.
        mean: Mean latency, in s.
        distribution: One of the above.
        low: Least latency, in s.
        high: Largest latency, in s.
        std: Standard deviation, in s.
        file: Profile, as ``agentd links --export`` writes it.
        reorder: Whether a message may overtake one that was sent before. If not, it is due no earlier than that one. A
            rule for another time is another fault, which considers only the messages of that time.

    Raises:
        ValueError: A key of the distribution is missing or out of range, a key of another one is given, or the file is
            not a profile.
    """

    STAGE = Stage.DELAY
    LOSES = False
    FILES = ("file",)

    def __init__(
        self,
        link: FaultLink,
        *,
        mean: float | None = None,
        distribution: Distribution = "constant",
        low: float | None = None,
        high: float | None = None,
        std: float | None = None,
        file: str | None = None,
        reorder: bool = True,
    ) -> None:
        given = {"mean": mean, "low": low, "high": high, "std": std, "file": file}
        values = _belonging(distribution, given)
        if distribution == "empirical":
            tables = _measured(link.folder / values["file"], link.sender, link.receiver)
            self._draw = _empirical(tables)
            self._least, self._usual = min(each[0] for each in tables), max(each[len(each) // 2] for each in tables)
        else:
            self._draw = _DRAWS[distribution](**values)
            self._least = (mean if distribution == "constant" else low) or 0.0
            self._usual = mean or ((low or 0.0) + (high or 0.0)) / 2
        self._reorder = reorder
        self._latest = -(2**63)  # latest due instant so far, ns

    @property
    def least_delay(self) -> float:
        """Shortest latency, s."""
        return self._least

    @property
    def usual_delay(self) -> float:
        """Mean latency, s; of a measured link, its median."""
        return self._usual

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> tuple[Delivery]:
        """Delay the message."""
        due = delivery.due + nanoseconds(self._draw(rng))
        if not self._reorder:
            due = self._latest = max(due, self._latest)
        return (Delivery(delivery.message, delivery.entered, due, delivery.here),)


_KEYS = {
    "constant": ("mean",),
    "uniform": ("low", "high"),
    "normal": ("mean", "std"),
    "gamma": ("mean", "std"),
    "empirical": ("file",),
}


def _belonging(distribution: str, given: dict[str, Any]) -> dict[str, Any]:
    """Return the values of the keys of `distribution`; raise ValueError unless exactly these are given."""
    if distribution not in _KEYS:
        raise ValueError(f"distribution must be one of {', '.join(_KEYS)}, not {distribution!r}")
    keys = _KEYS[distribution]
    for key, value in given.items():
        if value is not None and key not in keys:
            raise ValueError(f"{key} is no key of distribution {distribution!r}, which takes {' and '.join(keys)}")
        if value is None and key in keys:
            raise ValueError(f"{key} is missing: distribution {distribution!r} takes {' and '.join(keys)}")
    return {key: given[key] for key in keys}


def _constant(mean: float) -> Draw:
    at_least("mean", mean, 0, "s")
    return lambda _: mean


def _uniform(low: float, high: float) -> Draw:
    at_least("high", high, at_least("low", low, 0, "s"), "s")
    return lambda rng: rng.uniform(low, high)


def _normal(mean: float, std: float) -> Draw:
    at_least("mean", mean, 0, "s")  # at least half of all draws are not negative
    positive("std", std, "s")

    def draw(rng: np.random.Generator) -> float:
        while (latency := mean + std * rng.standard_normal()) < 0:
            pass
        return latency

    return draw


def _gamma(mean: float, std: float) -> Draw:
    if not positive("std", std, "s") >= 1e-6 * positive("mean", mean, "s"):
        raise ValueError(f"std must be at least a millionth of the mean, {mean:g}, in s, not {std}")
    shape, scale = (mean / std) ** 2, std**2 / mean
    return lambda rng: rng.gamma(shape, scale)


def _measured(path: Path, sender: int, receiver: int) -> list[tuple[float, ...]]:
    """Return the quantiles of a link in a profile; for a link that was not measured, those of all links."""
    profiles = read_profile(path)
    own = [each for each in profiles if (each.sender, each.receiver) == (sender, receiver)]
    return [each.latency for each in own or profiles]


def _empirical(tables: Sequence[Sequence[float]]) -> Draw:
    """Return a draw from the inverse of the distribution function, linear between quantiles."""

    def draw(rng: np.random.Generator) -> float:
        index, probability = divmod(rng.random() * len(tables), 1)  # one number: table and place in it
        table = tables[int(index)]
        left, part = divmod(probability * (len(table) - 1), 1)
        low, high = table[int(left)], table[int(left) + 1]
        return low + part * (high - low)

    return draw


_DRAWS: dict[str, Callable[..., Draw]] = {
    "constant": _constant,
    "uniform": _uniform,
    "normal": _normal,
    "gamma": _gamma,
}
