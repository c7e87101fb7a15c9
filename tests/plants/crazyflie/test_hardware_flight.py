"""The real Crazyflie in the air: what it was asked to do, and what the emulated drone really did."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Setpoint, State
from plants.crazyflie.hardware import CrazyflieHardware
from tests.support.emulated import Emulated, drive
from tests.support.hardware import hardware
from tests.support.waiting import until

pytestmark = pytest.mark.real_time

SAMPLE = 0.2  # s
# All that it may be told. Not among them: velocities in the world, which do not hold the height; full states, which
# overflow; thrust, which cflib sends when it closes a link.
KNOWN = {"hover", "relax", "take_off", "go_to", "land", "stop_plan", "arm", "disarm"}


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    with Emulated(tmp_path_factory.mktemp("truth")) as drone:
        yield drone


@pytest.fixture
def drone(emulator: Emulated) -> Emulated:
    emulator.renew()
    return emulator


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@contextmanager
def flying(drone: Emulated, cache: Path, **options: Any) -> Iterator[CrazyflieHardware]:
    """A drone that hovers above where it stood, ready for setpoints."""
    chosen = {"height": 0.3, "cache": str(cache), **options}
    plant = hardware(chosen.pop("start", (0.0, 0.0)), uri=drone.uri, **chosen)
    try:
        drive(plant.prepare())
        drive(plant.arm())
        drive(plant.take_off())
        plant.start(0)
        yield plant
    finally:
        plant.close()


def accelerate(state: State, *a: float) -> Setpoint:
    size = len(a)
    acceleration = np.array(a)
    velocity = state.velocity[:size] + acceleration * SAMPLE
    return Setpoint(state.position[:size] + velocity * SAMPLE, velocity, acceleration)


def control(plant: CrazyflieHardware, seconds: float, policy: Callable[[State], Setpoint]) -> list[State]:
    """The control loop: sense and act, every sample; the states."""
    states = []
    due = time.monotonic()
    for _ in range(round(seconds / SAMPLE)):
        states.append(plant.sense(0))
        plant.act(policy(states[-1]), 0)
        due += SAMPLE
        time.sleep(max(0.0, due - time.monotonic()))  # the control period
    return states


def told(setpoint: Setpoint, state: State) -> Setpoint:
    """The same setpoint, whatever the state."""
    return setpoint


def trouble(plant: CrazyflieHardware, within: float) -> str:
    """What `sense` raises, while the control loop holds the drone where it is."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        try:
            plant.act(Setpoint.hold(plant.sense(0)), 0)
        except PlantError as error:
            return str(error)
        time.sleep(0.02)  # the control period
    pytest.fail(f"nothing was wrong for {within:g} s")


def where(drone: Emulated) -> Any:
    return np.array(drone.state["position"])


def test_a_flight_from_the_ground_to_the_ground(emulator: Emulated, cache: Path) -> None:
    emulator.renew(0.3, -0.2)
    plant = hardware(uri=emulator.uri, height=0.4, cache=str(cache))
    try:
        drive(plant.prepare())
        drive(plant.inspect())
        assert [check.problem for check in plant.checks()] == [""] * 7
        drive(plant.arm())
        drive(plant.take_off())
        np.testing.assert_allclose(where(emulator), [0.3, -0.2, 0.4], atol=0.12)
        drive(plant.settle())
        drive(plant.go_to_start())
        np.testing.assert_allclose(where(emulator), [0.0, 0.0, 0.4], atol=0.12)
        plant.start(0)
        states = control(plant, 1.6, lambda state: accelerate(state, 0.5, 0.0))
        assert states[0].position.shape == states[0].velocity.shape == (3,)
        assert where(emulator)[0] - states[0].position[0] > 0.1
        assert drive(plant.finish(0, "done")) < plant.landing_time
        assert drive(plant.finish(0, "done")) < 0.5  # it has landed already
    finally:
        plant.close()
    assert emulator.landed_softly()
    assert emulator.events[-1] != "armed"
    assert "disarmed" in emulator.events
    assert {record["command"] for record in emulator.commands()} <= KNOWN
    assert abs(emulator.path[:, 3].max() - 0.4) < 0.12


