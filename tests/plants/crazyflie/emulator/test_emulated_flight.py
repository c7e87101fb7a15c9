"""cflib flies the emulator, and what happens when it stops."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from plants.crazyflie.emulator.truth import Record
from plants.crazyflie.model.twin import Twin
from plants.crazyflie.model.vehicle import read
from plants.wind import Wind, WindOptions
from tests.support.cflib_client import Client, client
from tests.support.emulated import Emulated
from tests.support.waiting import until

pytestmark = pytest.mark.real_time


def the(drone: Emulated, event: str, within: float = 10.0) -> Record:
    """What happened to a drone, waited for; the last time that it did."""
    until(lambda: event in drone.events, f"{event}; so far {drone.events}", within)
    return next(r for r in reversed(drone.truth) if r.kind == "event" and r["event"] == event)


def when(drone: Emulated, event: str, within: float = 10.0) -> float:
    """The drone's time at which something happened to it, waited for."""
    return the(drone, event, within).time


def last_command(drone: Emulated, name: str) -> float:
    return drone.commands(name)[-1].time


def test_take_off_go_to_and_landing_by_the_planner(cf: Client, drone: Emulated) -> None:
    cf.log("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
    cf.take_off(0.6)
    cf.cf.high_level_commander.go_to(0.4, -0.3, 0.6, 0.0, 1.5)
    cf.stream(2.5, lambda: None)
    assert [cf.logged[f"stateEstimate.{axis}"] for axis in "xyz"] == pytest.approx([0.4, -0.3, 0.6], abs=0.1)
    cf.land()
    when(drone, "landed")
    assert drone.landed_softly()
    np.testing.assert_allclose(drone.path[-1, 1:], [0.4, -0.3, 0.0], atol=0.1)


def test_hover_setpoints_are_tracked_like_by_the_twin(cf: Client, drone: Emulated) -> None:
    cf.take_off()
    cf.hover(2.0)
    cf.hover(2.0, ahead=0.3, left=-0.2)
    step = next(r.time for r in drone.commands("hover") if r["values"][0] > 0.2)
    path = drone.path
    flown = path[(path[:, 0] >= step) & (path[:, 0] <= step + 1.9)]
    calm = np.random.default_rng(0)
    twin = Twin(
        read("forster2015"), flown[0, 1:], np.zeros(3), sensor=None, wind=Wind(WindOptions(), rng=calm), rng=calm
    )
    twin.run(1000)
    twin.hover((0.3, -0.2), 0.5)
    simulated = []
    for _ in flown:
        simulated.append(twin.state[:3].copy())
        twin.run(20)
    away = (flown[:, 1:] - flown[0, 1:]) - (np.array(simulated) - simulated[0])
    assert np.abs(away[:, :2]).max() < 0.03
    assert np.abs(flown[:, 3] - 0.5).max() < 0.05


def test_take_off_without_arming_is_refused(cf: Client, drone: Emulated) -> None:
    cf.cf.high_level_commander.takeoff(0.5, 0.5)
    cf.hover(1.0)
    assert "took off" not in drone.events
    assert not cf.cf.supervisor.is_armed
    assert max(r["motors"][0] for r in drone.truth if r.kind == "state") == 0


def test_arming_is_refused_where_its_checks_fail(cf: Client, drone: Emulated) -> None:
    drone.say("refuse-arm on")
    until(lambda: not cf.cf.supervisor.can_be_armed, "it cannot be armed")
    cf.cf.supervisor.send_arming_request(True)
    when(drone, "arming refused")
    drone.say("refuse-arm off")
    cf.arm()


def test_silent_client_makes_it_level_out_then_fall_and_lock(cf: Client, drone: Emulated) -> None:
    cf.take_off()
    cf.hover(1.5, ahead=0.5)
    silent = last_command(drone, "hover")
    assert when(drone, "levelling out") - silent == pytest.approx(0.5, abs=0.06)
    assert when(drone, "free fall") - silent == pytest.approx(2.0, abs=0.06)
    touched = the(drone, "touched down")
    assert not touched["soft"]
    assert touched["speed"] > 1.5
    levelled = [r for r in drone.truth if r.kind == "state" and silent + 1.2 < r.time < silent + 2.0]
    assert np.abs([r["angles"][:2] for r in levelled]).max() < 0.02  # rad
    until(lambda: cf.cf.supervisor.is_locked, "it is locked")
    assert not cf.cf.supervisor.can_be_armed
    cf.cf.supervisor.send_arming_request(True)
    cf.cf.commander.send_notify_setpoint_stop()
    cf.cf.high_level_commander.takeoff(0.5, 0.5)
    cf.hover(1.0)
    assert drone.state["supervisor"] == "locked"
    assert drone.state["position"][2] == 0.0
    drone.say("restart")
    cf.take_off()


def test_setpoints_that_come_back_in_time_are_followed_again(cf: Client, drone: Emulated) -> None:
    cf.take_off()
    cf.hover(0.5)
    cf.stream(1.2, lambda: None)
    cf.hover(1.0)
    assert drone.events[-2:] == ["levelling out", "flying"]
    assert "locked" not in drone.events


@pytest.mark.parametrize("stop", ["send_emergency_stop", "send_emergency_stop_watchdog"])
def test_emergency_stop_and_its_watchdog_lock(cf: Client, drone: Emulated, stop: str) -> None:
    cf.take_off()
    sent = drone.state["time"]
    getattr(cf.cf.supervisor, stop)()
    stopped = when(drone, "free fall")
    assert stopped - sent == pytest.approx(0.0 if stop == "send_emergency_stop" else 1.0, abs=0.2)
    when(drone, "touched down")
    until(lambda: cf.cf.supervisor.is_locked, "it is locked")


def test_closing_the_link_in_the_air_makes_it_fall(drone: Emulated, cache: Path) -> None:
    drone.renew()
    with client(drone.uri, cache) as cf:
        cf.take_off(1.0)
        cf.hover(0.5, height=1.0)
    closed = last_command(drone, "roll_pitch_yaw_thrust")
    assert when(drone, "motors stopped") - closed < 0.1
    touched = the(drone, "touched down")
    assert touched.time - closed < 1.0
    assert touched["speed"] > 3.0


def test_planner_has_no_say_until_the_client_gives_up_its_priority(cf: Client, drone: Emulated) -> None:
    cf.arm()
    cf.cf.commander.send_setpoint(0, 0, 0, 0)  # what closing a link sends
    cf.cf.high_level_commander.takeoff(0.5, 0.5)
    cf.stream(1.0, lambda: None)
    assert "took off" not in drone.events
    cf.cf.high_level_commander.stop()
    cf.cf.commander.send_notify_setpoint_stop()
    cf.cf.high_level_commander.takeoff(0.5, 0.5)
    when(drone, "took off")


def test_who_falls_silent_soon_after_landing_finds_it_locked(cf: Client, drone: Emulated) -> None:
    cf.take_off()
    cf.stream(0.3, lambda: cf.cf.commander.send_hover_setpoint(0, 0, 0, 0.5))
    cf.stream(2.0, lambda: cf.cf.commander.send_hover_setpoint(0, 0, 0, 0.05))
    cf.cf.commander.send_stop_setpoint()
    when(drone, "locked")
    assert drone.events.index("touched down") < drone.events.index("levelling out")


def test_tumbling_in_flight_stops_the_motors_until_it_is_told_to_recover(cf: Client, drone: Emulated) -> None:
    cf.take_off()
    drone.say("tumble on")
    when(drone, "crashed")
    when(drone, "touched down")
    assert cf.cf.supervisor.is_crashed
    cf.cf.supervisor.send_crash_recovery_request()
    cf.stream(0.3, lambda: None)
    assert cf.cf.supervisor.is_crashed  # still on its back
    drone.say("tumble off")
    until(lambda: not cf.cf.supervisor.is_tumbled, "upright")
    cf.cf.supervisor.send_crash_recovery_request()
    until(lambda: cf.cf.supervisor.can_be_armed, "it can be armed again")


def test_armed_drone_that_does_not_take_off_disarms_itself(cf: Client, drone: Emulated) -> None:
    cf.cf.param.set_value("supervisor.prefltTimeout", 500)
    cf.arm()
    armed = when(drone, "ready to fly")
    assert when(drone, "checks not passed") - armed == pytest.approx(0.5, abs=0.1)
    assert not drone.state["armed"]


def test_other_setpoints_move_it_as_they_say(cf: Client, drone: Emulated) -> None:
    commander = cf.cf.commander

    def moved_by(send: Callable[[], None], seconds: float) -> list[float]:
        before = drone.state["position"]
        cf.stream(seconds, send)
        return [float(there - here) for here, there in zip(before, drone.state["position"], strict=True)]

    cf.take_off(0.8)
    first = moved_by(lambda: commander.send_position_setpoint(0.5, 0.0, 0.8, 90.0), 2.5)
    assert first[0] == pytest.approx(0.5, abs=0.17)  # it overshoots: drag is taken for tilt
    assert cf.cf.supervisor.is_flying
    ahead = moved_by(lambda: commander.send_hover_setpoint(0.4, 0.0, 0.0, 0.8), 1.5)  # it looks along y now
    assert ahead[1] > 0.25
    assert abs(ahead[0]) < 0.1
    east = moved_by(lambda: commander.send_velocity_world_setpoint(0.4, 0.0, 0.0, 0.0), 1.5)
    assert east[0] > 0.25
    cf.hover(0.7, height=0.8)
    left = moved_by(lambda: commander.send_zdistance_setpoint(5.0, 0.0, 0.0, 0.8), 1.0)
    assert left[0] > 0.1  # roll to the right, which is east when it looks along y
    nose_down = moved_by(lambda: commander.send_zdistance_setpoint(0.0, -5.0, 0.0, 0.8), 1.5)
    assert nose_down[1] > 0.1
    assert "levelling out" not in drone.events


def test_thrust_is_refused_until_it_has_been_zero(cf: Client, drone: Emulated) -> None:
    cf.arm()
    cf.stream(0.5, lambda: cf.cf.commander.send_setpoint(0.0, 0.0, 0.0, 50000))
    assert "took off" not in drone.events
    cf.cf.commander.send_setpoint(0.0, 0.0, 0.0, 0)
    cf.stream(0.6, lambda: cf.cf.commander.send_setpoint(0.0, 0.0, 0.0, 50000))
    when(drone, "took off")


def test_battery_sinks_in_flight_and_can_be_set(cf: Client, drone: Emulated) -> None:
    cf.log("pm.vbat", "pm.state", period=100)
    full = cf.logged["pm.vbat"]
    cf.take_off()
    assert cf.logged["pm.vbat"] < full - 0.1
    drone.say("battery 3.0")
    until(lambda: cf.logged["pm.vbat"] < 3.2, "it is low")
    until(lambda: cf.logged["pm.state"] == 3, "it says so", 8.0)


def test_frozen_estimate_and_drift_are_what_they_are_called(cf: Client, drone: Emulated) -> None:
    cf.log("stateEstimate.x", "kalman.varPX", "lighthouse.status", period=20)
    cf.take_off()
    drone.say("drift 0.3 0")
    before = drone.state
    cf.hover(2.0)
    after = drone.state
    carried = (after["position"][0] - before["position"][0]) / (after["time"] - before["time"])
    assert carried == pytest.approx(0.3, abs=0.05)
    drone.say("drift 0 0")
    drone.say("variance 0.5")
    drone.say("base-stations 0")
    until(lambda: cf.logged["kalman.varPX"] == 0.5 and cf.logged["lighthouse.status"] == 0, "both are told")
    drone.say("freeze-estimate on")
    cf.hover(0.3)
    frozen = cf.logged["stateEstimate.x"]
    count, began = cf.received, time.monotonic()
    cf.hover(0.5, ahead=0.5)
    assert cf.logged["stateEstimate.x"] == frozen
    assert cf.received - count > 10 * (time.monotonic() - began)
