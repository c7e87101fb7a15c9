"""What the drone believes of its own position and velocity, and how sure it is."""

import math

import numpy as np

from dcf_zenoh.plant import Array
from plants.sensing import Estimator, Sensor

# What follows is our assumption; a Crazyflie takes one to two seconds from a reset to a position it can fly by.
START, FLOOR, SETTLING = 100.0, 1e-5, 0.15  # m², m²; s in which variance and error fall to 1/e
GROWTH = 0.05  # m²/s of variance while nothing measures
OUTSIDE_GAIN, OUTSIDE_RATE, OUTSIDE_FOR = 0.3, 1.5, 0.3  # weight of a position from outside; 1/s; s that it counts


class Belief:
    """Estimate and variance.

    After a reset the drone believes to be at the origin and finds its place by measurements. While nothing measures,
    the estimate follows the accelerometer and the variance grows.

    Args:
        sensor: What measures its position; None: it knows position and velocity exactly.
        position: Where it stands, shape (3,), m.
        rng: Draws the errors.

    Attributes:
        estimate: Position and velocity, shape (6,), m and m/s.
        variance: Of the position, m², the same on each axis.
        fixed_variance: What it tells of its variance instead of the truth; None: the truth.
        frozen: The estimate does not change any more.
    """

    def __init__(self, sensor: Sensor | None, position: Array, rng: np.random.Generator) -> None:
        self._estimator = Estimator(sensor, position, np.zeros(3), rng) if sensor else None
        self._error = np.zeros(3)
        self._outside = 0.0
        self._variance = START
        self.estimate = np.concatenate((position, np.zeros(3)))
        self.fixed_variance: float | None = None
        self.frozen = False
        self.reset()

    @property
    def variance(self) -> float:
        """Of the position, m², the same on each axis."""
        return self._variance if self.fixed_variance is None else self.fixed_variance

    def reset(self) -> None:
        """Forget where it is."""
        self._variance = START
        self._error = -self.estimate[:3]

    def told(self, position: Array) -> None:
        """A position from outside, shape (3,), m."""
        self._outside = OUTSIDE_FOR
        if self._estimator is not None:
            error = position - self._estimator.estimate[:3]
            self._estimator.estimate[:3] += OUTSIDE_GAIN * error
            self._estimator.estimate[3:] += OUTSIDE_RATE * error

    def step(self, position: Array, velocity: Array, duration: float, *, measured: bool) -> None:
        """Take in that `duration`, s, has passed and the drone is at `position` and moves with `velocity`.

        Args:
            position: Shape (3,), m.
            velocity: Shape (3,), m/s.
            duration: s.
            measured: The drone's own sensors see where it is.
        """
        self._outside -= duration
        if measured or self._outside > 0:
            keep = math.exp(-duration / SETTLING)
            self._variance = FLOOR + (self._variance - FLOOR) * keep
            self._error = self._error * keep
        else:
            self._variance += GROWTH * duration
        if self._estimator is not None:
            self._estimator.step(position, velocity, duration, measured=measured)
        if not self.frozen:
            known = np.concatenate((position, velocity)) if self._estimator is None else self._estimator.estimate.copy()
            known[:3] += self._error
            self.estimate = known