def test_velocities_are_turned_into_the_body_frame(emulator: Emulated, cache: Path) -> None:
    emulator.renew(0.0, 0.0, 90.0)
    with flying(emulator, cache) as plant:
        before = where(emulator)
        control(plant, 1.6, lambda state: accelerate(state, 0.5, 0.0))
        moved = where(emulator) - before
    assert moved[0] > 0.1
    assert abs(moved[1]) < 0.5 * moved[0]
    told = np.array([record["values"] for record in emulator.commands("hover")])
    assert told[:, 1].min() < -0.1  # to its right
    assert emulator.landed_softly()


def test_height_is_held_under_planar_setpoints(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        begin = drone.state["time"]
        control(plant, 2.0, lambda state: accelerate(state, 0.0, 0.5 if state.velocity[1] < 0.2 else -0.5))
        end = drone.state["time"]
    path = drone.path
    heights = path[(path[:, 0] > begin) & (path[:, 0] < end), 3]
    assert abs(heights - 0.3).max() < 0.1


def test_velocities_are_limited_and_have_to_be_finite(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache, speed_max=0.2) as plant:
        begin = drone.state["time"]
        control(plant, 0.8, lambda state: accelerate(state, 2.0, 2.0))
        end = drone.state["time"]
        with pytest.raises(PlantError, match=r"^agent 2: a setpoint must be finite, not \[nan, nan\]$"):
            plant.act(Setpoint(acceleration=np.array([np.nan, np.nan])), 0)
        with pytest.raises(ValueError, match="a setpoint of 1 components"):
            plant.act(Setpoint(acceleration=np.zeros(1)), 0)
    told = [record["values"] for record in drone.commands("hover") if begin < record.time < end]
    assert max(np.hypot(ahead, left) for ahead, left, *_ in told) == pytest.approx(0.2, abs=0.01)


def test_a_setpoint_in_space_climbs(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        before = where(drone)[2]
        control(plant, 1.6, lambda state: accelerate(state, 0.0, 0.0, 0.6))
        assert where(drone)[2] > before + 0.12
    assert {record["command"] for record in drone.commands()} <= KNOWN
    assert drone.landed_softly()


def test_other_references_fly_there_too(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        for reference in ("planned", "integrated", "position"):  # in one flight
            plant._reference = reference
            control(plant, 1.0, Setpoint.hold)
            before = where(drone)[:2]
            goal = Setpoint(before + np.array([0.4, 0.0]), np.array([0.3, 0.0]), np.array([0.4, 0.0]))
            control(plant, 1.6, partial(told, goal))
            assert where(drone)[0] - before[0] > 0.1, reference
    assert drone.landed_softly()


def test_closing_in_the_air_lands_first(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        assert where(drone)[2] > 0.2
        plant.close()
        assert where(drone)[2] < 0.05
    assert drone.landed_softly()
    assert drone.commands("roll_pitch_yaw_thrust") == []


def test_a_program_that_ends_in_an_exception_lands_first(drone: Emulated, cache: Path) -> None:
    program = f"""
import time
from tests.support.hardware import hardware
plant = hardware(uri={drone.uri!r}, cache={str(cache)!r}, height=0.4)
for phase in (plant.prepare, plant.arm, plant.take_off):
    for pause in phase():
        time.sleep(pause)
raise RuntimeError("of the program")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert "RuntimeError: of the program" in done.stderr
    assert drone.landed_softly()
    assert "disarmed" in drone.events


def test_setpoints_go_on_while_the_control_loop_hangs_and_then_it_lands(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache, land_after=2.0) as plant:
        plant.act(accelerate(plant.sense(0), 1.0, 0.0), 0)
        begin = drone.state["time"]
        until(lambda: drone.commands("land"), "it lands by itself", within=6.0)
        ordered = drone.commands("land")[0].time
        with pytest.raises(PlantError, match=r"^agent 2: is landing: no command for 2\.\d s, at most 2 s is allowed$"):
            plant.sense(0)
        drive(plant.finish(0, "failed"))
        with pytest.raises(PlantError, match=r"^agent 2: landed: no command for "):
            plant.act(Setpoint.hold(State(np.zeros(3), np.zeros(3))), 0)
    assert 1.5 < ordered - begin < 3.5
    times = np.array([record.time for record in drone.commands("hover") if begin < record.time < ordered])
    assert np.diff(times).max() < 0.4
    assert "levelling out" not in drone.events  # which the firmware does after 0.5 s
    path = drone.path
    still = path[(path[:, 0] > begin + 1.5) & (path[:, 0] < ordered)]
    assert np.ptp(still[:, 1]) < 0.1  # it held
    assert drone.landed_softly()


def test_it_lands_when_the_battery_is_low_but_not_at_a_dip(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        drone.say("battery 2.95")
        control(plant, 0.2, Setpoint.hold)
        drone.say("battery 3.8")
        control(plant, 0.8, Setpoint.hold)
        drone.say("battery 2.95")
        text = trouble(plant, within=3.0)
        assert text.startswith("agent 2: is landing: battery 2.9")
        assert text.endswith(" V, at least 3.1 V is needed")
        drive(plant.finish(0, "failed"))
    assert drone.landed_softly()


def test_a_state_that_stands_still_makes_it_land(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        drone.say("freeze-estimate on")
        text = trouble(plant, within=3.0)
        assert text.startswith("agent 2: is landing: its state is 0.")
        assert text.endswith(" s old, at most 0.5 s is allowed")
        drone.say("freeze-estimate off")
        drive(plant.finish(0, "failed"))
    assert where(drone)[2] < 0.05
    assert drone.commands("land")


def test_lighthouse_that_goes_dark_makes_it_land(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        before = where(drone)
        drone.say("base-stations 0")
        text = trouble(plant, within=3.0)
        assert text.startswith("agent 2: is landing: no base station for 0.")
        assert text.endswith(" s, at most 0.5 s is allowed")
        drive(plant.finish(0, "failed"))
        assert np.hypot(*(where(drone) - before)[:2]) < 0.5
    assert drone.landed_softly()


def test_a_short_silence_is_survived(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        for _ in range(2):
            drone.say("silence 0.3")
            control(plant, 0.8, Setpoint.hold)
        drive(plant.finish(0, "done"))
    assert drone.landed_softly()


def test_a_dead_link_is_told_in_time_and_so_is_what_the_firmware_does(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        drone.say("kill-link")
        began = time.monotonic()
        text = trouble(plant, within=3.0)
        assert time.monotonic() - began < 1.5
        assert text.startswith("agent 2: is landing: its state is ")
        began = time.monotonic()
        with pytest.raises(PlantError, match=r"agent 2: .*nothing can be sent; without setpoints the firmware levels"):
            drive(plant.finish(0, "failed"))
        assert time.monotonic() - began < 5.0
        plant.close()
        assert time.monotonic() - began < 10.0
        until(lambda: "locked" in drone.events, "it is locked", within=5.0)
        events = drone.events
    assert events.index("levelling out") < events.index("free fall") < events.index("locked")


def test_a_link_that_dies_in_the_take_off_leaves_it_hovering_and_that_is_told(drone: Emulated, cache: Path) -> None:
    plant = hardware(uri=drone.uri, height=0.8, cache=str(cache))

    def cut_off(pauses: Any) -> Iterator[float]:
        for pause in pauses:
            if where(drone)[2] > 0.1:
                drone.say("kill-link")
            yield pause

    try:
        drive(plant.prepare())
        drive(plant.arm())
        with pytest.raises(PlantError, match=r"^agent 2: its state is "):
            drive(cut_off(plant.take_off()))
        with pytest.raises(PlantError, match=r"^agent 2: not seen to land: .*its planner on board flies it: if it was"):
            drive(plant.finish(0, "failed"))
    finally:
        plant.close()
    until(lambda: where(drone)[2] > 0.75, "it has come to its height", within=5.0)
    assert not {"levelling out", "locked"} & set(drone.events)


def test_a_drone_that_tumbles_is_told(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        drone.say("tumble on")
        text = trouble(plant, within=3.0)
    assert "the firmware has stopped its motors" in text


def test_emergency_stop_cuts_the_motors_at_once_while_others_wait_for_the_link(
    drone: Emulated, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with flying(drone, cache) as plant:
        driver = plant._connected().link.crazyflie.link
        send, free = driver.send_packet, threading.Event()

        def send_when_free(packet: Any) -> None:
            if packet.port == 7:  # setpoints: as if the radio's queue were full
                free.wait(5)
            send(packet)

        monkeypatch.setattr(driver, "send_packet", send_when_free)
        stopper = threading.Thread(target=plant.emergency_stop)
        began = drone.state["time"]
        stopper.start()
        until(lambda: drone.commands("emergency_stop"), "the motors stop", within=2.0)
        assert drone.commands("emergency_stop")[0].time - began < 0.4
        stopper.join(1.0)
        assert not stopper.is_alive()
        free.set()
        with pytest.raises(PlantError, match=r"^agent 2: landed: emergency stop$"):
            plant.sense(0)
        assert drive(plant.finish(0, "stopped")) < 1.0
    until(lambda: "touched down" in drone.events, "it falls", within=3.0)
    assert "motors stopped" in drone.events


def test_emergency_stop_ends_a_landing_that_is_under_way(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        landing = plant.finish(0, "stopped")
        next(landing)
        until(lambda: drone.commands("land"), "it is landing")
        plant.emergency_stop()
        assert drive(landing) < 2.0
    until(lambda: "locked" in drone.events, "it is locked")


def test_emergency_stop_is_repeated_although_the_program_ends(drone: Emulated, cache: Path) -> None:
    with flying(drone, cache) as plant:
        plant.emergency_stop()
    until(lambda: len(drone.commands("emergency_stop")) > 5, "it has been told more than once")


def test_two_drones_in_one_process(emulator: Emulated, cache: Path, tmp_path: Path) -> None:
    emulator.renew()
    with (
        Emulated(tmp_path) as other,
        flying(emulator, cache, land_after=20.0) as first,  # it waits for the other
        flying(other, cache, land_after=20.0) as second,
    ):
        control(first, 0.6, Setpoint.hold)
        control(second, 0.6, Setpoint.hold)
        first.close()
        control(second, 0.6, Setpoint.hold)
        second.close()
        assert other.landed_softly()
    assert emulator.landed_softly()


def test_it_flies_over_tcp_as_well(cache: Path, tmp_path: Path) -> None:
    before = threading.active_count()
    with Emulated(tmp_path, "--tcp") as drone:
        with flying(drone, cache) as plant:
            control(plant, 0.6, Setpoint.hold)
        assert drone.landed_softly()
    until(lambda: threading.active_count() <= before, "all threads have ended", within=5.0)


def test_what_was_left_in_the_air_is_refused_and_landed(drone: Emulated, cache: Path) -> None:
    left = hardware(uri=drone.uri, cache=str(cache))
    drive(left.prepare())
    drive(left.arm())
    link, _, autopilot = left._connected()
    link.high_level.takeoff(0.4, 1.5)  # as if its process had been killed in a manoeuvre: the planner hovers on
    until(lambda: where(drone)[2] > 0.3, "it is in the air", within=5.0)
    autopilot.close()
    link.close()
    plant = hardware(uri=drone.uri, cache=str(cache))
    drive(plant.prepare())
    drive(plant.inspect())
    found = {check.name: check for check in plant.checks()}["supervisor"]
    assert found.value == "flying"
    assert "it lands when this program ends" in found.problem
    plant.close()
    assert drone.landed_softly()


def test_latency_and_silences_as_users_meet_them(cache: Path, tmp_path: Path) -> None:
    air = ("--latency", "0.005", "--tail", "0.02", "--silences", "12")
    with Emulated(tmp_path, *air) as drone:
        plant = hardware((0.3, 1.0), uri=drone.uri, cache=str(cache))
        try:
            for phase in (plant.prepare, plant.inspect, plant.arm, plant.take_off, plant.settle, plant.go_to_start):
                drive(phase())
            plant.start(0)
            control(plant, 4.0, lambda state: accelerate(state, *(-0.5 * state.velocity[:2])))
            drive(plant.finish(0, "done"))
        finally:
            plant.close()
        assert drone.landed_softly()
