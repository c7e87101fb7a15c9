"""Error of the firmware's attitude estimate, where only positions are measured.

The firmware's Kalman filter integrates the turn rates, and predicts velocities from the attitude and the thrust alone:
it takes no lateral force for possible. So it explains the acceleration by rotor drag with a tilt that is not there,
until the positions agree, and drag pushes a body on that it should brake. The error is that of the filter of one
horizontal axis, in its stationary state; turn rates count as exact.

Source: M. W. Mueller, M. Hamer, R. D'Andrea, "Fusing ultra-wideband range measurements with accelerometers and rate
gyroscopes for quadrocopter state estimation", IEEE ICRA 2015, on which the firmware's filter is based; process noise:
the firmware's defaults (0.5 m/s², 0.1 rad/s).
"""

from functools import cache
from math import exp

import numpy as np

from dcf_zenoh.plant import Array

GRAVITY = 9.81  # m/s²
TICK = 1e-3  # s between predictions
ACCELERATION_NOISE, RATE_NOISE = 0.5, 0.1  # m/s² and rad/s, standard deviations per prediction
POSITION_NOISE = 0.01  # m, standard deviation of a position
MEASURED = 0.05  # s in which an error falls to 1/e where the attitude is measured
SETTLED = 2000  # measurements after which the covariance does not change any more


@cache
def gains(period: float) -> tuple[float, float, float]:
    """Return by how much a position error of 1 m corrects position, m, velocity, m/s, and tilt, rad.

    Args:
        period: Time between measurements of the position, s.
    """
    transition = np.eye(3) + TICK * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, GRAVITY], [0.0, 0.0, 0.0]])
    noise = np.diag([ACCELERATION_NOISE * TICK**2, ACCELERATION_NOISE * TICK, RATE_NOISE * TICK]) ** 2
    covariance = np.eye(3)
    gain = np.zeros(3)
    for _ in range(SETTLED):
        for _ in range(round(period / TICK)):
            covariance = transition @ covariance @ transition.T + noise
        gain = covariance[:, 0] / (covariance[0, 0] + POSITION_NOISE**2)
        covariance = covariance - np.outer(gain, covariance[0])
    position, velocity, tilt = gain.tolist()
    return position, velocity, tilt


class AttitudeEstimate:
    """Error of the estimated tilt of one body.

    Args:
        period: Time between steps, each with a measurement of the position, s.

    Attributes:
        tilt: Estimated minus true tilt along the world's x and y, shape (2,), rad: what accelerates along that axis.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._gains = gains(period)
        self._position, self._velocity = np.zeros(2), np.zeros(2)
        self.tilt = np.zeros(2)
        self._last_velocity: Array | None = None

    def measure(self) -> None:
        """Take in a measurement of the attitude in the present period: it leaves little of the error."""
        keep = exp(-self._period / MEASURED)
        self.tilt, self._velocity, self._position = self.tilt * keep, self._velocity * keep, self._position * keep

    def step(self, velocity: Array, up: Array, *, measured: bool = True) -> None:
        """Advance by a period.

        Args:
            velocity: True velocity at its end, shape (3,), m/s.
            up: Direction of the thrust at its end, shape (3,), a unit vector.
            measured: The position is measured.
        """
        last, self._last_velocity = self._last_velocity, np.array(velocity)
        if last is None:
            return
        force = (velocity - last) / self._period + np.array([0.0, 0.0, GRAVITY])  # per mass
        lateral = (force - up * float(up @ force))[:2]  # of which the filter knows nothing
        self._position = self._position + self._velocity * self._period
        self._velocity = self._velocity + (GRAVITY * self.tilt - lateral) * self._period
        if not measured:
            return
        position, velocity_gain, tilt = self._gains
        innovation = -self._position
        self._position = self._position + position * innovation
        self._velocity = self._velocity + velocity_gain * innovation
        self.tilt = self.tilt + tilt * innovation
