"""The body of the Crazyflie against reference trajectories, closed forms and conservation laws."""

from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh.plant import Array
from plants.crazyflie.model.dynamics import derivative, on_ground, rk4, roll_pitch_yaw, speed_for, thrust
from plants.crazyflie.model.vehicle import RPM, Vehicle, known, read

DATA = Path(__file__).parents[3] / "data" / "crazyflie"
OPEN_LOOP = sorted(path.stem for path in DATA.glob("[ab]*.npz"))
CALM = np.zeros(3)
STEP = 1e-3  # s


def resting(vehicle: Vehicle, *, speed: float | None = None) -> Array:
    """In the air at the origin, level, at rest, the rotors at `speed`, rad/s, or carrying the weight."""
    state = np.zeros(17)
    state[6] = 1.0
    state[13:] = vehicle.hover_speed if speed is None else speed
    return state


def bare(*, gravity: float = 9.81) -> Vehicle:
    """A rigid body without drag whose rotors neither push nor store momentum; inertia as identified."""
    return read("forster2015")._replace(
        gravity=gravity,
        thrust=(0.0, 0.0, 1e-12),
        torque=(0.0, 0.0, 0.0),
        drag_per_speed=(0.0, 0.0, 0.0),
        thrust_lag=0.0,
    )


def rotation(state: Array) -> Array:
    """Matrix that turns body vectors into world vectors."""
    x, y, z, w = state[3:7]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix: Array = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    return matrix


@pytest.mark.parametrize("name", OPEN_LOOP)
def test_open_loop_follows_the_reference(name: str) -> None:
    data = np.load(DATA / f"{name}.npz")
    lag = data["par_rotor_dyn_coef"]
    vehicle = read("cf2x_p250")._replace(faster=(lag[0], lag[1] / RPM), slower=(lag[2], lag[3] / RPM))
    state = data["x"][0].copy()
    state[13:] *= RPM
    for sample, command in zip(data["x"][1:], data["cmd_rpm"][:-1], strict=True):
        for _ in range(10):
            state = rk4(state, command * RPM, CALM, vehicle, STEP)
        np.testing.assert_allclose(state[:3], sample[:3], atol=1e-5)
        np.testing.assert_allclose(state[3:7], sample[3:7], atol=1e-6)


def test_parameters_are_those_of_the_reference() -> None:
    data, vehicle = np.load(DATA / f"{OPEN_LOOP[0]}.npz"), read("cf2x_p250")
    assert vehicle.mass == data["par_mass"]
    assert vehicle.lever == data["par_L"]
    assert vehicle.rotor_inertia == data["par_prop_inertia"]
    np.testing.assert_array_equal(vehicle.inertia, data["par_J"])
    np.testing.assert_allclose(vehicle.thrust, data["par_rpm2thrust"] * RPM ** -np.arange(3.0))
    np.testing.assert_allclose(vehicle.drag, -np.diag(data["par_drag_matrix"]))


@pytest.mark.parametrize("name", known())
def test_hover_is_an_equilibrium(name: str) -> None:
    vehicle = read(name)
    level = resting(vehicle)
    targets = level[13:].copy()
    rate = derivative(level, targets, CALM, vehicle)
    np.testing.assert_allclose(rate, 0, atol=1e-9)


@pytest.mark.parametrize("name", known())
def test_command_curves_agree(name: str) -> None:
    vehicle = read(name)
    assert speed_for(vehicle.hover_command, vehicle) == pytest.approx(vehicle.hover_speed)
    for command in (20000.0, 40000.0, 65535.0):
        pushed = thrust(speed_for(command, vehicle), vehicle)
        assert pushed == pytest.approx(np.polyval(vehicle.command[::-1], command))


def test_forster_speed_is_linear_in_the_command() -> None:
    vehicle = read("forster2015")
    for command in (0.0, 30000.0, 65535.0):
        assert speed_for(command, vehicle) == pytest.approx(0.04076521 * command + 380.8359)


def test_forster_thrust_lags_with_its_identified_pole() -> None:
    vehicle = read("forster2015")
    state, targets = resting(vehicle), np.full(4, speed_for(50000.0, vehicle))
    first, final = thrust(state[13], vehicle), thrust(targets[0], vehicle)
    for _ in range(100):
        state = rk4(state, targets, CALM, vehicle, STEP)
    expected = final + (first - final) * 0.9695404 ** (100 / 2)
    assert thrust(state[13], vehicle) == pytest.approx(expected, rel=1e-5)


