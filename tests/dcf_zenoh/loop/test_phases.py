"""Phases of a flight and safety reactions, in the simulator; those of daemons are tested in tests/agentd."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.errors import PlantError
from dcf_zenoh.records.run import Run
from tests.support.bodies import PHASES, Sandbox


@pytest.fixture
def sandbox(tmp_path: Path) -> Sandbox:
    return Sandbox(tmp_path)


def ends(run: Run) -> dict[int, str]:
    return {i: log.end["end"] for i, log in run.agents.items() if log.end}


def alarms(run: Run, agent: int) -> list[tuple[Any, ...]]:
    events = [event for event in run.agents[agent].events if event["event"] == "alarm"]
    return [(event["step"], event["rule"], event["then"]) for event in events]


def test_every_body_goes_through_all_phases_in_order(sandbox: Sandbox) -> None:
    sandbox.fly()
    for agent in (1, 2, 3):
        assert sandbox.of(agent) == [*PHASES, "start 0", "finish done", "close"]


def test_phase_begins_when_all_have_ended_the_one_before(sandbox: Sandbox) -> None:
    sandbox.fly("agents.3.plants.body.pauses=3")
    order = [what for _, what in sandbox.entries]
    for before, after in zip(PHASES, [*PHASES[1:], "start 0"], strict=True):
        assert max(i for i, what in enumerate(order) if what == before) < order.index(after)


def test_time_of_the_run_begins_at_zero_however_long_the_phases_took(sandbox: Sandbox) -> None:
    quick, slow = sandbox.fly(), sandbox.fly("plants.body.pauses=7")
    assert slow.digest == quick.digest
    np.testing.assert_array_equal(slow.agents[1].sensed, np.arange(5) * 0.2)


@pytest.mark.parametrize("phase", PHASES)
def test_if_one_agent_cannot_continue_all_stop_and_armed_ones_land(sandbox: Sandbox, phase: str) -> None:
    words = phase.replace("_", " ")
    with pytest.raises(PlantError, match=rf"^agent 3: {words}: RuntimeError: no \(body\.py:\d+\)$"):
        sandbox.fly(f"agents.3.plants.body.fails='{phase}'")
    for agent in (1, 2, 3):
        told = sandbox.of(agent)
        assert told[: PHASES.index(phase) + 1] == PHASES[: PHASES.index(phase) + 1]
        assert not set(told) & {*PHASES[PHASES.index(phase) + 1 :], "start 0"}
    landed = {agent for agent, what in sandbox.entries if what == "finish failed"}
    assert landed == ({3} | landed if phase in PHASES[2:] else set())


def test_failed_landing_after_a_failure_is_reported(sandbox: Sandbox) -> None:
    no = r"RuntimeError: no \(body\.py:\d+\)"
    with pytest.raises(PlantError, match=rf"^agent 3: settle: {no}; then agent 3: finish: {no}$"):
        sandbox.fly("agents.3.plants.body.fails='settle,finish failed'")


def test_problem_found_by_the_inspection_keeps_the_fleet_on_the_ground(sandbox: Sandbox) -> None:
    text = r"^agent 2: not ready to fly: battery 3\.92 V: at least 3\.5 V is needed$"
    with pytest.raises(PlantError, match=text):
        sandbox.fly("agents.2.plants.body.fails='checks'")
    assert {what for _, what in sandbox.entries} == {"prepare", "inspect", "close"}


def test_results_of_the_inspection_are_in_the_log(sandbox: Sandbox) -> None:
    run = sandbox.fly()
    (event,) = (event for event in run.agents[1].events if event["event"] == "inspected")
    assert event["checks"] == [["battery", "3.92 V", ""], ["heading", "1 deg", ""]]


def test_agent_that_leaves_the_arena_lands_and_the_others_react_by_their_rules(sandbox: Sandbox) -> None:
    # agent 1 flies down towards (0, -1); the fence is at y = 0.5
    fence = "arena={min=[-1.5,-1.5],max=[1.5,1.5]}"
    low = ["agents.1.target=[0.0,2.0]", fence]
    run = sandbox.fly(*low, "safety.neighbour_silent.then='continue'", duration=8.0)
    assert ends(run) == {1: "landed", 2: "done", 3: "done"}
    log = run.agents[1]
    assert log.state[-1, 1] > 1.5 >= log.state[-2, 1]
    ((step, rule, then),) = alarms(run, 1)
    assert (step, rule, then) == (log.step[-1], "geofence", "land")
    assert log.end is not None
    assert re.fullmatch(
        rf"agent 1: step {step}: outside the arena: y = 1\.\d\d m, allowed -1\.5 \.\. 1\.5 m", log.end["remark"]
    )
    assert sandbox.of(1)[-2:] == ["finish landed", "close"]
    assert any("neighbour 1 is lost (it has landed)" in remark for remark in run.agents[2].remarks)
    again = sandbox.fly(*low, duration=8.0)  # by default all end
    assert ends(again) == {1: "landed", 2: "landed", 3: "landed"}
    assert again.agents[2].end is not None
    assert again.agents[2].end["remark"].endswith("neighbour 1 is lost (it has landed)")


def test_emergency_stop_reaches_the_body_before_the_flight_ends(sandbox: Sandbox) -> None:
    fence = "arena={min=[-1.5,-1.5],max=[1.5,1.5]}"
    run = sandbox.fly(
        fence,
        "agents.1.target=[0.0,2.0]",
        "safety.geofence='stop'",
        "safety.neighbour_silent.then='hold'",
        duration=8.0,
    )
    assert ends(run) == {1: "landed", 2: "done", 3: "done"}
    assert sandbox.of(1)[-3:] == ["emergency", "finish landed", "close"]
    assert run.agents[2].stopped_by[-1] == "abstained"  # it holds


def test_holding_agent_stays_where_it_is_until_the_end(sandbox: Sandbox) -> None:
    fence = "arena={min=[-1.5,-1.5],max=[1.5,1.5]}"
    run = sandbox.fly(fence, "agents.1.target=[0.0,2.0]", "safety.geofence='hold'", duration=8.0)
    assert set(ends(run).values()) == {"done"}
    log = run.agents[1]
    ((step, _, then),) = alarms(run, 1)
    assert then == "hold"
    held = [int(k) for k, word in zip(log.step, log.stopped_by, strict=True) if word == "abstained"]
    assert held == list(range(step, 40))
    np.testing.assert_allclose(log.path[-1], log.path[-5], atol=1e-9)


def test_alarm_that_is_only_logged_changes_nothing_but_the_log(sandbox: Sandbox) -> None:
    fence = "arena={min=[-1.5,-1.5],max=[1.5,1.5]}"
    free = sandbox.fly("agents.1.target=[0.0,2.0]", duration=5.0)
    watched = sandbox.fly(fence, "agents.1.target=[0.0,2.0]", "safety.geofence='log'", duration=5.0)
    assert watched.digest == free.digest
    assert [rule for _, rule, _ in alarms(watched, 1)] == ["geofence"]


def test_speed_limit_is_kept_by_clipping(sandbox: Sandbox) -> None:
    run = sandbox.fly("safety.speed={max=0.3}", duration=6.0)
    speeds = np.linalg.norm(run.agents[1].state[:, 2:], axis=1)
    assert speeds.max() == pytest.approx(0.3, abs=1e-9)
    assert ("speed", "clip") in {(rule, then) for _, rule, then in alarms(run, 1)}


def test_acceleration_limit_is_kept_by_clipping(sandbox: Sandbox) -> None:
    run = sandbox.fly("safety.acceleration={max=0.5}", duration=2.0)
    assert np.linalg.norm(run.agents[1].setpoint[:, 4:], axis=1).max() <= 0.5 * (1 + 1e-9)


def test_separation_is_checked_by_the_positions_in_messages(sandbox: Sandbox) -> None:
    rule = "safety.separation={min=1.45,then='log'}"  # neighbouring corners are 1.41 m apart
    on_path, complete = sandbox.fly(rule), sandbox.fly(rule, "topology.kind='complete'")
    texts = [[event["text"] for event in run.agents[1].events if "text" in event] for run in (on_path, complete)]
    assert texts[0] == []  # on the path 1-2-3 the only neighbour of agent 1 is agent 2, which is opposite
    assert texts[1] == ["1.414 m from agent 3, at least 1.45 m is wanted"]


def test_steps_late_in_a_row_make_an_agent_hold(sandbox: Sandbox) -> None:
    slow = ["exchange.compute_time=0.07", "safety.missed_deadlines={in_a_row=3,then='hold'}"]
    run = sandbox.fly(*slow, duration=3.0)
    assert alarms(run, 2)[0] == (2, "missed_deadlines", "hold")
    assert set(run.agents[2].stopped_by[3:]) == {"abstained"}


def test_late_step_ends_the_flight_if_the_fleet_says_so(sandbox: Sandbox) -> None:
    run = sandbox.fly("exchange.compute_time=0.07", "exchange.late='land'", duration=3.0)
    assert set(ends(run).values()) == {"landed"}
    assert run.agents[1].end is not None
    assert run.agents[1].end["remark"] == "agent 1: step 0: the step overran, and exchange.late says land"


NAN = """\
import numpy as np


def lost(problem, me):
    inbox = yield {"x": 0.0}, 1.0
    step = me.recall("step", 0)
    return me.result(problem.start(me.last) * (np.nan if me.id == 2 and step == 3 else 1.0), step=step + 1)
"""


@pytest.mark.parametrize("then", ["hold", "stop"])
def test_decision_that_is_not_finite_never_reaches_the_body(sandbox: Sandbox, tmp_path: Path, then: str) -> None:
    (tmp_path / "nan.py").write_text(NAN)
    changes = [
        "algorithm.kind='./nan.py:lost'",
        f"safety.not_finite='{then}'",
        "safety.neighbour_silent.then='continue'",
    ]
    run = sandbox.fly(*changes, duration=2.0)
    log = run.agents[2]
    assert alarms(run, 2) == [(3, "not_finite", then)]
    assert np.isnan(log.setpoint[3, 4:]).all()  # it holds
    assert np.isfinite(log.state).all()
    assert ends(run)[2] == ("done" if then == "hold" else "landed")
