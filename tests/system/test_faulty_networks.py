"""Fleets over bad networks: the same faults again, nothing that hangs, and who dies comes back."""

import random
import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

import dcf_zenoh
from dcf_zenoh.analysis.explanation import explain
from dcf_zenoh.analysis.link_health import link_health
from dcf_zenoh.records.run import Run
from tests.support.daemons import both_cores_busy, launch_virtual

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

FLEETS = (
    "position_swap_lossy",
    "position_swap_async",
    pytest.param("position_swap_partition", marks=pytest.mark.large),
)
DYING = [
    "time.duration=4.0",
    "agents.1.faults.crash.at=0.85",
    "agents.1.faults.crash.restart_after=1.2",
    "agents.2.faults.pause=[0.5, 0.58]",
    "agents.3.faults.slow.factor=2.0",
    "exchange.compute_time=1e-4",
]


def links(run: Run) -> dict[int, Any]:
    """What the links did to every message."""
    return {i: log.passed for i, log in run.agents.items()}


@pytest.mark.parametrize("fleet", FLEETS)
def test_daemons_lose_and_delay_the_same_messages_as_the_simulator(fleet: str, tmp_path: Path) -> None:
    changes = ["time.duration=2.0"]
    if fleet.endswith("partition"):
        changes.append("faults.rule.1.during=[0.5, 1.2]")
    simulated = dcf_zenoh.simulate(fleet, changes=changes)
    options = [word for change in changes for word in ("--set", change)]
    with both_cores_busy() if fleet == "position_swap_async" else nullcontext():
        summary = launch_virtual(fleet, tmp_path / "run", *options)
    launched = Run.read(tmp_path / "run")
    assert summary["digest"] == launched.digest == simulated.digest
    assert links(launched) == links(simulated)
    assert any(each.lost_by for log in simulated.agents.values() for each in log.passed)
    other = dcf_zenoh.simulate(fleet, changes=changes, seed=2)
    assert other.digest != simulated.digest
    assert links(other) != links(simulated)


@pytest.mark.parametrize("mode", ["synchronous", "asynchronous"])
def test_a_crash_a_restart_and_a_pause_are_repeated_to_the_bit(mode: str, tmp_path: Path) -> None:
    changes = [*DYING, f"exchange.mode='{mode}'"]
    simulated = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    launch_virtual("position_swap_lossy", tmp_path / "run", *[word for change in changes for word in ("--set", change)])
    launched = Run.read(tmp_path / "run")
    assert launched.digest == simulated.digest
    assert links(launched) == links(simulated)
    dead = simulated.agents[1]
    assert [(event["event"], event["time"]) for event in dead.events] == [
        ("crashed", 850_000_000),
        ("restarted", 2_200_000_000),
    ]
    assert dead.step.tolist() == list(range(20))
    assert [k for k, how in enumerate(dead.stopped_by) if how == "abstained"] == list(range(4, 11))


@pytest.mark.parametrize("mode", ["synchronous", "asynchronous"])
@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_resumption_does_not_matter_with_faults(mode: str, seed: int) -> None:
    changes = [*DYING, f"exchange.mode='{mode}'", "time.duration=2.6"]
    straight = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    shuffled = dcf_zenoh.simulate("position_swap_lossy", changes=changes, choose=random.Random(seed).randrange)
    assert shuffled.digest == straight.digest
    assert links(shuffled) == links(straight)


def test_a_crash_in_a_pause_ends_it_whatever_the_order_of_resumption() -> None:
    changes = [
        "time.duration=1.6",
        "exchange.mode='asynchronous'",
        "exchange.compute_time=1e-4",
        "agents.1.faults.pause=[0.3, 1.4]",
        "agents.1.faults.crash.at=0.5",
        "agents.1.faults.crash.restart_after=0.2",
    ]
    straight = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    assert [k for k, how in enumerate(straight.agents[1].stopped_by) if how == "abstained"] == [1, 2, 3]
    heard = [log.links[1][4:, 0].min() for i, log in straight.agents.items() if i != 1]
    assert min(heard) > 0  # in every step from the restart on
    for seed in range(3):
        shuffled = dcf_zenoh.simulate("position_swap_lossy", changes=changes, choose=random.Random(seed).randrange)
        assert shuffled.digest == straight.digest
        assert links(shuffled) == links(straight)


