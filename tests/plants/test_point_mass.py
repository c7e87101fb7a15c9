import numpy as np
import pytest

from dcf_zenoh.plant import Setpoint
from plants.point_mass import PointMass

S = 1_000_000_000  # ns


def accelerate(*a: float) -> Setpoint:
    return Setpoint(acceleration=np.array(a))


def test_a_held_acceleration_is_integrated_exactly() -> None:
    body = PointMass(np.array([1.0, 2.0]), velocity=(0.5, 0.0))
    body.act(accelerate(1.0, -2.0), 0)
    state = body.sense(3 * S)
    np.testing.assert_allclose(state.position, [1 + 1.5 + 4.5, 2 - 9.0])
    np.testing.assert_allclose(state.velocity, [3.5, -6.0])


def test_the_path_does_not_depend_on_how_often_it_is_sensed() -> None:
    seldom, often = (PointMass(np.zeros(2)) for _ in range(2))
    for body, instants in ((seldom, [S]), (often, range(0, S + 1, S // 50))):
        body.act(accelerate(0.3, 0.7), 0)
        for now in instants:
            body.sense(now)
    np.testing.assert_allclose(seldom.sense(S).vector, often.sense(S).vector, rtol=1e-12)


def test_a_late_setpoint_acts_late() -> None:
    body = PointMass(np.zeros(1))
    body.act(accelerate(1.0), S)
    np.testing.assert_allclose(body.sense(2 * S).position, [0.5])


def test_the_input_saturates() -> None:
    body = PointMass(np.zeros(2), accel_max=2.0)
    body.act(accelerate(5.0, -5.0), 0)
    np.testing.assert_allclose(body.sense(S).velocity, [2.0, -2.0])


def test_holding_brakes_each_axis_to_rest_and_stays() -> None:
    body = PointMass(np.zeros(2), velocity=(1.0, -0.5), accel_max=2.0)
    body.act(Setpoint.hold(body.sense(0)), 0)
    halfway = body.sense(S // 4)
    np.testing.assert_allclose(halfway.velocity, [0.5, 0.0])
    rest = body.sense(10 * S)
    np.testing.assert_allclose(rest.vector, [0.25, -0.0625, 0, 0], atol=1e-12)  # v²/2a on each axis


def test_states_handed_out_cannot_be_changed() -> None:
    state = PointMass(np.zeros(2)).sense(0)
    with pytest.raises(ValueError, match="read-only"):
        state.position[0] = 1.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"accel_max": 0.0}, "accel_max must be positive, in m/s², not 0.0"),
        ({"velocity": (1.0,)}, "velocity has 1 components"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PointMass(np.zeros(2), **options)  # type: ignore[arg-type]
