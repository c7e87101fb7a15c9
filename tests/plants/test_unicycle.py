from math import cos, pi, sin

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.testing import check_plant
from plants.unicycle import Pose, Unicycle

S = 1_000_000_000  # ns
L, RADIUS, BASE, FASTEST = 0.05, 0.016, 0.105, 12.5  # the defaults: look-ahead, wheels


def lead(x: float, y: float) -> Setpoint:
    return Setpoint(np.full(2, np.nan), np.array([x, y]), np.zeros(2))


def test_it_keeps_the_contract_of_plants() -> None:
    check_plant(lambda: Unicycle(np.array([1.0, 2.0])))
    check_plant(lambda: Unicycle(np.zeros(2), heading=2.0, look_ahead=0.02, control_period=0.1))


def test_a_straight_line_is_driven_exactly() -> None:
    body = Unicycle(np.array([1.0, 2.0]), heading=0.6)
    body.act(lead(0.1 * cos(0.6), 0.1 * sin(0.6)), 0)
    state = body.sense(10 * S)
    np.testing.assert_allclose(state.position, [1 + cos(0.6), 2 + sin(0.6)], atol=1e-12)
    np.testing.assert_allclose(state.velocity, [0.1 * cos(0.6), 0.1 * sin(0.6)], atol=1e-12)


def test_backwards_along_its_axis_it_does_not_turn() -> None:
    body = Unicycle(np.zeros(2))
    body.act(lead(-0.1, 0.0), 0)
    np.testing.assert_allclose(body.sense(2 * S).vector, [-0.2, 0, -0.1, 0], atol=1e-12)


def test_a_sideways_velocity_is_pure_rotation_at_first() -> None:
    body = Unicycle(np.zeros(2), control_period=1.0)
    body.act(lead(0.0, 0.02), 0)  # turn rate 0.02 / l = 0.4 rad/s about the axle at (-l, 0)
    for duration in (0.25, 0.5, 0.75):
        angle = 0.4 * duration
        state = body.sense(round(duration * S))
        np.testing.assert_allclose(state.position, [L * cos(angle) - L, L * sin(angle)], atol=1e-15)
        np.testing.assert_allclose(state.velocity, [-0.02 * sin(angle), 0.02 * cos(angle)], atol=1e-15)


def test_between_two_computations_the_axle_drives_an_arc_of_a_circle() -> None:
    speed, turn, duration = 0.15, 0.8, 2.5
    pose = Pose(1.0, -1.0, 0.3).after(speed, turn, duration)
    radius = speed / turn
    centre = np.array([1.0 - radius * sin(0.3), -1.0 + radius * cos(0.3)])
    np.testing.assert_allclose(np.hypot(*(np.array(pose[:2]) - centre)), radius, rtol=1e-12)
    np.testing.assert_allclose(pose.heading, 0.3 + turn * duration)
    np.testing.assert_allclose(pose[:2], centre + radius * np.array([sin(2.3), -cos(2.3)]), rtol=1e-12)
    np.testing.assert_allclose(Pose(1.0, -1.0, 0.3).after(speed, 1e-13, duration)[:2],
                               [1 + 0.375 * cos(0.3), -1 + 0.375 * sin(0.3)], rtol=1e-12)  # fmt: skip


def test_fast_control_leads_the_point_along_the_line_that_was_asked_for() -> None:
    # Near-identity: with v and w computed continuously the point is a single integrator, whatever the heading.
    body = Unicycle(np.zeros(2), heading=2.5, control_period=0.001)
    body.act(lead(0.04, 0.03), 0)
    np.testing.assert_allclose(body.sense(4 * S).position, [0.16, 0.12], atol=2e-4)


def test_an_independent_integration_of_the_wheels_agrees() -> None:
    period, instants = 0.033, np.linspace(0.0, 1.2, 7)[1:]

    def wheels(heading: float, wanted: Array) -> tuple[float, float]:
        rates = np.linalg.solve([[cos(heading), -L * sin(heading)], [sin(heading), L * cos(heading)]], wanted)
        sides = np.linalg.solve([[RADIUS / 2, RADIUS / 2], [-RADIUS / BASE, RADIUS / BASE]], rates)
        left, right = sides / max(1.0, abs(sides).max() / FASTEST)
        return left, right

    body = Unicycle(np.zeros(2), heading=-1.0)
    wanted = np.array([0.05, 0.18])
    body.act(lead(*wanted), 0)
    pose, time = np.array([-L * cos(-1.0), -L * sin(-1.0), -1.0]), 0.0
    for instant in instants:
        while time < instant - 1e-12:
            begin = period * int(time / period + 1e-9)
            if abs(time - begin) < 1e-9:
                left, right = wheels(pose[2], wanted)
            until = min(instant, begin + period)

            def roll(_t: float, z: Array, left: float = left, right: float = right) -> list[float]:
                v, w = RADIUS / 2 * (left + right), RADIUS / BASE * (right - left)
                return [v * cos(z[2]), v * sin(z[2]), w]

            pose = solve_ivp(roll, (time, until), pose, rtol=1e-11, atol=1e-12).y[:, -1]
            time = until
        point = pose[:2] + L * np.array([cos(pose[2]), sin(pose[2])])
        np.testing.assert_allclose(body.sense(round(instant * S)).position, point, atol=1e-8)


