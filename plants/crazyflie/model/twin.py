"""Simulated Crazyflie: body, controller, sensing and wind, under commands."""

import math

import numpy as np

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Array
from plants.crazyflie.model.attitude_estimate import AttitudeEstimate
from plants.crazyflie.model.cascade import (
    HOVER,
    POSITION,
    POSITION_EVERY,
    STOPPED,
    TICK,
    VELOCITY,
    Cascade,
    CascadeSetpoint,
)
from plants.crazyflie.model.dynamics import STATES, roll_pitch_yaw, up
from plants.crazyflie.model.stepping import fly
from plants.crazyflie.model.vehicle import Vehicle
from plants.sensing import Estimator, Sensor
from plants.wind import Wind

SLOT = POSITION_EVERY * TICK  # s; sensing and wind are stepped as often as the position loop
COMMAND = 100  # ticks between velocity commands towards a point, in take-off, landing and hold
APPROACH, APPROACH_MAX = 1.0, 0.5  # 1/s and m/s: horizontal velocity towards that point per m, and its bound
STOPPING = 0.4  # s; the stopping distance is that of the present velocity in this time
CLIMB, DESCENT = 0.4, 0.3  # m/s
QUIET, STILL = 0.01, 0.01  # m and m/s within which the vehicle hovers
SETTLED = 1.0  # s of hovering after which the take-off ends
SETTLE_TIMEOUT = 20.0  # s after which the take-off ends in any case, as in gusts or with noise
REACHED = 0.2  # m from the goal up to which the take-off has succeeded
NEAR_GROUND = 0.03  # m below which the motors are switched off


