from pathlib import Path

import pytest

from dcf_zenoh.config import Overrides, load
from tests.support.fleet_files import problems
from tests.support.lossy_fleets import BEARS_LOSS, lossy

ENDS = (
    "the run ends when agent 2 has been silent for 0.6 s, by safety.neighbour_silent.then = 'land'; 'continue' goes on"
)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("crash.at=25", "crash.at: expected within the run, which ends at 25 s, not 25 s"),
        ("crash={}", "crash.at: missing; expected a number >= 0 (s)"),
        ("crash={at=1,restart_after=1e300}", "crash.restart_after: expected at most 1e+08 s, not 1e+300"),
        ("pause=[3,1]", "pause: expected begin < end, not [3, 1]"),
        ("pause=[1,1e300]", "pause: expected at most 1e+08 s, not 1e+300"),
        ("pause=[30,31]", "pause: expected within the run, which ends at 25 s, not 30 s"),
        (
            "pause=[3]",
            "pause: expected a list of 2 numbers (begin and end of a time in which the agent does nothing, s), not [3]",
        ),
        ("slow={factor=2,during=[3,2]}", "slow.during: expected begin < end, not [3, 2]"),
        ("slow={factor=1e300}", "slow.factor: expected at most 1e+08, not 1e+300"),
        ("slow={factor=0.5}", "slow.factor: expected a number >= 1 (by which its computation takes longer), not 0.5"),
    ],
)
def test_mistake_is_reported_in_one_line_with_its_key(tmp_path: Path, change: str, problem: str) -> None:
    assert problems(lossy(tmp_path, ""), f"agents.2.faults.{change}") == [f"agents.2.faults.{problem}"]


def test_unknown_fault_of_an_agent_gets_the_nearest_spelling(tmp_path: Path) -> None:
    assert problems(lossy(tmp_path, ""), "agents.2.faults.crsh.at=3") == [
        "agents.2.faults.crsh: [agents.2.faults] has no key 'crsh'; did you mean 'crash'? accepted: crash, pause, slow"
    ]


def test_the_dead_do_not_pause(tmp_path: Path) -> None:
    changes = ["agents.2.faults.crash.at=8", "agents.2.faults.pause=[9,9.5]"]
    assert problems(lossy(tmp_path, ""), *changes) == [
        "agents.2.faults.pause: begins when the agent is dead, from 8 s on"
    ]
    assert load(lossy(tmp_path, ""), changes=[*changes, "agents.2.faults.crash.restart_after=0.5"])


@pytest.mark.parametrize(
    ("change", "note"),
    [
        ("crash.at=8", f"agents.2.faults.crash: {ENDS}"),
        ("crash={at=8,restart_after=1}", f"agents.2.faults.crash: {ENDS}"),
        ("crash={at=8,restart_after=0.5}", ""),
        ("pause=[3,4]", f"agents.2.faults.pause: {ENDS}"),
        ("pause=[3,3.5]", ""),
    ],
)
def test_silence_that_ends_the_run_is_noted(tmp_path: Path, change: str, note: str) -> None:
    path = lossy(tmp_path, "")
    assert load(path, changes=[f"agents.2.faults.{change}", BEARS_LOSS]).notes == ((note,) if note else ())
    patient = [BEARS_LOSS, "safety.neighbour_silent.then=continue", f"agents.2.faults.{change}"]
    assert load(path, changes=patient).notes == ()


def test_slowness_of_what_takes_no_time_is_noted(tmp_path: Path) -> None:
    path = lossy(tmp_path, "")
    slow = ["agents.2.faults.slow.factor=5"]
    assert load(path, Overrides(clock="virtual"), changes=slow).notes == (
        "agents.2.faults.slow: without effect on the virtual clock, as exchange.compute_time is 0",
    )
    assert load(path, Overrides(clock="virtual"), changes=[*slow, "exchange.compute_time=1e-4"]).notes == ()
    assert load(path, Overrides(clock="wall"), changes=slow).notes == ()
