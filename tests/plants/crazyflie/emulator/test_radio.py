"""The radio: in model time by itself, and as cflib meets it."""

import os
import signal
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from plants.crazyflie.emulator.radio import Radio, RadioConditions
from tests.support.cflib_client import Client, client
from tests.support.emulated import Emulated
from tests.support.waiting import until

pytestmark = pytest.mark.real_time


@pytest.fixture
def cf(drone: Emulated, cache: Path) -> Iterator[Client]:
    """cflib with a link of its own, which may come to an end."""
    drone.renew()
    with client(drone.uri, cache) as connected:
        yield connected


def radio(**conditions: float) -> Radio:
    return Radio(RadioConditions(**conditions), np.random.default_rng(1))


def arrivals(of: Radio, sent: Iterable[float]) -> list[tuple[float, bytes]]:
    """What comes of packets sent up at these instants: when, and which."""
    came: list[tuple[float, bytes]] = []
    for number, instant in enumerate(sent):
        came += of.up.pop_due(instant)
        of.send_up(instant, number.to_bytes(4, "little"))
    return [*came, *of.up.pop_due(1e9)]


def test_packet_takes_the_latency_and_an_exponential_tail_on_top() -> None:
    sent = np.arange(20000) * 10.0
    delays = np.array([when for when, _ in arrivals(radio(latency=0.005, tail=0.02), sent)]) - sent
    assert delays.min() >= 0.005 - 1e-9
    assert delays.mean() == pytest.approx(0.025, rel=0.03)
    assert np.mean(delays > 0.005 + 0.02 * np.log(10)) == pytest.approx(0.1, abs=0.01)


def test_packets_stay_in_order() -> None:
    came = arrivals(radio(latency=0.005, tail=0.02), np.arange(5000) * 0.002)
    assert [int.from_bytes(wire, "little") for _, wire in came] == list(range(5000))
    assert np.all(np.diff([when for when, _ in came]) >= 0)


def test_silence_holds_packets_both_ways_and_then_lets_them_through() -> None:
    of = radio(latency=0.005)
    of.silence(1.0, 0.3)
    came = [when for when, _ in arrivals(of, np.array([0.9, 1.0, 1.29, 1.31]))]
    assert came == pytest.approx([0.905, 1.305, 1.307, 1.315])
    of.send_down(1.1, b"x")  # told of it late: the silence is what counts
    assert of.down.next == pytest.approx(1.305)


def test_long_silence_has_room_for_a_hundred_packets() -> None:
    of = radio(latency=0.005)
    of.silence(0.0, 1.5)
    assert len(arrivals(of, np.arange(300) * 0.004)) == 100


def test_silences_come_as_often_as_they_should() -> None:
    sent = np.arange(0, 6000, 0.1)
    delays = np.array([when for when, _ in arrivals(radio(latency=0.0, silences=6.0), sent)]) - sent
    held = np.mean(delays > 0)
    assert held == pytest.approx(6.0 * 0.3 / 60, rel=0.2)


def test_nothing_is_lost_before_a_client_has_connected() -> None:
    of = radio(loss=0.3)
    assert len(arrivals(of, np.arange(1000) * 1.0)) == 1000
    of.connected = True
    assert len(arrivals(of, 1e4 + np.arange(10000) * 1.0)) == pytest.approx(7000, abs=200)


def test_link_is_lost_after_two_seconds_of_silence() -> None:
    of = radio()
    of.silence(1.0, 5.0)
    assert [of.lost(now) for now in (0.5, 1.5, 2.9, 3.1, 5.9, 6.1)] == [False, False, False, True, True, False]
    of.silence(10.0, float("inf"))
    assert of.lost(12.1)
    of.restore(13.0)
    assert not of.lost(13.1)


def test_short_silence_is_survived(cf: Client, drone: Emulated) -> None:
    cf.log("stateEstimate.z")
    cf.take_off()
    cf.hover(0.5)
    for _ in range(2):
        drone.say("silence 0.3")
        cf.hover(0.8)
    count = cf.received
    until(lambda: cf.received > count + 10, "logs go on")
    assert "levelling out" not in drone.events
    assert cf.errors == []


def test_longer_silence_makes_it_level_out_and_is_over_by_itself(cf: Client, drone: Emulated) -> None:
    cf.take_off()
    cf.hover(0.5)
    drone.say("silence 1.0")
    cf.hover(2.0)
    assert drone.events[-2:] == ["levelling out", "flying"]
    assert cf.errors == []


def test_dead_link_is_first_stale_and_then_an_error_and_the_drone_falls(cf: Client, drone: Emulated) -> None:
    cf.stop_pinging()
    cf.log("stateEstimate.z")
    cf.take_off()
    cf.hover(0.5)
    drone.say("kill-link")
    cf.hover(0.5)
    count = cf.received
    cf.hover(1.0)
    assert cf.received == count
    assert cf.errors == []
    cf.hover(1.5)
    until(lambda: cf.errors, "cflib finds out")
    until(lambda: "locked" in drone.events, "it has fallen")
    assert {"levelling out", "free fall", "link lost"} <= set(drone.events)


def test_drone_is_within_reach_again_when_the_link_is_restored(cf: Client, drone: Emulated, cache: Path) -> None:
    cf.stop_pinging()
    drone.say("kill-link")
    until(lambda: "link lost" in drone.events, "the link is lost")
    cf.stream(0.2, cf.cf.commander.send_stop_setpoint)
    until(lambda: cf.errors, "cflib finds out")
    drone.say("restore-link")
    with client(drone.uri, cache) as again:
        again.log("pm.vbat")


def test_loss_takes_log_packets_once_connected(cf: Client, drone: Emulated, cache: Path) -> None:
    cf.log("pm.vbat", period=10)
    drone.say("loss 0.5")
    count, began = cf.received, drone.state["time"]
    cf.stream(2.0, lambda: None)
    share = (cf.received - count) / ((drone.state["time"] - began) * 100)
    assert share == pytest.approx(0.5, abs=0.15)
    cf.stop_pinging()
    with client(drone.uri, cache) as again:  # nothing is lost before it has connected
        again.stream(0.1, lambda: None)


def test_drone_whose_process_was_held_up_catches_up_and_heeds_what_came_meanwhile(cf: Client, drone: Emulated) -> None:
    cf.log("stateEstimate.x")
    cf.take_off()
    cf.hover(0.5)
    before = drone.state["time"]
    os.kill(drone._process.pid, signal.SIGSTOP)
    try:
        cf.hover(1.5, ahead=0.2)
    finally:
        os.kill(drone._process.pid, signal.SIGCONT)
    cf.hover(0.5, ahead=0.2)
    assert "levelling out" not in drone.events
    assert drone.state["time"] - before == pytest.approx(2.0, abs=0.3)
    assert cf.logged["stateEstimate.x"] > 0.2


@pytest.fixture(scope="module")
def far_drone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    folder = tmp_path_factory.mktemp("far")
    with Emulated(folder, "--tail", "0.02", "--silences", "12", "--loss", "0.02", "--seed", "3") as running:
        yield running


def test_bad_radio_is_flown_through(far_drone: Emulated, cache: Path) -> None:
    far_drone.renew()
    with client(far_drone.uri, cache, within=40.0) as cf:
        cf.log("stateEstimate.z", "radio.rssi")
        cf.take_off()
        cf.hover(5.0)
        latency = cf.cf.link_statistics.latency.latency  # ms, of the 95th percentile
        cf.land()
    assert latency > 40.0
    assert far_drone.landed_softly()
