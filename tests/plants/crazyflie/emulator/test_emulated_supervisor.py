"""The supervisor's states, look by look."""

import pytest

from plants.crazyflie.emulator.supervisor import PERIOD, FirmwareSupervisor, Observation, SupervisorState

STILL = Observation(thrust=False, tumbled=False, setpoint_age=0, healthy=True, ready_timeout=30000, landed_timeout=3000)
UP = STILL._replace(thrust=True)


class Watched:
    """A supervisor that is shown the same again and again."""

    def __init__(self) -> None:
        self.supervisor = FirmwareSupervisor()
        self.now = 0

    def see(self, what: Observation, milliseconds: int = PERIOD) -> SupervisorState:
        for _ in range(milliseconds // PERIOD):
            self.now += PERIOD
            self.supervisor.update(what, self.now)
        return self.supervisor.state


@pytest.fixture
def flying() -> Watched:
    watched = Watched()
    watched.see(STILL, 80)
    assert watched.supervisor.arm(True)
    watched.see(STILL, 80)
    assert watched.see(UP, 80) is SupervisorState.FLYING
    return watched


def test_it_flies_only_when_armed() -> None:
    watched = Watched()
    assert not watched.supervisor.arm(True)  # it has not looked yet
    assert watched.see(STILL) is SupervisorState.PASSED
    assert not watched.supervisor.motors_may_run
    assert watched.see(UP, 400) is SupervisorState.PASSED
    assert watched.supervisor.arm(True)
    assert watched.see(STILL) is SupervisorState.READY
    assert watched.supervisor.motors_may_run
    assert watched.supervisor.bits == 0b1010


def test_landing_is_noticed_two_seconds_after_the_last_thrust_and_disarms_after_three_more(flying: Watched) -> None:
    assert flying.see(STILL, 1960) is SupervisorState.FLYING
    assert flying.see(STILL, 40) is SupervisorState.LANDED
    assert flying.supervisor.armed
    assert flying.see(STILL, 3000) is SupervisorState.LANDED
    flying.see(STILL, 120)
    assert flying.supervisor.state is SupervisorState.PASSED
    assert not flying.supervisor.armed


def test_one_lands_and_takes_off_again(flying: Watched) -> None:
    assert flying.see(STILL, 2400) is SupervisorState.LANDED
    assert flying.see(UP) is SupervisorState.FLYING


@pytest.mark.parametrize(
    ("age", "state"),
    [(500, SupervisorState.FLYING), (501, SupervisorState.LEVELLING), (2001, SupervisorState.FREE_FALL)],
)
def test_age_of_the_setpoint_decides(flying: Watched, age: int, state: SupervisorState) -> None:
    assert flying.see(UP._replace(setpoint_age=age)) is state


def test_levelling_out_ends_with_a_setpoint_or_in_a_fall(flying: Watched) -> None:
    assert flying.see(UP._replace(setpoint_age=600)) is SupervisorState.LEVELLING
    assert flying.see(UP) is SupervisorState.FLYING
    flying.see(UP._replace(setpoint_age=600))
    assert flying.see(UP._replace(setpoint_age=2040)) is SupervisorState.FREE_FALL
    assert not flying.supervisor.motors_may_run
    assert flying.see(STILL, 10000) is SupervisorState.LOCKED
    assert flying.supervisor.bits == 1 << 6
    assert not flying.supervisor.arm(True)


def test_levelling_out_on_the_ground_ends_in_a_lock_all_the_same(flying: Watched) -> None:
    assert flying.see(STILL._replace(setpoint_age=600), 1480) is SupervisorState.LEVELLING
    assert flying.see(STILL._replace(setpoint_age=2040), 80) is SupervisorState.LOCKED


def test_signs_of_life_must_go_on_once_they_have_begun(flying: Watched) -> None:
    assert flying.see(UP, 5000) is SupervisorState.FLYING
    flying.supervisor.feed(flying.now)
    assert flying.see(UP, 960) is SupervisorState.FLYING
    flying.supervisor.feed(flying.now)
    assert flying.see(UP, 960) is SupervisorState.FLYING
    assert flying.see(UP, 40) is SupervisorState.FREE_FALL


def test_disarming_in_the_air_stops_the_motors_without_a_lock(flying: Watched) -> None:
    flying.supervisor.arm(False)
    assert flying.see(UP) is SupervisorState.RESET
    assert not flying.supervisor.motors_may_run
    assert flying.see(STILL, 80) is SupervisorState.PASSED


def test_tumbled_while_it_flies_is_a_crash_and_before_it_is_a_failed_check(flying: Watched) -> None:
    over = UP._replace(tumbled=True)
    assert flying.see(over) is SupervisorState.CRASHED
    assert not flying.supervisor.recover()
    flying.see(STILL)
    assert flying.supervisor.state is SupervisorState.CRASHED
    assert flying.supervisor.recover()
    assert flying.see(STILL, 80) is SupervisorState.PASSED
    assert flying.see(over) is SupervisorState.NOT_PASSED
    assert flying.supervisor.bits & 1 << 5


def test_emergency_stop_locks_on_the_ground_too() -> None:
    watched = Watched()
    watched.see(STILL)
    watched.supervisor.stop()
    assert watched.see(STILL, 80) is SupervisorState.LOCKED
