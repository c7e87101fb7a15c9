"""Body of the drone in the air and on the ground."""

import math

import numpy as np

from dcf_zenoh.plant import Array, read_only
from plants.crazyflie.emulator.setpoints import FirmwareSetpoint
from plants.crazyflie.model.cascade import POSITION_EVERY, TICK, Cascade, CascadeSetpoint
from plants.crazyflie.model.dynamics import STATES, roll_pitch_yaw, up
from plants.crazyflie.model.stepping import fly
from plants.crazyflie.model.vehicle import COMMAND_MAX, Vehicle

SLOT = POSITION_EVERY * TICK  # s
CALM = read_only(np.zeros(3))
NEAR = 0.1  # m above the ground, below which a touchdown is looked for in every tick


class Body:
    """Vehicle and cascade, simulated in slots of 10 ms, the period of the position loop.

    Args:
        vehicle: Parameters of the vehicle.
        position: Initial position on the ground, shape (2,), m.
        yaw: Initial heading, rad.

    Attributes:
        tick: Number of ms passed.
        state: State of the body, shape (17,), see `model.dynamics`.
        push: Velocity of a drift while the body is in the air, shape (2,), m/s; it is not part of the measured
            velocity.
        touchdown: Vertical speed of a touchdown in the last slot, m/s; None if there was none.
    """

    def __init__(self, vehicle: Vehicle, position: Array, yaw: float) -> None:
        self._vehicle = vehicle
        self._cascade = Cascade.fresh()
        self.tick = 0
        self.state = np.zeros(STATES)
        self.push = np.zeros(2)
        self._tilt_error = np.zeros(2)
        self.touchdown: float | None = None
        self.place(position, yaw)

    @property
    def position(self) -> Array:
        """Position, shape (3,), m."""
        return self.state[:3]

    @property
    def velocity(self) -> Array:
        """Velocity, shape (3,), m/s."""
        return self.state[7:10]

    @property
    def rates(self) -> Array:
        """Turn rates, body frame, shape (3,), rad/s."""
        return self.state[10:13]

    @property
    def angles(self) -> tuple[float, float, float]:
        """Roll, pitch (positive nose down), yaw, rad."""
        return roll_pitch_yaw(self.state)

    @property
    def motors(self) -> Array:
        """Commands to the four motors, 0 .. 65535."""
        return self._cascade.motors

    @property
    def load(self) -> float:
        """Mean motor command over its maximum."""
        total: float = sum(self.motors.tolist())
        return total / len(self.motors) / COMMAND_MAX

    @property
    def running(self) -> bool:
        """Whether a motor has a command above zero."""
        return any(self.motors.tolist())

    @property
    def in_the_air(self) -> bool:
        """Whether the body is above the ground."""
        return bool(self.state[2] > 0.0)

    @property
    def up(self) -> Array:
        """Direction of the body's z axis in the world, shape (3,)."""
        return up(self.state)

    def place(self, position: Array, yaw: float) -> None:
        """Put the body on the ground, at `position`, shape (2,), m, with a heading, rad."""
        self.state[:] = 0.0
        self.state[:2] = position
        self.state[5], self.state[6] = math.sin(yaw / 2), math.cos(yaw / 2)

    def fly(self, setpoint: FirmwareSetpoint, estimate: Array, tilt_error: Array) -> None:
        """Simulate one slot.

        Args:
            setpoint: Setpoint to follow.
            estimate: Estimated position and velocity, shape (6,), m and m/s.
            tilt_error: Error of the estimated tilt, shape (2,), rad; see `AttitudeEstimate`.
        """
        self.touchdown = None
        self._tilt_error = tilt_error
        if not 0.0 < self.state[2] < NEAR + abs(self.state[9]) * SLOT:
            self._fly(setpoint, estimate, POSITION_EVERY)
        else:
            for _ in range(POSITION_EVERY):
                above, sinking = self.in_the_air, -float(self.state[9])
                self._fly(setpoint, estimate, 1)
                if above and not self.in_the_air:
                    self.touchdown = max(0.0, sinking)
        if self.in_the_air:
            self.state[:2] += self.push * SLOT

    def _fly(self, setpoint: FirmwareSetpoint, estimate: Array, ticks: int) -> None:
        self.state = fly(
            self.state,
            self._cascade,
            self.tick,
            ticks,
            CascadeSetpoint(setpoint.mode, np.array(setpoint.values)),
            estimate,
            self._tilt_error,
            CALM,
            self._vehicle,
        )
        self.tick += ticks