class Twin:
    """One Crazyflie in model time, in ticks of 1 ms.

    Args:
        vehicle: Parameters of the vehicle.
        position: Initial position, on the ground or in hover, shape (3,), in m.
        velocity: Initial velocity, shape (3,), in m/s. None: on the ground, motors off.
        sensor: Positioning system; None: the estimate is exact.
        wind: Wind around the vehicle.
        rng: Source of the errors of sensing.

    Attributes:
        state: State of the body, shape (17,), see `dynamics`.
        tick: Number of ticks passed.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        position: Array,
        velocity: Array | None,
        *,
        sensor: Sensor | None,
        wind: Wind,
        rng: np.random.Generator,
    ) -> None:
        self._vehicle = vehicle
        self._wind = wind
        self.tick = 0
        self.state = np.zeros(STATES)
        self.state[:3] = position
        self.state[6] = 1.0
        self._cascade = Cascade.fresh()
        self._setpoint = CascadeSetpoint(STOPPED, np.zeros(4))
        self._point: tuple[float, float, float] | None = None  # point to hold
        if velocity is not None:
            self.state[7:10] = velocity
            self.state[13:] = vehicle.hover_speed
            self._cascade = Cascade.hovering(vehicle.hover_command, 0.0)
            self.hover((0.0, 0.0), float(position[2]))
        self._estimator = Estimator(sensor, self.state[:3], self.state[7:10], rng) if sensor else None
        self._estimate = self._estimator.estimate.copy() if self._estimator else self._truth()
        self._attitude = AttitudeEstimate(SLOT) if sensor else None
        self._tilt_error = np.zeros(2)

    @property
    def estimate(self) -> Array:
        """Estimated position and velocity, shape (6,), in m and m/s."""
        if self._estimator is None:
            return self._truth()
        passed = self.tick % POSITION_EVERY * TICK  # since the estimator's last step
        position, velocity = self._estimate[:3], self._estimate[3:]
        return np.concatenate((position + velocity * passed, velocity))

    @property
    def height(self) -> float:
        """Estimated height, in m."""
        return float(self.estimate[2])

    def command(self, mode: int, setpoint: tuple[float, float, float, float]) -> None:
        """Follow a setpoint from the next tick on; see the modes of `cascade`."""
        self._setpoint, self._point = CascadeSetpoint(mode, np.array(setpoint)), None

    def hover(self, velocity: tuple[float, float], height: float) -> None:
        """Follow a horizontal `velocity`, in m/s, world frame, at a `height`, in m; keep the heading."""
        yaw = roll_pitch_yaw(self.state)[2]
        cosine, sine = math.cos(yaw), math.sin(yaw)
        ahead, left = cosine * velocity[0] + sine * velocity[1], cosine * velocity[1] - sine * velocity[0]
        self.command(HOVER, (ahead, left, height, 0.0))

    def hold(self, height: float) -> tuple[float, float]:
        """Brake and hover at the stopping point, at a `height`, in m; return that point, in m."""
        if self._point is None:
            x, y = (float(value) for value in self.estimate[:2] + STOPPING * self.estimate[3:5])
            self._keep_to(x, y, height)
            return x, y
        return self._point[:2]

    def fly_at(self, velocity: tuple[float, float, float]) -> None:
        """Follow a `velocity` in space, in m/s, world frame; keep the heading."""
        self.command(VELOCITY, (*velocity, 0.0))

    def go_to(self, position: tuple[float, float, float]) -> None:
        """Fly to a `position`, in m; turn to heading 0."""
        self.command(POSITION, (*position, 0.0))

    def stop(self) -> None:
        """Motors off."""
        self.command(STOPPED, (0.0, 0.0, 0.0, 0.0))

    def run(self, ticks: int) -> None:
        """Simulate a number of ticks under the last command."""
        end = self.tick + ticks
        while self.tick < end:
            into = self.tick % POSITION_EVERY
            if into == 0:
                self._update_estimate()
            if self._point and self.tick % COMMAND == 0:
                self._keep_to(*self._point)
            count = min(POSITION_EVERY - into, end - self.tick)
            self.state = fly(
                self.state,
                self._cascade,
                self.tick,
                count,
                self._setpoint,
                self._estimate,
                self._tilt_error,
                self._wind.velocity,
                self._vehicle,
            )
            self.tick += count

    def take_off(self, height: float) -> None:
        """Climb straight up from the ground and settle at `height`, in m.

        Raises:
            PlantError: The vehicle ends elsewhere, as in too strong a wind.
        """
        x, y, wanted, quiet = float(self.state[0]), float(self.state[1]), 0.0, 0.0
        goal = np.array([x, y, height, 0.0, 0.0, 0.0])
        give_up = self.tick + (height / CLIMB + SETTLE_TIMEOUT) / TICK
        while quiet < SETTLED and self.tick < give_up:
            wanted = min(height, wanted + CLIMB * COMMAND * TICK)
            self._keep_to(x, y, wanted)
            self.run(COMMAND)
            away = abs(self.estimate - goal)
            quiet = quiet + COMMAND * TICK if away[:3].max() < QUIET and away[3:].max() < STILL else 0.0
        if not np.linalg.norm(self.state[:3] - goal[:3]) < REACHED:
            there = np.round(self.state[:3], 2).tolist()
            raise PlantError(f"take-off: expected to hover at {goal[:3].tolist()} m, came to {there} m")

    def land(self) -> None:
        """Come to rest, descend vertically, and stop the motors on the ground."""
        wanted = self.height
        x, y = self.hold(wanted)
        while wanted > -1.0 and self.state[2] > NEAR_GROUND:
            wanted -= DESCENT * COMMAND * TICK
            self._keep_to(x, y, wanted)
            self.run(COMMAND)
        self.stop()
        self.run(round(0.5 / TICK))

    def _keep_to(self, x: float, y: float, height: float) -> None:
        """Hover towards a point: a velocity command, renewed every `COMMAND` ticks."""
        away = APPROACH * (np.array([x, y]) - self.estimate[:2])
        east, north = (float(value) for value in np.clip(away, -APPROACH_MAX, APPROACH_MAX))
        self.hover((east, north), height)
        self._point = x, y, height

    def _update_estimate(self) -> None:
        self._wind.step(SLOT)
        if self._estimator is None:
            self._estimate = self._truth()
        else:
            self._estimator.step(self.state[:3], self.state[7:10], SLOT)
            self._estimate = self._estimator.estimate.copy()
        if self._attitude is not None:
            self._attitude.step(self.state[7:10], up(self.state))
            self._tilt_error = self._attitude.tilt

    def _truth(self) -> Array:
        return np.concatenate((self.state[:3], self.state[7:10]))
