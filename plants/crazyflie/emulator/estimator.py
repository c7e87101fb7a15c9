"""State estimator of the drone: position, velocity, error of the attitude, and variance."""

import math

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.body import SLOT
from plants.crazyflie.model.attitude_estimate import AttitudeEstimate
from plants.sensing import Estimator, Sensor

# The numbers are our assumption; a real Crazyflie needs one to two seconds from a reset to a usable position.
VARIANCE_START, VARIANCE_MIN, SETTLING = 100.0, 1e-5, 0.15  # m², m²; s in which variance and error fall to 1/e
# m²/s³; without measurements the variance grows with the cube of the time: 0.001 m² in 1.2 s, 0.01 m² in 2.7 s, as
# measured on the firmware of 2026.08.
GROWTH = 5.3e-4
EXTERNAL_GAIN, EXTERNAL_RATE, EXTERNAL_FOR = 0.3, 1.5, 0.3  # weight of a position from outside; 1/s; s that it counts


class StateEstimator:
    """Estimate of position and velocity, and its variance.

    A reset sets the estimate to the origin; measurements then correct it. Without measurements the estimate follows the
    accelerometer and the variance grows.

    Args:
        sensor: Positioning system; None: position and velocity are exact.
        position: Initial position, shape (3,), m.
        rng: Source of the errors.

    Attributes:
        estimate: Estimated position and velocity, shape (6,), m and m/s.
        variance: Variance of the position, m², the same on each axis.
        fixed_variance: Variance to report instead of the computed one; None: the computed one.
        frozen: The estimate does not change any more.
    """

    def __init__(self, sensor: Sensor | None, position: Array, rng: np.random.Generator) -> None:
        self._estimator = Estimator(sensor, position, np.zeros(3), rng) if sensor else None
        self._attitude = AttitudeEstimate(SLOT) if sensor else None
        self._attitude_until = 0.0  # s for which a measured attitude still counts
        self._error = np.zeros(3)
        self._external_until = 0.0
        self._unmeasured = 0.0  # s without measurements
        self._variance = VARIANCE_START
        self.estimate = np.concatenate((position, np.zeros(3)))
        self.fixed_variance: float | None = None
        self.frozen = False
        self.reset()

    @property
    def variance(self) -> float:
        """Variance of the position, m², the same on each axis."""
        return self._variance if self.fixed_variance is None else self.fixed_variance

    @property
    def tilt_error(self) -> Array:
        """Error of the estimated tilt along the world's x and y, shape (2,), rad; see `AttitudeEstimate`."""
        return np.zeros(2) if self._attitude is None else self._attitude.tilt

    def reset(self) -> None:
        """Reset the estimate to the origin, with a large variance."""
        self._variance = VARIANCE_START
        self._error = -self.estimate[:3]

    def correct(self, position: Array, *, attitude: bool = False) -> None:
        """Correct the estimate by a position from an external system, shape (3,), m, perhaps with an attitude."""
        self._external_until = EXTERNAL_FOR
        self._attitude_until = EXTERNAL_FOR if attitude else self._attitude_until
        if self._estimator is not None:
            error = position - self._estimator.estimate[:3]
            self._estimator.estimate[:3] += EXTERNAL_GAIN * error
            self._estimator.estimate[3:] += EXTERNAL_RATE * error

    def step(self, position: Array, velocity: Array, up: Array, duration: float, *, measured: bool) -> None:
        """Advance by `duration`.

        Args:
            position: True position at the end, shape (3,), m.
            velocity: True velocity at the end, shape (3,), m/s.
            up: True direction of the body's z axis at the end, shape (3,).
            duration: Duration of the step, s.
            measured: The drone's own sensors measure its position.
        """
        self._external_until -= duration
        if measured or self._external_until > 0:
            keep = math.exp(-duration / SETTLING)
            self._variance = VARIANCE_MIN + (self._variance - VARIANCE_MIN) * keep
            self._error = self._error * keep
            self._unmeasured = 0.0
        else:
            before, self._unmeasured = self._unmeasured, self._unmeasured + duration
            self._variance += GROWTH * (self._unmeasured**3 - before**3)
        if self._attitude is not None:
            self._attitude.step(velocity, up, measured=measured or self._external_until > 0)
            self._attitude_until -= duration
            if self._attitude_until > 0:
                self._attitude.measure()
        if self._estimator is not None:
            self._estimator.step(position, velocity, duration, measured=measured)
        if not self.frozen:
            known = np.concatenate((position, velocity)) if self._estimator is None else self._estimator.estimate.copy()
            known[:3] += self._error
            self.estimate = known
