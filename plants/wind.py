"""Wind: a mean and gusts."""

import math
from dataclasses import dataclass

import numpy as np

from dcf_zenoh.plant import Array, read_only


@dataclass(frozen=True)
class WindOptions:
    """Keys of a sub-table ``wind``.

    Attributes:
        mean: Mean velocity ``[x, y]`` or ``[x, y, z]``, in m/s, world frame.
        gusts: Standard deviation of each horizontal component around the mean, in m/s.
        gust_time: Time in which a gust's correlation falls to 1/e, in s.

    Raises:
        ValueError: `gusts` is negative, or `gust_time` is not positive.
    """

    mean: tuple[float, float] | tuple[float, float, float] = (0.0, 0.0)
    gusts: float = 0.0
    gust_time: float = 1.0

    def __post_init__(self) -> None:
        if not self.gusts >= 0:
            raise ValueError(f"gusts must be a standard deviation >= 0, in m/s, not {self.gusts}")
        if not self.gust_time > 0:
            raise ValueError(f"gust_time must be positive, in s, not {self.gust_time}")


class Wind:
    """Velocity of the air around one body: a constant mean, and gusts on each horizontal axis.

    A gust is an Ornstein-Uhlenbeck process, started in its stationary distribution and stepped exactly, so its
    statistics do not depend on the step. Agents' gusts are independent of each other.

    Args:
        options: Mean and gusts.
        rng: Source of the gusts.

    Attributes:
        velocity: Present velocity, shape (3,), in m/s, world frame. Read-only.

    Source: Uhlenbeck and Ornstein, "On the Theory of the Brownian Motion", Phys. Rev. 36, 1930; exact step as in
    Gillespie, "Exact Numerical Simulation of the Ornstein-Uhlenbeck Process and Its Integral", Phys. Rev. E 54, 1996.
    """

    def __init__(self, options: WindOptions, *, rng: np.random.Generator) -> None:
        self._mean = np.array([*options.mean, 0.0][:3], dtype=np.float64)
        self._deviation = options.gusts
        self._time = options.gust_time
        self._rng = rng
        self._gust: Array = options.gusts * rng.standard_normal(2) if options.gusts else np.zeros(2)
        self.velocity = self._now()

    def step(self, duration: float) -> None:
        """Advance by `duration`, in s."""
        if not self._deviation:
            return
        keep = math.exp(-duration / self._time)
        spread = self._deviation * math.sqrt(1 - keep**2)
        self._gust = keep * self._gust + spread * self._rng.standard_normal(2)
        self.velocity = self._now()

    def _now(self) -> Array:
        return read_only(self._mean + np.append(self._gust, 0.0))
