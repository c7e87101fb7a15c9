"""Estimated position and velocity of a body: a positioning system and an estimator."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array


class Sensor(NamedTuple):
    """Errors and timing of a positioning system.

    Attributes:
        noise: Standard deviation of a measurement on each axis, m; independent between measurements.
        bias: Standard deviation on each axis of an error that is constant over a run, m.
        shortest: Least time between measurements, s.
        longest: Greatest time between measurements, s; the times are uniformly distributed.
        latency: Delay from a measurement to its use by the estimator, s.
        dropouts: Mean number of interruptions per second.
        dropout_length: Duration of an interruption, s.
        accelerometer: Standard deviation of the measured acceleration, m/s², by which the estimate is propagated
            between measurements.
    """

    noise: float
    bias: float
    shortest: float
    longest: float
    latency: float
    dropouts: float
    dropout_length: float
    accelerometer: float


# Crazyflie with Lighthouse: 30 .. 50 Hz, jitter of mm, errors of 1 to 4 cm, as users report;
# interruptions and accelerometer noise are our assumption.
LIGHTHOUSE = Sensor(
    noise=0.002,
    bias=0.012,
    shortest=1 / 50,
    longest=1 / 30,
    latency=0.01,
    dropouts=0.05,
    dropout_length=0.3,
    accelerometer=0.3,
)


class Estimator:
    """Estimator of position and velocity of one body.

    Between measurements the estimate follows the accelerometer. A measurement corrects it by constant gains, those of
    the stationary Kalman filter for white acceleration noise; it is compared with the estimate at the instant of the
    measurement. The gains stay the same after an interruption: the estimate converges within a few measurements.

    Args:
        sensor: Positioning system.
        position: Initial position, known up to the sensor's bias, shape (3,), in m.
        velocity: Initial velocity, known exactly, shape (3,), in m/s.
        rng: Source of all errors.

    Attributes:
        estimate: Estimated position and velocity, shape (6,), in m and m/s, world frame.

    Source of the gains: P. R. Kalata, "The Tracking Index: A Generalized Parameter for α-β and α-β-γ Target
    Trackers", IEEE Trans. Aerospace and Electronic Systems 20(2), 1984.
    """

    def __init__(self, sensor: Sensor, position: Array, velocity: Array, rng: np.random.Generator) -> None:
        self._sensor = sensor
        self._rng = rng
        self._bias = sensor.bias * rng.standard_normal(3)
        self._alpha, self._beta = gains(sensor)
        self.estimate = np.concatenate((position + self._bias, velocity))
        self._last_velocity = np.array(velocity)
        self._delayed: deque[tuple[float, Array]] = deque()  # due, measurement minus estimate
        self._now = 0.0
        self._next = 0.0
        self._dropout_end = 0.0  # end of the last interruption

    def step(self, position: Array, velocity: Array, duration: float, *, measured: bool = True) -> None:
        """Advance by `duration`.

        Args:
            position: True position at the end, shape (3,), in m.
            velocity: True velocity at the end, shape (3,), in m/s.
            duration: Duration of the step, in s.
            measured: The positioning system sees the body; otherwise only the accelerometer is used.
        """
        sensor, rng = self._sensor, self._rng
        self._now += duration
        acceleration = (velocity - self._last_velocity) / duration + sensor.accelerometer * rng.standard_normal(3)
        self._last_velocity = np.array(velocity)
        self.estimate[:3] += (self.estimate[3:] + acceleration * (duration / 2)) * duration
        self.estimate[3:] += acceleration * duration
        if rng.random() < sensor.dropouts * duration:
            self._dropout_end = self._now + sensor.dropout_length
        if self._now >= self._next:
            self._next = self._now + rng.uniform(sensor.shortest, sensor.longest)
            measurement = position + self._bias + sensor.noise * rng.standard_normal(3)
            if measured and self._now >= self._dropout_end:
                self._delayed.append((self._now + sensor.latency, measurement - self.estimate[:3]))
        while self._delayed and self._delayed[0][0] <= self._now:
            _, error = self._delayed.popleft()
            self.estimate[:3] += self._alpha * error
            self.estimate[3:] += self._beta / ((sensor.shortest + sensor.longest) / 2) * error


def gains(sensor: Sensor) -> tuple[float, float]:
    """Return α and β of the stationary filter at the mean period of `sensor` (Kalata 1984).

    The tracking index Λ = σ_a T² / σ_m is the ratio of the uncertainty of the motion within one period to the noise of
    a measurement.
    """
    period = (sensor.shortest + sensor.longest) / 2
    index = sensor.accelerometer * period**2 / sensor.noise
    root = (4 + index - math.sqrt(8 * index + index**2)) / 4
    alpha = 1 - root**2
    return alpha, 2 * (2 - alpha) - 4 * math.sqrt(1 - alpha)
