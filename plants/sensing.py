"""What a body knows of its own position and velocity: a positioning system, and an estimator behind it."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array


class Sensor(NamedTuple):
    """A positioning system that measures the position of a body from time to time.

    Attributes:
        noise: Standard deviation of a measurement on each axis, m; independent from one to the next.
        bias: Standard deviation on each axis of an error that is constant over a run, m.
        shortest: Least time between measurements, s.
        longest: Greatest time between measurements, s; in between, all are equally likely.
        latency: From the measurement until the estimator has it, s.
        dropouts: Mean number of interruptions per second.
        dropout_length: How long each lasts, s.
        accelerometer: Standard deviation of the measured acceleration, m/s², which carries the estimate from
            measurement to measurement.
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
    """Position and velocity of one body, as it believes them to be.

    Between measurements the estimate follows the accelerometer. A measurement corrects it by constant gains, those of
    the stationary Kalman filter for white acceleration noise; what it says is compared with what was believed when it
    was taken. After an interruption the gains are the same: the estimate walks back in a few measurements.

    Args:
        sensor: What measures.
        position: Where the body stands, known at the start, shape (3,), in m.
        velocity: Its velocity, known at the start, shape (3,), in m/s.
        rng: Draws all errors.

    Attributes:
        estimate: Position and velocity, shape (6,), in m and m/s, world frame.

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
        self._under_way: deque[tuple[float, Array]] = deque()  # due, error of what was believed
        self._now = 0.0
        self._next = 0.0
        self._back = 0.0  # end of the interruption, if there is one

    def step(self, position: Array, velocity: Array, duration: float, *, measured: bool = True) -> None:
        """Take in that `duration`, in s, later the body is at `position` and moves with `velocity`.

        While it is not `measured`, the estimate follows the accelerometer alone.
        """
        sensor, rng = self._sensor, self._rng
        self._now += duration
        acceleration = (velocity - self._last_velocity) / duration + sensor.accelerometer * rng.standard_normal(3)
        self._last_velocity = np.array(velocity)
        self.estimate[:3] += (self.estimate[3:] + acceleration * (duration / 2)) * duration
        self.estimate[3:] += acceleration * duration
        if rng.random() < sensor.dropouts * duration:
            self._back = self._now + sensor.dropout_length
        if self._now >= self._next:
            self._next = self._now + rng.uniform(sensor.shortest, sensor.longest)
            seen = position + self._bias + sensor.noise * rng.standard_normal(3)
            if measured and self._now >= self._back:
                self._under_way.append((self._now + sensor.latency, seen - self.estimate[:3]))
        while self._under_way and self._under_way[0][0] <= self._now:
            _, error = self._under_way.popleft()
            self.estimate[:3] += self._alpha * error
            self.estimate[3:] += self._beta / ((sensor.shortest + sensor.longest) / 2) * error


def gains(sensor: Sensor) -> tuple[float, float]:
    """α and β of the stationary filter, at the mean period of `sensor` (Kalata 1984).

    The tracking index Λ = σ_a T² / σ_m compares what may have happened since the last measurement with the noise of
    the next.
    """
    period = (sensor.shortest + sensor.longest) / 2
    index = sensor.accelerometer * period**2 / sensor.noise
    root = (4 + index - math.sqrt(8 * index + index**2)) / 4
    alpha = 1 - root**2
    return alpha, 2 * (2 - alpha) - 4 * math.sqrt(1 - alpha)