def test_an_agent_that_crashed_and_came_back_reaches_its_target() -> None:
    changes = ["agents.1.faults.crash.at=3.05", "agents.1.faults.crash.restart_after=2.0"]
    run = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    assert run.arrival_time is not None
    assert run.complete
    assert run.barriers.min() > 0
    assert all(log.step.tolist() == list(range(len(log.step))) for log in run.agents.values())
    for j in (2, 3, 4):
        said = " ".join(run.agents[j].remarks)
        assert "neighbour 1 is lost (nothing heard for 0." in said
        assert "neighbour 1 is back" in said


@pytest.mark.parametrize("fleet", ["position_swap_lossy", "position_swap_async"])
@pytest.mark.parametrize(
    ("at", "restart_after", "absent"),
    [
        (0.0, 0.05, [0]),  # at the beginning of step 0
        (0.05, 0.1, [0]),  # within step 0, back before step 1 begins
        (0.78, 0.01, []),  # step 3 is done; back before step 4 begins, at 0.8 s
        (0.78, 0.02, []),
        (0.78, 0.03, [4]),
        (0.78, 0.22, [4]),
    ],
)
def test_a_crashed_agent_misses_the_steps_that_begin_before_it_is_back(
    fleet: str, at: float, restart_after: float, absent: list[int]
) -> None:
    changes = [f"agents.1.faults.crash={{at={at},restart_after={restart_after}}}", "time.duration=1.6"]
    run = dcf_zenoh.simulate(fleet, changes=changes)
    log = run.agents[1]
    assert log.step.tolist() == list(range(8))
    assert [k for k, how in enumerate(log.stopped_by) if how == "abstained"] == absent
    (back,) = (event["step"] for event in log.events if event["event"] == "restarted")
    assert back == (absent[-1] + 1 if absent else 4)


@pytest.mark.parametrize("delay", [0.0, 0.0007, 0.05])
def test_copies_change_nothing_and_are_neither_delivered_nor_late(delay: float) -> None:
    changes = ["time.duration=1.0", "exchange.max_rounds=20"]
    alone = dcf_zenoh.simulate("position_swap", changes=changes)
    run = dcf_zenoh.simulate(
        "position_swap", changes=[*changes, f"faults.duplication={{probability=1.0,delay={delay}}}"]
    )
    assert run.digest == alone.digest
    assert run.summary()["messages"] == alone.summary()["messages"]
    assert sum(each.duplicates for each in link_health(run)) == sum(each.sent for each in link_health(alone)) > 0
    assert not explain(run).disturbed


def test_a_neighbour_that_stays_dead_is_an_obstacle_where_it_was() -> None:
    run = dcf_zenoh.simulate("position_swap_lossy", changes=["agents.1.faults.crash.at=3.05", "time.duration=14.0"])
    rest = run.agents[1].path[-1]
    assert abs(run.agents[1].path[20:] - rest).max() < 0.2
    assert run.barriers.min() > 0
    for j in (2, 3, 4):
        assert abs(run.agents[j].path[-1] - run.targets[j]).max() < 0.6  # as near as the obstacle lets it


@pytest.mark.parametrize("algorithm", ["robust", "plain"])
@pytest.mark.parametrize("rule", ["", "{from=1, to=2, loss=1.0}", "{to=3, loss=1.0}"])
def test_nothing_hangs_when_all_messages_are_lost(rule: str, algorithm: str) -> None:
    changes = ["time.duration=2.0", f"faults.rule=[{rule}]", f"faults.loss={0.0 if rule else 1.0}"]
    choice = "trades_robust" if algorithm == "robust" else "plain"
    run = dcf_zenoh.simulate("position_swap_lossy", algorithm=choice, changes=changes)
    assert run.steps == 10
    assert run.complete


