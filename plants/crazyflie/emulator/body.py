"""The drone's body in the air and on the ground."""

import math

import numpy as np

from dcf_zenoh.plant import Array, read_only
from plants.crazyflie.emulator.setpoints import FirmwareSetpoint
from plants.crazyflie.model.cascade import POSITION_EVERY, TICK, Cascade
from plants.crazyflie.model.dynamics import STATES, roll_pitch_yaw
from plants.crazyflie.model.stepping import fly
from plants.crazyflie.model.vehicle import COMMAND_MAX, Vehicle

SLOT = POSITION_EVERY * TICK  # s
CALM = read_only(np.zeros(3))
NEAR = 0.1  # m above the ground, below which its fall is looked at in every tick


class Body:
    """Vehicle and cascade; it flies in slots of 10 ms, as often as the position loop runs.

    Args:
        vehicle: Its parameters.
        position: Where it stands, shape (2,), m.
        yaw: Its heading, rad.

    Attributes:
        tick: How many ms have passed.
        state: Shape (17,), see `model.dynamics`.
        push: Velocity, shape (2,), m/s, at which something carries it along while it is in the air; it is not part of
            the velocity that the drone measures.
        touchdown: Speed at which it came to the ground in the last slot, m/s; None if it did not.
    """

    def __init__(self, vehicle: Vehicle, position: Array, yaw: float) -> None:
        self._vehicle = vehicle
        self._cascade = Cascade.fresh()
        self.tick = 0
        self.state = np.zeros(STATES)
        self.push = np.zeros(2)
        self.touchdown: float | None = None
        self.place(position, yaw)

    @property
    def position(self) -> Array:
        """m, shape (3,)."""
        return self.state[:3]

    @property
    def velocity(self) -> Array:
        """m/s, shape (3,)."""
        return self.state[7:10]

    @property
    def rates(self) -> Array:
        """Turn rates, rad/s, body frame, shape (3,)."""
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
        """Whether a motor turns, or is told to."""
        return any(self.motors.tolist())

    @property
    def in_the_air(self) -> bool:
        """Whether it is above the ground."""
        return bool(self.state[2] > 0.0)

    def place(self, position: Array, yaw: float) -> None:
        """Put it on the ground, at `position`, shape (2,), m, with a heading, rad."""
        self.state[:] = 0.0
        self.state[:2] = position
        self.state[5], self.state[6] = math.sin(yaw / 2), math.cos(yaw / 2)

    def fly(self, setpoint: FirmwareSetpoint, estimate: Array) -> None:
        """One slot; `estimate` is what it believes of position and velocity, shape (6,)."""
        self.touchdown = None
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
            setpoint.mode,
            np.array(setpoint.values),
            estimate,
            CALM,
            self._vehicle,
        )
        self.tick += ticks
