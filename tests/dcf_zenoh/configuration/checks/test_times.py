from pathlib import Path

import pytest

from dcf_zenoh.config import load
from tests.support.fleet_files import problems
from tests.support.lossy_fleets import lossy

WITHOUT = "[faults]\nlatency = 0.001"
ASYNCHRONOUS = "exchange.mode=asynchronous"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = lossy(tmp_path, WITHOUT)
    path.write_text(path.read_text().replace("round_timeout = 0.003", ""))
    return path


@pytest.mark.parametrize(
    ("changes", "loser", "proposal"),
    [
        (["faults.loss=0.1"], "faults.loss", "0.003"),
        (["faults.rule=[{to=1,loss=0.1},{to=2,bursts=0.1}]", "exchange.max_rounds=50"], "faults.rule.1.loss", "0.003"),
        (["agents.2.faults.pause=[1,1.5]"], "agents.2.faults.pause", "0.003"),
        (["faults.range=1", "time.clock=virtual", "exchange.max_rounds=200"], "faults.range", "0.0007"),
        (["faults.range=1", "time.clock=wall", "exchange.max_rounds=200"], "faults.range", "0.002"),
    ],
)
def test_loss_needs_a_timeout_of_rounds(file: Path, changes: list[str], loser: str, proposal: str) -> None:
    if "bursts" in changes[0]:
        changes = [changes[0].replace("bursts=0.1", "bursts={mean_loss=0.1,mean_length=2}"), *changes[1:]]
    assert problems(file, *changes) == [
        f"exchange.round_timeout: missing; {loser} can lose messages, and a round would wait for a lost one until the"
        f" step's budget is used up: set it to more than the latency of the links, such as {proposal} s"
    ]
    assert load(file, changes=[*changes, ASYNCHRONOUS])
    assert load(file, changes=[*changes, "exchange.round_timeout=0.001"])


def test_what_loses_nothing_needs_no_timeout(file: Path) -> None:
    assert load(file, changes=["faults.noise=0.1", "faults.loss=false", "agents.1.faults.slow.factor=2"])


def test_keys_of_the_other_mode_are_without_effect(file: Path) -> None:
    changes = ["exchange.jitter=0.1", "agents.2.exchange.period=0.1"]
    assert load(file, changes=changes).notes == (
        "exchange.jitter, agents.2.exchange.period: without effect, as exchange.mode is 'synchronous'",
    )
    assert load(file, changes=[ASYNCHRONOUS, "exchange.round_timeout=1", "exchange.margin=2"]).notes == (
        "exchange.round_timeout, exchange.margin: without effect, as exchange.mode is 'asynchronous':"
        " nobody waits for anybody",
    )
    assert load(file, changes=[ASYNCHRONOUS]).notes == load(file).notes == ()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("exchange.period=0.16", "exchange.period: expected at most the budget of a step, 0.15 s, not 0.16 s"),
        (
            "agents.2.exchange.period=0.16",
            "agents.2.exchange.period: expected at most the budget of a step, 0.15 s, not 0.16 s",
        ),
        (
            "exchange.jitter=0.005",  # 0.150 s for 40 rounds
            "exchange.jitter: expected a jitter shorter than the period; they are 0.005 s and 0.00375 s",
        ),
        (
            "agents.2.exchange={period=0.01,jitter=0.01}",
            "agents.2.exchange.jitter: expected a jitter shorter than the period; they are 0.01 s and 0.01 s",
        ),
    ],
)
def test_activations_have_bounds(file: Path, change: str, problem: str) -> None:
    assert problems(file, ASYNCHRONOUS, change) == [problem]


@pytest.mark.parametrize("key", ["time.duration", "safety.neighbour_silent.after", "zenoh.receive_timeout"])
def test_times_beyond_all_reason_are_refused(file: Path, key: str) -> None:
    assert f"{key}: expected at most 1e+08 s, not 1e+09" in problems(file, f"{key}=1e9")


def test_agent_without_own_activations_follows_the_fleet(file: Path) -> None:
    changes = [ASYNCHRONOUS, "exchange.jitter=0.001", "agents.2.exchange.period=0.01", "agents.3.exchange.jitter=0"]
    spec = load(file, changes=changes).spec
    activations = [(spec.activation(i).period, spec.activation(i).jitter) for i in spec.ids]
    assert activations == [(0.00375, 0.001), (0.01, 0.001), (0.00375, 0.0), (0.00375, 0.001)]
    assert load(file, changes=[*changes, "exchange.period=0.02"]).spec.activation(4).period == 0.02


def test_silence_shorter_than_two_control_periods_is_noted(file: Path) -> None:
    changes = ["time.sample_time=0.5", "controller.lost_after=0.9"]
    assert [note for note in load(file, changes=changes).notes if "control periods" in note] == [
        f"{key} s is less than two control periods, 1 s: a neighbour whose messages of one step are missing counts as"
        " lost"
        for key in ("safety.neighbour_silent.after: 0.6", "controller.lost_after: 0.9")
    ]
    assert not any("control periods" in note for note in load(file).notes)