def test_a_silent_neighbour_ends_the_flight_of_the_others_if_the_fleet_file_says_land() -> None:
    changes = ["agents.1.faults.crash.at=1.0", "safety.neighbour_silent.then='land'"]
    run = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    for agent in (2, 3, 4):
        end = run.agents[agent].end
        assert end is not None
        assert end["end"] == "landed"
        assert re.fullmatch(
            rf"agent {agent}: step \d: neighbour 1 is lost \(nothing heard for 0\.\d+ s\)", end["remark"]
        )


def test_with_plain_trades_the_run_completes_and_is_worse() -> None:
    plain = dcf_zenoh.simulate("position_swap_lossy", algorithm="plain")
    robust = dcf_zenoh.simulate("position_swap_lossy")
    assert plain.complete
    assert robust.barriers.min() > 0.05
    assert plain.barriers.min() < robust.barriers.min() - 0.05


def test_computing_slowly_takes_that_much_longer_in_the_model() -> None:
    """40 rounds of 80 us, nothing lost: 3.2 ms; three times that where the computer is slow; the others wait for it."""
    quiet = ["time.duration=1.0", "faults.rule=[]", "faults.loss=0.0", "faults.latency=0.0", "exchange.threshold=0.0"]
    slow = [*quiet, "controller.predict_delay=0.0", "agents.2.faults.slow={factor=3.0, during=[0.4, 0.9]}"]
    run = dcf_zenoh.simulate("position_swap_lossy", changes=slow)
    for log in run.agents.values():
        assert log.negotiation.tolist() == pytest.approx([3.2e-3, 3.2e-3, 9.6e-3, 9.6e-3, 9.6e-3], abs=2.5e-4)


def test_fleet_time_is_zero_at_the_start_whatever_the_network_and_the_computers() -> None:
    changes = ["time.duration=0.4", "exchange.compute_time=0.002", "agents.3.faults.slow.factor=100.0"]
    run = dcf_zenoh.simulate("position_swap_lossy", topology="ring", changes=[*changes, "faults.rule=[]"])
    assert [log.sensed[0] for log in run.agents.values()] == [0.0] * 4


def test_nothing_comes_from_beyond_the_range() -> None:
    """Neighbours start 1.41 m apart, opposite agents 2 m."""
    changes = ["time.duration=0.4", "faults.rule=[]", "faults.loss=0.0", "faults.range=1.5"]
    run = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    lost = {(i, j): counts[0, 3] for i, log in run.agents.items() for j, counts in log.links.items()}
    beyond = {link for link, count in lost.items() if count}
    assert beyond == {(1, 2), (2, 1), (3, 4), (4, 3)}


def test_latency_alone_does_not_make_agents_leave_in_different_rounds() -> None:
    late = ["faults.rule=[]", "faults.loss=0.0", "faults.latency={distribution='uniform', low=0.0, high=0.0035}"]
    changes = [*late, "exchange.max_rounds=200", "exchange.threshold=0.05", "time.duration=4.0"]
    run = dcf_zenoh.simulate("position_swap_lossy", changes=changes)
    agreed = [k for k in range(run.steps) if all(log.stopped_by[k] == "agreed" for log in run.agents.values())]
    assert len(agreed) >= 15
    assert all(len({log.rounds[k] for log in run.agents.values()}) == 1 for k in agreed)


def test_the_silent_are_not_waited_for() -> None:
    """40 rounds take 80 us each; of the first step, 20 also take the time-out of 3 ms."""
    changes = ["time.duration=1.0", "faults.rule=[{from=1, loss=1.0}]", "faults.loss=0.0", "faults.latency=0.0"]
    run = dcf_zenoh.simulate("position_swap_lossy", changes=[*changes, "exchange.threshold=0.0"])
    took = run.agents[2].negotiation
    assert took.tolist() == pytest.approx([40 * 80e-6 + 20 * 3e-3, *[40 * 80e-6] * 4])
    assert run.agents[2].links[1][:, 0].sum() == 0