def test_torque_free_rotation_keeps_momentum_and_energy() -> None:
    vehicle = bare(gravity=0.0)
    state = resting(vehicle, speed=0.0)
    state[10:13] = 6.0, -4.0, 9.0
    inertia = vehicle.inertia
    momentum, energy = rotation(state) @ inertia @ state[10:13], state[10:13] @ inertia @ state[10:13]
    for _ in range(2000):
        state = rk4(state, np.zeros(4), CALM, vehicle, STEP)
    np.testing.assert_allclose(rotation(state) @ inertia @ state[10:13], momentum, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(state[10:13] @ inertia @ state[10:13], energy, rtol=1e-9)
    assert np.linalg.norm(state[3:7]) == pytest.approx(1, abs=1e-14)


def test_energy_is_conserved_without_drag_and_thrust() -> None:
    vehicle = bare()
    state = resting(vehicle, speed=0.0)
    state[7:10] = 1.0, -2.0, 8.0
    state[10:13] = 3.0, 1.0, -2.0

    def energy(at: Array) -> float:
        spin = at[10:13] @ vehicle.inertia @ at[10:13] / 2
        return float(vehicle.mass * (at[7:10] @ at[7:10] / 2 + vehicle.gravity * at[2]) + spin)

    before = energy(state)
    for _ in range(1000):
        state = rk4(state, np.zeros(4), CALM, vehicle, STEP)
    assert energy(state) == pytest.approx(before, rel=1e-9)
    np.testing.assert_allclose(state[:3], [1.0, -2.0, 8.0 - 9.81 / 2], atol=1e-9)


def test_rotors_that_change_speed_turn_the_body_and_the_sum_of_momenta_stays() -> None:
    vehicle = read("cf2x_p250")._replace(torque=(0.0, 0.0, 0.0), drag=(0.0, 0.0, 0.0))
    state = resting(vehicle)
    targets = state[13:] * [1.05, 0.95, 1.05, 0.95]
    turning = np.array([1.0, -1.0, 1.0, -1.0])  # counter-clockwise: 1 and 3

    def momentum(at: Array) -> float:
        return float(vehicle.inertia[2, 2] * at[12] + vehicle.rotor_inertia * turning @ at[13:])

    before = momentum(state)
    for _ in range(300):
        state = rk4(state, targets, CALM, vehicle, STEP)
    assert state[12] < -0.01
    assert momentum(state) == pytest.approx(before, abs=1e-12)


def test_turning_the_world_about_z_turns_the_motion() -> None:
    vehicle = read("forster2015")
    straight = resting(vehicle)
    straight[3:7] = np.array([0.1, -0.05, 0.0, 0.9]) / np.linalg.norm([0.1, -0.05, 0.0, 0.9])
    straight[7:10] = 1.0, 0.5, -0.2
    straight[10:13] = 0.4, 0.3, -0.5
    turned = straight.copy()
    x, y, z, w = straight[3:7]
    c, s = np.cos(0.6), np.sin(0.6)  # half the angle
    turned[3:7] = c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z
    about_z = np.array([[np.cos(1.2), -np.sin(1.2), 0], [np.sin(1.2), np.cos(1.2), 0], [0, 0, 1]])
    turned[7:10] = about_z @ straight[7:10]
    targets, wind = straight[13:] * [1.01, 0.99, 1.0, 1.02], np.array([0.5, -1.0, 0.1])
    for _ in range(300):
        straight = rk4(straight, targets, wind, vehicle, STEP)
        turned = rk4(turned, targets, about_z @ wind, vehicle, STEP)
    np.testing.assert_allclose(turned[:3], about_z @ straight[:3], atol=1e-12)
    np.testing.assert_allclose(turned[10:], straight[10:], atol=1e-9)
    assert roll_pitch_yaw(turned)[2] == pytest.approx(roll_pitch_yaw(straight)[2] + 1.2)


def test_body_that_moves_with_the_wind_feels_no_drag() -> None:
    vehicle, wind = read("cf2x_p250"), np.array([2.0, -1.0, 0.5])
    state = resting(vehicle)
    state[7:10] = wind
    np.testing.assert_allclose(derivative(state, state[13:].copy(), wind, vehicle)[7:10], 0, atol=1e-9)


def test_ground_stops_and_levels_but_lets_go_upwards() -> None:
    state = resting(read("forster2015"))
    state[2] = -0.001
    yaw = np.array([0.0, 0.0, np.sin(0.4), np.cos(0.4)])
    state[3:7] = np.array([0.2, 0.1, *yaw[2:]]) / np.linalg.norm([0.2, 0.1, *yaw[2:]])
    state[7:13] = 1.0, 2.0, 0.3, 4.0, 5.0, 6.0
    held = on_ground(state)
    np.testing.assert_allclose(held[:13], [0, 0, 0, *yaw, 0, 0, 0.3, 0, 0, 0])
    state[2] = 0.001
    np.testing.assert_array_equal(on_ground(state), state)


def test_bad_vehicles_are_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match=r"unknown parameters 'cf3'; known: cf2x_p250, forster2015"):
        read("cf3")
    for mass in (-1.0, 0.0, 0.2):
        with pytest.raises(ValueError, match=rf"mass must be positive and at most 0\.0592, in kg, .* not {mass}"):
            read("forster2015").carrying(mass)
