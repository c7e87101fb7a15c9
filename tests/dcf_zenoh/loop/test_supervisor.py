import numpy as np
import pytest

from dcf_zenoh.loop.supervisor import Alarm, Supervisor, most_severe
from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.rounds.receiver import KnownPosition
from dcf_zenoh.spec import Arena, Safety

BOX = Arena(min=(-1.0, -2.0, 0.0), max=(1.0, 2.0, 1.5))


def supervisor(arena: Arena | None = None, **rules: object) -> Supervisor:
    return Supervisor(Safety.model_validate(rules), arena, 0.2)


def state(*position: float, velocity: tuple[float, ...] = ()) -> State:
    return State(read_only(position), read_only(velocity or [0.0] * len(position)))


def setpoint(*acceleration: float, velocity: tuple[float, ...] = (0.0, 0.0)) -> Setpoint:
    return Setpoint(read_only([0.0, 0.0]), read_only(velocity), read_only(acceleration))


def test_body_in_the_arena_gives_no_alarm() -> None:
    watch = supervisor(BOX)
    assert watch.body(state(1.0, -2.0)) == []
    assert watch.body(state(0.0, 0.0, 1.5)) == []
    assert supervisor().body(state(99.0, 0.0)) == []


def test_alarm_of_the_fence_has_position_and_bounds() -> None:
    alarms = supervisor(BOX, geofence="stop").body(state(1.25, 0.0, -0.5))
    text = "outside the arena: x = 1.25 m, allowed -1 .. 1 m, z = -0.50 m, allowed 0 .. 1.5 m"
    assert alarms == [Alarm("geofence", "stop", text)]


def test_planar_body_is_checked_on_two_axes() -> None:
    assert [alarm.then for alarm in supervisor(BOX).body(state(0.0, 2.01))] == ["land"]


def test_speed_of_the_body_is_checked_unless_it_is_clipped() -> None:
    fast = state(0.0, 0.0, velocity=(0.9, 1.2))
    assert supervisor(speed={"max": 1.4}).body(fast) == []
    (alarm,) = supervisor(speed={"max": 1.4, "then": "hold"}).body(fast)
    assert alarm == ("speed", "hold", "flies at 1.50 m/s, at most 1.4 m/s is allowed")


def test_acceleration_is_cut_down_to_its_limit_and_keeps_its_direction() -> None:
    watch = supervisor(acceleration={"max": 2.5})
    cut, alarms = watch.setpoint(setpoint(3.0, -4.0), state(0.0, 0.0))
    assert cut.acceleration is not None
    np.testing.assert_allclose(cut.acceleration, [1.5, -2.0])
    assert alarms == [("acceleration", "clip", "commanded acceleration is 5.00 m/s², at most 2.5 m/s² is allowed")]
    same, alarms = watch.setpoint(setpoint(1.5, -2.0), state(0.0, 0.0))
    np.testing.assert_array_equal(same.acceleration, [1.5, -2.0])
    assert alarms == []


def test_setpoint_that_is_not_clipped_stays_the_same() -> None:
    flown, alarms = supervisor(acceleration={"max": 1.0, "then": "log"}).setpoint(setpoint(3.0, 4.0), state(0.0, 0.0))
    np.testing.assert_array_equal(flown.acceleration, [3.0, 4.0])
    assert [alarm.then for alarm in alarms] == ["log"]


def test_no_acceleration_takes_the_body_beyond_its_speed_limit() -> None:
    moving = state(0.0, 0.0, velocity=(0.9, 0.0))
    cut, alarms = supervisor(speed={"max": 1.0}).setpoint(setpoint(2.0, 0.0, velocity=(1.3, 0.0)), moving)
    assert cut.acceleration is not None
    np.testing.assert_allclose(moving.velocity + cut.acceleration * 0.2, [1.0, 0.0])
    np.testing.assert_allclose(cut.velocity, [1.0, 0.0])
    assert [alarm.rule for alarm in alarms] == ["speed"]


def test_setpoint_to_hold_has_no_limits() -> None:
    hold = Setpoint.hold(state(0.0, 0.0))
    assert supervisor(speed={"max": 1e-9}, acceleration={"max": 1e-9}).setpoint(hold, state(0.0, 0.0)) == (hold, [])


def test_neighbour_that_is_too_near_gives_an_alarm() -> None:
    watch = supervisor(separation={"min": 0.3, "then": "land"})
    known = {3: KnownPosition(7, (0.3, 0.0)), 2: KnownPosition(5, (0.0, 0.25)), 4: KnownPosition(7, ())}
    alarms = watch.separation(state(0.0, 0.0, 1.0), known, 7)
    assert alarms == [("separation", "land", "0.250 m from agent 2 as of step 5, at least 0.3 m is wanted")]
    assert supervisor().separation(state(0.0, 0.0), known, 7) == []


def test_neighbour_in_the_safety_region_of_the_problem_gives_an_alarm_by_default() -> None:
    def barrier(own: Array, other: Array) -> Array:
        return np.abs(own - other).sum() - 1.0 if other[0] < 5 else 1 / np.zeros(0)[0]  # type: ignore[no-any-return]

    watch = Supervisor(Safety(), None, 0.2, barrier)
    known = {2: KnownPosition(7, (0.5, 0.25)), 3: KnownPosition(7, (0.5, 0.5)), 4: KnownPosition(7, (9.0, 0.0))}
    assert watch.separation(state(0.0, 0.0), known, 7) == [
        ("separation", "log", "in the safety region with agent 2: h = -0.250"),
        (
            "separation",
            "log",
            "the safety region with agent 4 cannot be computed: IndexError: index 0 is out of bounds for axis 0 with"
            " size 0",
        ),
    ]
    off = Supervisor(Safety.model_validate({"separation": {"then": "ignore"}}), None, 0.2, barrier)
    assert off.separation(state(0.0, 0.0), known, 7) == []


def test_steps_are_late_in_a_row_only_without_one_in_time_between() -> None:
    watch = supervisor(missed_deadlines={"in_a_row": 2})
    found = [bool(watch.deadline(late=late)) for late in (True, False, True, True, True, False)]
    assert found == [False, False, False, True, True, False]


def test_lost_neighbour_is_logged_where_the_others_continue() -> None:
    assert supervisor().neighbours([]) == []
    for then, what in {"land": "land", "hold": "hold", "stop": "stop", "continue": "log"}.items():
        (alarm,) = supervisor(neighbour_silent={"then": then}).neighbours(
            ["neighbour 1 is lost", "neighbour 2 is lost"]
        )
        assert alarm == ("neighbour_silent", what, "neighbour 1 is lost; neighbour 2 is lost")


def test_alarm_is_new_once_until_a_check_without_it() -> None:
    watch = supervisor()
    alarm = Alarm("speed", "log", "")
    fresh = [len(watch.fresh("body", alarms)) for alarms in ([alarm], [alarm], [], [alarm])]
    assert fresh == [1, 0, 0, 1]
    assert watch.fresh("setpoint", [alarm]) == [alarm]


@pytest.mark.parametrize(
    ("reactions", "worst"), [(["log", "clip"], "clip"), (["hold", "stop", "land"], "stop"), (["land", "hold"], "land")]
)
def test_most_severe_reaction_wins(reactions: list[str], worst: str) -> None:
    found = most_severe([Alarm("", then, "") for then in reactions])
    assert found is not None
    assert found.then == worst


def test_without_alarms_none_is_the_most_severe() -> None:
    assert most_severe([]) is None