def test_no_wheel_is_faster_than_it_can_and_the_point_keeps_its_direction() -> None:
    rng = np.random.default_rng(0)
    limit = RADIUS * FASTEST
    for _ in range(200):
        heading, wanted = rng.uniform(-pi, pi), rng.normal(size=2)
        body = Unicycle(np.zeros(2), heading=heading)
        body.act(lead(*wanted), 0)
        velocity = body.sense(0).velocity
        speed = velocity @ [cos(heading), sin(heading)]
        turn = velocity @ [-sin(heading), cos(heading)] / L
        assert max(abs(speed - turn * BASE / 2), abs(speed + turn * BASE / 2)) <= limit + 1e-12
        np.testing.assert_allclose(velocity[0] * wanted[1], velocity[1] * wanted[0], atol=1e-12)
        assert velocity @ wanted > 0
    straight = Unicycle(np.zeros(2))
    straight.act(lead(5.0, 0.0), 0)
    np.testing.assert_allclose(straight.sense(S).position, [limit, 0.0])


def test_the_axle_is_the_look_ahead_behind_the_point_and_turns_behind_it_as_the_closed_form_does() -> None:
    # With u led exactly, heading' = |u| / l sin(course - heading): a tractrix.
    body = Unicycle(np.zeros(2), control_period=0.001)
    body.act(lead(-0.03, 0.01), 0)
    course, rate = pi - np.arctan2(0.01, 0.03), np.hypot(0.03, 0.01) / L
    for instant in range(0, 10 * S, S // 7):
        state, pose = body.sense(instant), body.pose(instant)
        np.testing.assert_allclose(pose[:2], state.position - L * np.array([cos(pose.heading), sin(pose.heading)]))
        gap = 2 * np.arctan(np.tan(course / 2) * np.exp(-rate * instant * 1e-9))
        assert course - pose.heading == pytest.approx(gap, abs=2e-3)


def test_holding_stops_the_wheels() -> None:
    body = Unicycle(np.zeros(2))
    body.act(lead(0.05, 0.05), 0)
    state = body.sense(S)
    body.act(Setpoint.hold(state), S)
    np.testing.assert_allclose(body.sense(9 * S).vector, [*state.position, 0, 0], atol=1e-12)


def test_it_goes_on_from_a_known_state_at_rest() -> None:
    body = Unicycle(np.zeros(2), heading=1.0)
    body.resume(State(read_only([3.0, 4.0]), read_only([0.1, 0.1])), 7 * S)
    np.testing.assert_allclose(body.sense(8 * S).vector, [3.0, 4.0, 0.0, 0.0], atol=1e-12)
    body.act(lead(0.1 * cos(1.0), 0.1 * sin(1.0)), 9 * S)
    np.testing.assert_allclose(body.sense(10 * S).position, [3 + 0.1 * cos(1.0), 4 + 0.1 * sin(1.0)], atol=1e-12)


@pytest.mark.parametrize(
    ("start", "options", "message"),
    [
        ([0.0, 0.0], {"look_ahead": 0.0}, "look_ahead must be positive, not 0"),
        ([0.0, 0.0], {"wheel_radius": -1.0}, "wheel_radius must be positive"),
        ([0.0, 0.0], {"control_period": 0.0}, "control_period must be positive"),
        ([0.0, 0.0, 1.0], {}, r"start must be \[x, y\] in m"),
    ],
)
def test_options_out_of_range_are_refused(start: list[float], options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Unicycle(np.array(start), **options)


def test_a_setpoint_that_is_not_planar_is_refused() -> None:
    with pytest.raises(ValueError, match="a setpoint with 3 velocities for a body in the plane"):
        Unicycle(np.zeros(2)).act(Setpoint(np.zeros(3), np.zeros(3), np.zeros(3)), 0)
