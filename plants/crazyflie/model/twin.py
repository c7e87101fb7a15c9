"""A simulated Crazyflie with everything around it: body, controller, sensing, wind. It does as it is commanded."""

import math

import numpy as np

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Array
from plants.crazyflie.model.cascade import HOVER, POSITION, POSITION_EVERY, STOPPED, TICK, VELOCITY, Cascade
from plants.crazyflie.model.dynamics import STATES, roll_pitch_yaw
from plants.crazyflie.model.stepping import fly
from plants.crazyflie.model.vehicle import Vehicle
from plants.sensing import Estimator, Sensor
from plants.wind import Wind

SLOT = POSITION_EVERY * TICK  # s; sensing and wind are stepped as often as the position loop
COMMAND = 100  # ticks between commands to keep to a point, as it does to take off, land and hold
APPROACH, APPROACH_MAX = 1.0, 0.5  # 1/s and m/s: horizontal velocity towards that point for each m, and at most
STOPPING = 0.4  # s; how long the velocity of before carries on until it has stopped
CLIMB, SINK = 0.4, 0.3  # m/s
QUIET, STILL = 0.01, 0.01  # m and m/s: what counts as hovering
SETTLED = 1.0  # s of it end the take-off
PATIENCE = 20.0  # s; then it ends anyhow, as it does in gusts or with noise
REACHED = 0.2  # m; further off, the take-off has failed
NEAR_GROUND = 0.03  # m; motors off


class Twin:
    """One Crazyflie in model time, which counts in ticks of 1 ms.

    Args:
        vehicle: Its parameters.
        position: Where it stands, or hovers, shape (3,), in m.
        velocity: Its velocity, shape (3,), in m/s. None: it stands on the ground, motors off.
        sensor: What measures its position; None: it knows position and velocity exactly.
        wind: The air around it.
        rng: Draws the errors of sensing.

    Attributes:
        state: Of the body, shape (17,), see `dynamics`.
        tick: How many have passed.
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
        self._mode, self._setpoint = STOPPED, np.zeros(4)
        self._point: tuple[float, float, float] | None = None  # to keep to
        if velocity is not None:
            self.state[7:10] = velocity
            self.state[13:] = vehicle.hover_speed
            self._cascade = Cascade.hovering(vehicle.hover_command, 0.0)
            self.hover((0.0, 0.0), float(position[2]))
        self._estimator = Estimator(sensor, self.state[:3], self.state[7:10], rng) if sensor else None
        self._estimate = self._estimator.estimate.copy() if self._estimator else self._truth()

    @property
    def estimate(self) -> Array:
        """Position and velocity as the vehicle knows them, shape (6,), in m and m/s."""
        if self._estimator is None:
            return self._truth()
        passed = self.tick % POSITION_EVERY * TICK  # since the estimator's last step
        position, velocity = self._estimate[:3], self._estimate[3:]
        return np.concatenate((position + velocity * passed, velocity))

    @property
    def height(self) -> float:
        """As the vehicle knows it, in m."""
        return float(self.estimate[2])

    def command(self, mode: int, setpoint: tuple[float, float, float, float]) -> None:
        """Follow a setpoint from the next tick on; see the modes of `cascade`."""
        self._mode, self._setpoint, self._point = mode, np.array(setpoint), None

    def hover(self, velocity: tuple[float, float], height: float) -> None:
        """Follow a horizontal `velocity`, in m/s, world frame, at a `height`, in m; keep the heading."""
        yaw = roll_pitch_yaw(self.state)[2]
        cosine, sine = math.cos(yaw), math.sin(yaw)
        ahead, left = cosine * velocity[0] + sine * velocity[1], cosine * velocity[1] - sine * velocity[0]
        self.command(HOVER, (ahead, left, height, 0.0))

    def hold(self, height: float) -> tuple[float, float]:
        """Brake, and keep to the point where it can stop, which is returned, at a `height`, in m."""
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
        """Let `ticks` pass under the last command."""
        end = self.tick + ticks
        while self.tick < end:
            into = self.tick % POSITION_EVERY
            if into == 0:
                self._look_around()
            if self._point and self.tick % COMMAND == 0:
                self._keep_to(*self._point)
            count = min(POSITION_EVERY - into, end - self.tick)
            self.state = fly(
                self.state,
                self._cascade,
                self.tick,
                count,
                self._mode,
                self._setpoint,
                self._estimate,
                self._wind.velocity,
                self._vehicle,
            )
            self.tick += count

    def take_off(self, height: float) -> None:
        """Climb from the ground, straight up, and settle at `height`, in m.

        Raises:
            PlantError: It is elsewhere in the end, as in too strong a wind.
        """
        x, y, wanted, quiet = float(self.state[0]), float(self.state[1]), 0.0, 0.0
        goal = np.array([x, y, height, 0.0, 0.0, 0.0])
        give_up = self.tick + (height / CLIMB + PATIENCE) / TICK
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
        """Come to rest, sink straight down, and stop the motors on the ground."""
        wanted = self.height
        x, y = self.hold(wanted)
        while wanted > -1.0 and self.state[2] > NEAR_GROUND:
            wanted -= SINK * COMMAND * TICK
            self._keep_to(x, y, wanted)
            self.run(COMMAND)
        self.stop()
        self.run(round(0.5 / TICK))

    def _keep_to(self, x: float, y: float, height: float) -> None:
        """Hover towards a point: one command by velocity, renewed every `COMMAND` ticks."""
        away = APPROACH * (np.array([x, y]) - self.estimate[:2])
        east, north = (float(value) for value in np.clip(away, -APPROACH_MAX, APPROACH_MAX))
        self.hover((east, north), height)
        self._point = x, y, height

    def _look_around(self) -> None:
        self._wind.step(SLOT)
        if self._estimator is None:
            self._estimate = self._truth()
        else:
            self._estimator.step(self.state[:3], self.state[7:10], SLOT)
            self._estimate = self._estimator.estimate.copy()

    def _truth(self) -> Array:
        return np.concatenate((self.state[:3], self.state[7:10]))
