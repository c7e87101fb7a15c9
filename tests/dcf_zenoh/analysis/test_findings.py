"""Findings on a run: who came too close, did not arrive, missed deadlines, or refused messages."""

from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import dcf_zenoh
from agentd.results.summary import finding_lines
from dcf_zenoh import Run
from dcf_zenoh.analysis.findings import Finding
from tests.support.command_line import Answer


@pytest.fixture(scope="module")
def short() -> Run:
    """A flight that ends before anybody arrives."""
    return dcf_zenoh.simulate("position_swap", changes=["time.duration=1.0"])


@pytest.fixture(scope="module")
def whole() -> Run:
    """A flight in which all goes well."""
    return dcf_zenoh.simulate("position_swap")


def kinds(run: Run) -> list[str]:
    return [each.kind for each in run.findings]


def test_pair_in_each_others_safety_region_is_named_with_its_time_and_least_value() -> None:
    changes = ["time.duration=13.0", "problem.barrier.radii=[0.25, 0.25]"]
    run = dcf_zenoh.simulate("position_swap", changes=changes)
    assert run.barriers.min() > run.summary()["min_barrier"]  # between the samples
    texts = [each.text for each in run.findings if each.severe]
    assert len(texts) == 6
    assert texts[0].startswith("agents 1 and 3 were in each other's safety region from 12.07 s, for 0.")
    assert texts[0].endswith("least h -0.006")
    assert texts[5] == "1 more pair was too close"


def test_separation_is_checked_by_default_also_from_an_agent_that_is_dead() -> None:
    crash = ["agents.2.faults.crash={at=8.0}", "problem.barrier.radii=[0.6, 0.6]", "time.duration=10.7"]
    silent = "safety.neighbour_silent={after=0.6, then='continue'}"
    run = dcf_zenoh.simulate("position_swap_lossy", changes=[*crash, silent])
    alarms = [event for event in run.agents[3].events if event.get("rule") == "separation"]
    assert [(each["step"], each["then"]) for each in alarms] == [(52, "log")]
    assert alarms[0]["text"] == "in the safety region with agent 2 as of step 39: h = -0.000"


def test_separation_is_checked_although_every_message_is_late() -> None:
    slow = ["faults.rule=[{during=[0, 9], latency=0.25}]", "safety.separation={min=9.0}", "time.duration=0.8"]
    run = dcf_zenoh.simulate("position_swap", changes=slow)
    assert run.summary()["messages"]["late"] == run.summary()["messages"]["delivered"] > 0
    alarm = next(event for event in run.agents[1].events if event.get("rule") == "separation")
    assert alarm["step"] > 0
    gap = np.linalg.norm(run.positions[alarm["step"], 0, :2] - run.positions[0, 1, :2])
    assert alarm["text"] == f"{gap:.3f} m from agent 2 as of step 0, at least 9 m is wanted"


def test_agent_that_did_not_arrive_is_named_with_its_distance(short: Run) -> None:
    assert kinds(short) == ["not arrived"] * 4
    gaps = [np.linalg.norm(short.positions[-1, i, :2] - short.targets[agent]) for i, agent in enumerate(short.agents)]
    assert [each.text for each in short.findings] == [
        f"agent {agent} is {gap:.2f} m from its target at the end"
        for agent, gap in zip(short.agents, gaps, strict=True)
    ]


def test_whole_flight_without_faults_has_no_findings(whole: Run) -> None:
    assert whole.findings == ()


def test_agent_without_a_whole_log_is_a_finding_and_has_not_arrived(whole: Run) -> None:
    assert whole.arrival_time is not None
    others = {i: log for i, log in whole.agents.items() if i != 2}
    assert replace(whole, agents=others).arrival_time is None
    assert replace(whole, agents=others).findings == (("incomplete", "agent 2 has no log that can be read"),)
    cut = replace(whole, agents={**whole.agents, 2: replace(whole.agents[2], end=None)})
    text = f"agent 2's log breaks off after step {whole.agents[2].step[-1]}"
    assert ("incomplete", text) in cut.findings


def test_missed_deadlines_count_from_one_in_a_hundred_on(short: Run) -> None:
    late = short.agents[3].late.copy()
    late[2] = True
    run = replace(short, agents={**short.agents, 3: replace(short.agents[3], late=late)})
    assert [each.text for each in run.findings if each.kind == "deadlines"] == [
        "agent 3 missed 1 of 5 deadlines (20.0%)"
    ]


def test_messages_that_were_refused_repeated_or_overtaken_are_counted(short: Run) -> None:
    log = short.agents[2]
    assert log.end is not None
    counts = {**log.end["counts"], "refused": 3, "duplicates": 4, "overtaken": 5}
    run = replace(short, agents={**short.agents, 2: replace(log, end={**log.end, "counts": counts})})
    assert [each.text for each in run.findings if each.kind != "not arrived"] == [
        "agent 2 refused 3 messages: not readable, or not plausible",
        "agent 2 received 4 messages twice: is another daemon running as one of its neighbours?",
        "agent 2 dropped 5 messages that came after they had been given up",
    ]


def test_strict_makes_findings_an_exit_code(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    words = ("simulate", "position_swap", "--set", "time.duration=0.4", "--no-report")
    answer = agentd(*words, "--out", tmp_path / "loose")
    assert answer.code == 0
    assert "not arrived" in answer.out
    answer = agentd(*words, "--strict", "--out", tmp_path / "strict")
    assert answer.code == 6
    assert answer.err.startswith("agentd: --strict: agent 1 is ")
    assert answer.err.endswith(" from its target at the end; and 3 more\n")
    assert "not arrived" in answer.out


def test_strict_does_not_hide_why_bodies_landed(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    rule = "safety.separation={min=9.0, then='land'}"
    answer = agentd("simulate", "position_swap", "--set", rule, "--no-report", "--strict", "--out", tmp_path / "run")
    assert answer.code == 1
    assert "agentd: agent 1: step 0: " in answer.err
    assert "at least 9 m is wanted" in answer.err


@pytest.mark.parametrize(
    ("variables", "before", "after"),
    [
        ((), "", ""),
        (("FORCE_COLOR",), "\x1b[1;31m", "\x1b[0m"),
        (("FORCE_COLOR", "NO_COLOR"), "\x1b[1m", "\x1b[0m"),
    ],
)
def test_violation_is_red_on_a_terminal_and_bold_without_colours(
    variables: tuple[str, ...], before: str, after: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR", "COLORTERM"):
        monkeypatch.delenv(name, raising=False)
    for name in variables:
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("TERM", "xterm")
    console = Console(file=StringIO())
    with console.capture() as printed:
        console.print(*finding_lines("a run", [Finding("violation", "agents 1 and 2 were too close")]))
    assert printed.get() == f"{before}a run: agents 1 and 2 were too close{after}\n"


def test_a_life_that_broke_off_is_found_although_a_later_one_ended(short: Run) -> None:
    log = short.agents[2]
    assert log.end is not None
    ended = {**log.end, "counts": {**log.end["counts"], "refused": 3}}
    lives = {2: replace(log, lives=3, earlier=((1, ended), (3, None)))}
    run = replace(short, agents={**short.agents, **lives})
    texts = [each.text for each in run.findings]
    assert "agent 2's life 2 of 3 broke off after step 3; it was started again" in texts
    assert "agent 2 refused 3 messages: not readable, or not plausible" in texts
