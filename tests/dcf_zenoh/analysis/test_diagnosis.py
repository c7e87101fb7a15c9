"""Why steps ended as they did, in plain words, with the setting that would change it."""

from io import StringIO

import pytest
from rich.console import Console

import dcf_zenoh
from agentd.results.summary import summary_table
from dcf_zenoh import Run

LOSSY = ("exchange.round_timeout=0.003", "exchange.max_rounds=40", "faults.loss=0.2", "time.duration=4")


def fly(*changes: str, fleet: str = "position_swap") -> Run:
    return dcf_zenoh.simulate(fleet, changes=["time.duration=3", *changes])


@pytest.fixture(scope="module")
def flooded() -> Run:
    return fly(*LOSSY)


def test_a_flood_of_states_over_a_lossy_network_is_named_with_its_remedy(flooded: Run) -> None:
    lacking = sum(each.get("unknown_agents", 0) > 0 for log in flooded.agents.values() for each in log.notes)
    assert 0.3 * 80 < lacking < 0.7 * 80  # three messages of which each is lost by 20 %
    assert flooded.endings["states"] == lacking
    first = flooded.diagnosis[0]
    assert first.kind == "states"
    assert first.text.startswith(f"states were missing in {lacking} of 80 agent-steps")
    assert "controller.sharing = 'flood' bears no loss" in first.text
    key, value = first.remedy.removeprefix("--set ").split("=")
    cured = fly(*LOSSY, f"{key}={value}")
    assert "states" not in {each.kind for each in cured.diagnosis}
    assert "states" not in cured.endings


def test_the_summary_tells_it_and_how_far_from_agreement_steps_ended(flooded: Run) -> None:
    out = StringIO()
    Console(file=out, width=400).print(summary_table(flooded.summary()))
    text = out.getvalue()
    assert "without the states of all agents" in text
    assert "own accord" not in text
    assert "try --set controller.sharing=piggyback" in text
    rounds = next(each for each in flooded.diagnosis if each.kind == "rounds")
    assert "with a residual of 0.0" in rounds.text
    assert "wanted is less than 0.001" in rounds.text


def test_latency_that_leaves_no_time_is_told_from_a_link_that_loses() -> None:
    slow = fly("faults.latency=0.02")
    assert [each.kind for each in slow.diagnosis] == ["time"]
    assert slow.diagnosis[0].text.startswith("rounds took 1")
    assert "by the latency of the links" in slow.diagnosis[0].text
    waits = fly("faults.rule=[{from=2,to=1,loss=0.2}]", "exchange.round_timeout=0.05", "controller.sharing=piggyback")
    assert waits.diagnosis[0].text.startswith("messages were missing or late in ")
    assert waits.diagnosis[0].text.endswith("(from 2 to 1)")
    assert waits.diagnosis[0].remedy == "a shorter exchange.round_timeout"


def test_computation_that_takes_the_step_is_blamed_on_its_agent() -> None:
    busy = fly("exchange.compute_time=0.01", "agents.3.faults.slow.factor=8", "controller.sharing=piggyback")
    assert [each.kind for each in busy.diagnosis] == ["time"]
    assert busy.diagnosis[0].text.startswith("computation took most of the step in ")


def test_a_remedy_of_more_rounds_is_one_that_fits_and_helps() -> None:
    short = dcf_zenoh.simulate("average", changes=["exchange.max_rounds=5"])
    (found,) = short.diagnosis
    assert found.text.startswith("5 of 5 agent-steps ended after exchange.max_rounds = 5 rounds without agreement")
    cured = dcf_zenoh.simulate("average", changes=[found.remedy.removeprefix("--set ")])
    assert min(log.residual[-1] for log in cured.agents.values()) < 1e-3 * short.agents[1].residual[-1]


@pytest.mark.parametrize("fleet", ["position_swap", "position_swap_async", "average", "lasso"])
def test_a_run_in_which_all_is_well_has_no_diagnosis(fleet: str) -> None:
    assert fly(fleet=fleet).diagnosis == ()
