"""The cascade against flights of the firmware's own, and its limits and resets."""

from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh.plant import Array
from plants.crazyflie.model.cascade import (
    GAINS,
    HOVER,
    POSITION,
    STOPPED,
    TILT_CLIMB,
    TILT_HEIGHT,
    TILT_THRUST,
    VELOCITY,
    VZ,
    YAW,
    Cascade,
    CascadeSetpoint,
    update,
)
from plants.crazyflie.model.dynamics import STATES
from plants.crazyflie.model.stepping import fly
from plants.crazyflie.model.vehicle import RPM, Vehicle, read

DATA = Path(__file__).parents[3] / "data" / "crazyflie"
CALM = np.zeros(3)


class Flight:
    """A vehicle in the air at 1 m that knows its state exactly."""

    def __init__(self, vehicle: Vehicle, cascade: Cascade, tick: int = 0) -> None:
        self.vehicle, self.cascade, self.tick = vehicle, cascade, tick
        self.state = np.zeros(STATES)
        self.state[2] = self.state[6] = 1.0
        self.state[13:] = vehicle.hover_speed

    def until(self, tick: int, mode: int, *setpoint: float) -> Array:
        """Fly through all ticks before `tick`."""
        while self.tick < tick:
            count = min(10 - self.tick % 10, tick - self.tick)
            known = np.concatenate((self.state[:3], self.state[7:10]))
            command = CascadeSetpoint(mode, np.array(setpoint))
            self.state = fly(
                self.state, self.cascade, self.tick, count, command, known, np.zeros(2), CALM, self.vehicle
            )
            self.tick += count
        return self.state


def hovering() -> Flight:
    vehicle = read("cf2x_p250")
    return Flight(vehicle, Cascade.hovering(vehicle.hover_command, 0.0))


def tick_once(cascade: Cascade, mode: int, setpoint: list[float], *, rates: list[float] | None = None) -> Array:
    """Motor commands of one tick in which all loops are due, level and at rest at the origin."""
    turning = np.zeros(3) if rates is None else np.array(rates)
    update(cascade, 0, CascadeSetpoint(mode, np.array(setpoint)), np.zeros(3), np.zeros(3), (0.0, 0.0, 0.0), turning)
    return cascade.motors


@pytest.mark.parametrize("name", sorted(path.stem for path in DATA.glob("c2_*.npz")))
def test_cascade_flies_like_the_firmware(name: str) -> None:
    data = np.load(DATA / f"{name}.npz")
    lag = data["par_rotor_dyn_coef"]
    vehicle = read("cf2x_p250")._replace(faster=(lag[0], lag[1] / RPM), slower=(lag[2], lag[3] / RPM))
    flight = Flight(vehicle, Cascade.fresh(), tick=1)  # the firmware counts from 1
    flown, motors = [], []
    for k, (vx, vy, vz, height) in enumerate(data["ref"]):
        by_velocity = "world" in name and vx != 0
        state = flight.until(
            10 * (k + 1) + 1, VELOCITY if by_velocity else HOVER, vx, vy, vz if by_velocity else height, 0
        )
        flown.append(state[[0, 1, 2, 7, 8, 9]])
        motors.append(flight.cascade.motors.copy())
    error = np.array(flown) - np.hstack((data["position"], data["velocity"]))
    assert np.sqrt(np.mean(error[:, 3:] ** 2, axis=0)).max() < 0.02 / 1000  # m/s; the issue asks for 0.02
    assert abs(error[:, 2]).max() < 0.01 / 1000  # m
    assert np.mean(abs(np.array(motors) - data["motor16"])) < 2  # of 65535; the firmware is in single precision
    step, speed = data["t"] >= 4.0, data["ref"][-1, 0]
    rise = [data["t"][step][np.argmax(v[step] > 0.63 * speed)] for v in (np.array(flown)[:, 3], data["velocity"][:, 0])]
    assert rise[0] - 4.0 == pytest.approx(rise[1] - 4.0, rel=0.1)


def test_position_setpoint_is_reached_at_no_more_than_the_speed_limit() -> None:
    flight, speeds = hovering(), []
    for tick in range(100, 12001, 100):
        state = flight.until(tick, POSITION, 2.0, -1.0, 1.5, 0.0)
        speeds.append(abs(state[7:9]).max())
    np.testing.assert_allclose(state[:3], [2.0, -1.0, 1.5], atol=0.02)
    assert 1.0 < max(speeds) < 1.25  # 1.1 m/s wanted at most


