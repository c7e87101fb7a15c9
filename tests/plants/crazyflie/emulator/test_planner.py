"""The curves of the planner, against what they have to satisfy, and its answers to commands."""

import errno
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.planner import (
    GO_TO,
    GROUP_MASK,
    LAND,
    STOP_PLAN,
    TAKE_OFF,
    Phase,
    Planner,
    curve,
    line,
)
from plants.crazyflie.emulator.setpoints import STOP
from plants.crazyflie.emulator.trajectories import REST

four = st.lists(st.floats(-3, 3), min_size=4, max_size=4).map(np.array)


def planner(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Planner:
    """One that may plan, for a drone that stands there."""
    made = Planner()
    made.block(False)
    made.set_state(np.array([x, y, z]), np.zeros(3), yaw)
    return made


def take_off(height: float, duration: float, *, yaw: float | None = None, groups: int = 0) -> bytes:
    return struct.pack("<BBff?f", TAKE_OFF, groups, height, yaw or 0.0, yaw is None, duration)


def land(height: float, duration: float) -> bytes:
    return struct.pack("<BBff?f", LAND, 0, height, 0.0, True, duration)


def go_to(x: float, y: float, z: float, yaw: float, duration: float, *, relative: bool = False) -> bytes:
    return struct.pack("<BB??5f", GO_TO, 0, relative, False, x, y, z, yaw, duration)


@given(four, four, four, four, st.floats(0.3, 10.0))
def test_curve_begins_as_it_should_and_ends_at_rest_without_jerk(
    place: Array, rate: Array, second: Array, end: Array, duration: float
) -> None:
    planned = curve(0, duration, (place, rate, second), end)
    powers = np.polynomial.Polynomial
    for axis in range(4):
        polynomial = powers(planned.coefficients[:, axis])
        derivatives = [polynomial, *(polynomial.deriv(n) for n in (1, 2, 3))]
        assert [d(0.0) for d in derivatives] == pytest.approx([place[axis], rate[axis], second[axis], 0], abs=1e-9)
        scale = max(1.0, 1 / duration**3) * 1e-5
        assert [d(duration) for d in derivatives] == pytest.approx([end[axis], 0, 0, 0], abs=scale)
        middle = round(duration * 500)
        for computed, wanted in zip(planned.at(middle), derivatives[:3], strict=True):
            assert computed[axis] == pytest.approx(wanted(middle * 1e-3), abs=1e-6 + scale)


def test_curve_from_rest_to_rest_is_the_known_one() -> None:
    planned = curve(100, 2.0, (np.zeros(4), REST, REST), np.array([1.0, 0.0, 0.0, 0.0]))
    for now in range(100, 2101, 100):
        s = (now - 100) / 2000
        assert planned.at(now)[0][0] == pytest.approx(35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)
    assert planned.over(2100)
    assert not planned.over(2099)


def test_line_has_constant_velocity() -> None:
    planned = line(0, 2.0, np.zeros(4), np.array([1.0, -2.0, 0.5, 0.2]))
    for now in (0, 700, 1999):
        np.testing.assert_allclose(planned.at(now)[1], [0.5, -1.0, 0.25, 0.1])


def test_take_off_rises_over_where_it_stands_and_stays() -> None:
    made = planner(1.0, -2.0)
    assert made.command(take_off(0.8, 2.0), 0) == 0
    assert made.phase is Phase.FLYING
    assert made.setpoint(1000).values == pytest.approx((1.0, -2.0, 0.4, 0.0))
    assert not made.finished(1999)
    for now in (2000, 9000):
        assert made.setpoint(now).values == pytest.approx((1.0, -2.0, 0.8, 0.0))
        assert made.finished(now)


def test_landing_ends_with_the_motors_off() -> None:
    made = planner()
    made.command(take_off(0.8, 1.0), 0)
    made.setpoint(1500)
    assert made.command(land(0.0, 2.0), 1500) == 0
    assert made.setpoint(2500).values == pytest.approx((0.0, 0.0, 0.4, 0.0))
    assert made.setpoint(3500) == STOP
    assert made.phase is Phase.IDLE


def test_turn_is_the_shorter_one() -> None:
    made = planner(yaw=math.radians(170))
    made.command(take_off(0.5, 1.0), 0)
    made.setpoint(1000)
    made.command(go_to(0.0, 0.0, 0.5, math.radians(-170), 1.0), 1000)
    assert made.setpoint(2000).values[3] == pytest.approx(math.radians(190), abs=1e-6)


def test_relative_goal_begins_at_the_last_setpoint_and_so_does_the_curve() -> None:
    made = planner(1.0)
    made.command(take_off(0.5, 1.0), 0)
    made.setpoint(1000)
    made.command(go_to(0.5, 0.5, 0.0, 0.0, 2.0, relative=True), 1000)
    on_its_way = made.setpoint(2000)
    made.command(go_to(0.0, 0.0, 0.5, 0.0, 2.0), 2000)
    assert made.setpoint(2000).values == pytest.approx(on_its_way.values)
    assert made.setpoint(2010).values[0] > on_its_way.values[0]  # it still moves on
    assert made.setpoint(4000).values == pytest.approx((0.0, 0.0, 0.5, 0.0))


def test_commands_are_refused_by_their_error_numbers() -> None:
    made = planner()
    made.block(True)
    assert made.command(take_off(0.5, 1.0), 0) == errno.EBUSY
    made.block(False)
    assert made.command(take_off(0.5, 1.0), 0) == 0
    assert made.command(take_off(0.5, 1.0), 0) == 1  # it flies already
    assert made.command(bytes((11, 0)), 0) == errno.ENOEXEC  # a spiral
    assert made.command(land(0.0, 1.0), 0) == 0
    assert made.command(land(0.0, 1.0), 0) == 1
    with pytest.raises(struct.error):
        made.command(bytes((LAND, 0, 1, 2)), 0)


def test_block_ends_the_plan() -> None:
    made = planner()
    made.command(take_off(0.5, 1.0), 0)
    made.block(True)
    assert made.setpoint(500) == STOP


def test_only_drones_of_the_group_obey() -> None:
    made = planner()
    assert made.command(bytes((GROUP_MASK, 0b10)), 0) == 0
    made.command(take_off(0.5, 1.0, groups=0b01), 0)
    assert made.setpoint(500) == STOP
    made.command(take_off(0.5, 1.0, groups=0b11), 500)
    made.command(bytes((STOP_PLAN, 0b01)), 500)
    assert made.setpoint(1000) != STOP
    made.command(bytes((STOP_PLAN, 0)), 1000)
    assert made.setpoint(1000) == STOP
