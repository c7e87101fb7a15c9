"""Motion of a body to a place, where it comes to rest."""

from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, Setpoint


class Approach(NamedTuple):
    """Critically damped approach a = pace² (place - p) - 2 pace v, which does not overshoot unless the bound is active.

    Attributes:
        sample_time: Time for which an acceleration is held, s.
        pace: Natural frequency, rad/s; a body arrives after about 6 / pace seconds.
        accel_max: Bound on each component, m/s².
    """

    sample_time: float
    pace: float
    accel_max: float

    @classmethod
    def of(cls, sample_time: float, pace: float, accel_max: float) -> "Approach":
        """Check the arguments and make an approach of them.

        Raises:
            ValueError: A number is not positive, or the pace so high that the sampled motion would be unstable.
        """
        if not 0 < pace * sample_time < 1:
            raise ValueError(f"pace must be positive and less than 1 / sample_time, {1 / sample_time:g}, not {pace}")
        if not accel_max > 0:
            raise ValueError(f"accel_max must be positive, in m/s², not {accel_max}")
        return cls(sample_time, pace, accel_max)

    def setpoint(self, position: Array, velocity: Array, place: Array, stage: int) -> Setpoint:
        """Return the acceleration of `stage` samples ahead, and the predicted position and velocity at its end.

        Args:
            position: Present position, shape (d,), m.
            velocity: Present velocity, shape (d,), m/s.
            place: Destination, shape (d,), m.
            stage: 0 for the present sample.
        """
        held, acceleration = self.sample_time, np.zeros_like(position)
        for _ in range(stage + 1):
            wanted = self.pace**2 * (place - position) - 2 * self.pace * velocity
            acceleration = np.minimum(np.maximum(wanted, -self.accel_max), self.accel_max)
            position = position + velocity * held + acceleration * (held**2 / 2)
            velocity = velocity + acceleration * held
        return Setpoint(position, velocity, acceleration)