def test_hover_setpoint_is_along_the_heading() -> None:
    flight = hovering()
    flight.state[5] = flight.state[6] = np.sqrt(0.5)  # it looks along +y
    flight.cascade.attitude[2] = flight.cascade.measured[YAW] = 90.0
    state = flight.until(3000, HOVER, 0.5, 0.0, 1.0, 0.0)
    assert state[8] == pytest.approx(0.5, abs=0.1)
    assert abs(state[7]) < 0.02


def test_yaw_rate_is_followed_through_the_half_turn() -> None:
    flight = hovering()
    state = flight.until(4000, HOVER, 0.0, 0.0, 1.0, 1.0)
    yaw = 2 * np.arctan2(state[5], state[6]) % (2 * np.pi)
    assert yaw == pytest.approx(4.0, abs=0.3)
    assert np.linalg.norm(state[:2]) < 0.05


def test_a_new_kind_of_setpoint_lets_it_sag() -> None:
    kept, changed = hovering(), hovering()
    kept.until(1000, HOVER, 0.0, 0.0, 1.0, 0.0)
    changed.until(1000, VELOCITY, 0.0, 0.0, 0.0, 0.0)
    assert kept.state[2] == pytest.approx(1.0, abs=0.01)
    assert 0.05 < 1.0 - changed.state[2] < 0.4  # its vertical integrator is gone


def test_stopped_motors_forget_everything() -> None:
    cascade = Cascade.hovering(42000.0, 0.3)
    assert tick_once(cascade, STOPPED, [0, 0, 0, 0]).tolist() == [0, 0, 0, 0]
    assert not cascade.integral.any()


def test_saturation_lowers_all_motors_alike() -> None:
    free, full = Cascade.fresh(), Cascade.hovering(42000.0, 0.0)
    full.integral[VZ] = 100.0
    motors = tick_once(full, HOVER, [0, 0, 50.0, 0], rates=[-0.5, 0.2, 0.1]).copy()
    assert motors.max() == 65535
    assert 65535 - motors.min() > 10000  # the differences that turn it are kept
    reference = tick_once(free, HOVER, [0, 0, 0, 0], rates=[-0.5, 0.2, 0.1])
    np.testing.assert_allclose(np.diff(motors), np.diff(reference), atol=2)


@pytest.mark.parametrize(("rates", "raised"), [([-0.2, 0, 0], [2, 3]), ([0, -0.2, 0], [1, 2]), ([0, 0, -0.2], [1, 3])])
def test_mixer_turns_against_a_rotation(rates: list[float], raised: list[int]) -> None:
    motors = tick_once(Cascade.fresh(), HOVER, [0, 0, 0, 0], rates=rates)
    assert np.flatnonzero(motors > np.mean(motors)).tolist() == raised


def test_output_of_the_vertical_loop_is_limited() -> None:
    cascade = Cascade.fresh()
    tick_once(cascade, VELOCITY, [0, 0, -10.0, 0])
    assert cascade.thrust[0] == 20000  # the least thrust in flight
    tick_once(cascade, VELOCITY, [0, 0, 10.0, 0])
    assert cascade.thrust[0] == pytest.approx(65535, abs=40)
    assert GAINS.shape == (12, 5)


@pytest.mark.parametrize("mode", [TILT_HEIGHT, TILT_CLIMB])
def test_tilt_accelerates_by_gravity_times_its_tangent(mode: int) -> None:
    flight = hovering()
    tilt, third = np.radians(5.0), 1.0 if mode == TILT_HEIGHT else 0.0
    flight.until(3000, mode, 0.0, 0.0, third, 0.0)  # it settles from the change of mode
    flight.until(3500, mode, 0.0, tilt, third, 0.0)
    before = flight.state.copy()
    after = flight.until(3600, mode, 0.0, tilt, third, 0.0)
    drag = flight.vehicle.drag[0] / flight.vehicle.mass * before[7]
    assert (after[7] - before[7]) / 0.1 == pytest.approx(9.81 * np.tan(tilt) - drag, rel=0.1)
    assert abs(after[8]) < 0.01
    assert abs(after[9]) < 0.05


def test_thrust_goes_straight_to_the_motors() -> None:
    cascade = Cascade.fresh()
    tick_once(cascade, TILT_THRUST, [0.0, 0.0, 30000.0, 0.0])
    np.testing.assert_array_equal(cascade.motors, 30000.0)
