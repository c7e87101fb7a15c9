"""What the latency of links leaves of rounds and steps: refused where it cannot work, noted where it likely fails."""

from pathlib import Path

import pytest

from dcf_zenoh.config import load
from dcf_zenoh.faults.profile import LinkProfile, write_profile
from dcf_zenoh.simulation import simulate
from tests.support.fleet_files import problems
from tests.support.lossy_fleets import BEARS_LOSS

SWAP = Path(load("position_swap").source)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            ["faults.latency=20"],
            "faults.latency: 20 s from agent 1 to 2 is longer than the budget of a step, exchange.budget = 0.15 s, in"
            " which every round waits for the message (times are in s)",
        ),
        (
            ["faults.rule=[{from=3,to=2,latency={distribution='uniform',low=0.2,high=0.3}}]"],
            "faults.rule.1.latency: 0.2 s from agent 3 to 2 is longer than the budget of a step, exchange.budget ="
            " 0.15 s, in which every round waits for the message (times are in s)",
        ),
        (
            ["faults.latency=0.05", "exchange.round_timeout=0.02"],
            "faults.latency: 0.05 s is longer than exchange.round_timeout = 0.02 s, so agent 1 receives no state in the"
            " rounds that share them (controller.sharing = 'flood'): raise the time-out",
        ),
        (
            ["topology.kind=ring", "faults.latency=0.08"],
            "exchange.budget: sharing the states takes 2 rounds, the diameter of the graph, of at least 0.08 s each:"
            " expected more than 0.16 s, not 0.15 s",
        ),
        (
            ["topology.kind=path", "exchange.mode=asynchronous", "exchange.period=0.05"],
            "exchange.budget: sharing the states takes 3 rounds, the diameter of the graph, of at least 0.05 s each:"
            " expected more than 0.15 s, not 0.15 s",
        ),
    ],
)
def test_a_step_without_time_for_its_messages_is_refused(changes: list[str], problem: str) -> None:
    assert problems(SWAP, *changes) == [problem]


@pytest.mark.parametrize(
    ("changes", "notes"),
    [
        (["faults.latency=0.02"], []),
        (
            ["faults.latency=0.05"],
            [
                "exchange.budget: 3 rounds of about 0.05 s to share states and agree on a graph of diameter 1 do not"
                " fit into 0.15 s: steps end by time, not by agreement"
            ],
        ),
        (
            ["faults.latency=0.001", "exchange.round_timeout=0.0005", BEARS_LOSS],
            [
                "faults.latency: 0.001 s on 12 links is longer than exchange.round_timeout = 0.0005 s: messages come"
                " too late for their round"
            ],
        ),
        (
            ["faults.loss=0.2", "exchange.round_timeout=0.0005"],
            [
                "faults.loss: can lose messages, and controller.sharing = 'flood' needs every message of the first"
                " round of a step: a step without one of them has no setpoint of its own; controller.sharing ="
                " 'piggyback' bears loss"
            ],
        ),
        (["faults.loss=0.2", "exchange.round_timeout=0.0005", BEARS_LOSS], []),
        (["faults.rule=[{during=[1,2],latency=20}]"], []),  # for a while only
        (["faults.rule=[{latency=20,to=1},{during=[1,2],to=1,latency=0.001}]"], []),  # not all the time
        (
            ["exchange.round_timeout=20"],
            [
                "exchange.round_timeout: 20 s is longer than the budget of a step, 0.15 s, so it never acts (times are"
                " in s; 20 ms are 0.02)"
            ],
        ),
    ],
)
def test_what_likely_fails_is_noted(changes: list[str], notes: list[str]) -> None:
    found = [each for each in load(SWAP, changes=changes).notes if "worst case" not in each]
    assert found == notes


def test_a_measured_latency_counts_by_its_quantiles(tmp_path: Path) -> None:
    links = [(i, j) for i in range(1, 5) for j in range(1, 5) if i != j]
    slow = (0.2, 0.25, 0.4)
    write_profile(tmp_path / "lab.json", [LinkProfile(i, j, 100, 0, 0.0, slow, 0.0) for i, j in links])
    latency = f'faults.latency={{distribution="empirical",file="{tmp_path / "lab.json"}"}}'
    assert problems(SWAP, latency)[0].startswith("faults.latency: 0.2 s from agent 1 to 2 is longer than the budget")


def test_the_bounds_of_what_is_refused_are_those_of_the_simulator() -> None:
    """A step just inside has setpoints of its own; what is refused just beyond would have had none."""
    run = simulate(load(SWAP, changes=["topology.kind=ring", "faults.latency=0.07", "time.duration=0.4"]))
    assert sum(log.late.sum() for log in run.agents.values()) == 0
    assert all(log.step[-1] == 1 for log in run.agents.values())
    assert problems(SWAP, "topology.kind=ring", "faults.latency=0.0751")


@pytest.mark.parametrize("clock", ["wall", "virtual"])
def test_a_control_period_meant_in_ms_is_refused(clock: str) -> None:
    assert problems(SWAP, "time.sample_time=200", f"time.clock={clock}")[0] == (
        "time.sample_time: expected at most time.duration = 25 s, not 200 s (times are in s; 200 ms are 0.2)"
    )
    assert problems(SWAP, "exchange.budget=100")[0] == (
        "exchange.budget: expected at most time.sample_time = 0.2 s, not 100 s (times are in s; 100 ms are 0.1)"
    )
