"""A boat: thrust in every direction, and water that slows it down."""
import numpy as np

from dcf_zenoh.plant import Plant, State, read_only


class Boat(Plant):
    """Point mass with linear drag, integrated exactly: dv/dt = input - v / time_constant.

    The input saturates, so no component of the speed exceeds accel_max * time_constant. To come to rest, the boat stops
    its engine and drifts until the drag has stopped it.

    Args:
        start: Start position, shape (d,), m; from [agents.ID] of the fleet file.
        time_constant: Time in which the drag reduces the speed to 1/e, s.
        accel_max: Bound on each component of the input, m/s².
    """

    def __init__(self, start, *, time_constant: float = 2.0, accel_max: float = 2.0):
        if not (time_constant > 0 and accel_max > 0):
            raise ValueError(f"time_constant and accel_max must be positive, not {time_constant} and {accel_max}")
        self.time_constant, self.accel_max = time_constant, accel_max
        self.position = np.array(start, dtype=float)
        self.velocity = np.zeros_like(self.position)
        self.input = np.zeros_like(self.position)
        self.now = 0

    def sense(self, now):
        """Exact state at `now`, ns."""
        T, t = self.time_constant, (now - self.now) * 1e-9
        limit, left = self.input * T, np.exp(-t / T)  # final velocity; factor of the deviation from it
        self.position = self.position + limit * t + (self.velocity - limit) * T * (1 - left)
        self.velocity = limit + (self.velocity - limit) * left
        self.now = now
        return State(read_only(self.position), read_only(self.velocity))

    def act(self, setpoint, now):
        """Accelerate as the setpoint asks, and compensate the present drag; without an acceleration: drift."""
        state = self.sense(now)
        if setpoint.acceleration is None:
            self.input = np.zeros_like(self.position)
        else:
            wanted = setpoint.acceleration + state.velocity / self.time_constant
            self.input = wanted.clip(-self.accel_max, self.accel_max)
