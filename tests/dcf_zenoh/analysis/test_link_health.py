from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from agentd.results.link_rules import export_links
from dcf_zenoh import Run
from dcf_zenoh.analysis.link_health import NETWORK, LinkHealth, absences, link_health
from dcf_zenoh.config import load
from dcf_zenoh.faults.profile import read_profile
from dcf_zenoh.rounds.receiver import Passed
from tests.support.faulty_runs import named
from tests.support.lossy_fleets import lossy

ONE = """
[[faults.rule]]
from = 1
to = 2
odd = { kind = "./named.py:Named", lost = [[3, 2], [5, 0], [5, 1]], doubled = [[4, 1]], delayed = [[6, 3]], by = 0.001 }
"""
KNOWN = """
[faults]
latency = { distribution = "uniform", low = 0.0002, high = 0.0008 }
[[faults.rule]]
from = 2
to = 3
bursts = { mean_loss = 0.2, mean_length = 4 }
"""


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return named(tmp_path_factory.mktemp("one"), ONE)


def link(run: Run, sender: int, receiver: int) -> LinkHealth:
    (found,) = (each for each in link_health(run) if (each.sender, each.receiver) == (sender, receiver))
    return found


def on_the_wall(run: Run, **values: object) -> Run:
    """The same logs, with what agent 2 recorded changed, as if the clock had been the wall clock."""
    fleet = run.fleet.model_copy(update={"time": run.fleet.time.model_copy(update={"clock": "wall"})})
    return replace(run, fleet=fleet, agents={**run.agents, 2: replace(run.agents[2], **values)})  # type: ignore[arg-type]


def without(run: Run, *places: tuple[int, int]) -> tuple[Passed, ...]:
    """What agent 2 recorded, but of some messages of agent 1: (step, round)."""
    return tuple(each for each in run.agents[2].passed if each.sender != 1 or (each.step, each.round) not in places)


def test_lost_doubled_and_delayed_messages_are_counted_by_link(one: Run) -> None:
    found = link(one, 1, 2)
    assert found.lost == {"odd": 3}
    assert [(each.step, each.round) for each in found.crossings if each.lost_by] == [(3, 2), (5, 0), (5, 1)]
    assert found.mean_burst == 1.5
    assert found.duplicates == 1
    assert found.loss == 3 / found.sent
    assert found.latency(1.0) == 0.001
    assert found.latency(0.5) == 0.0
    assert np.nonzero(found.per_step[:, 1])[0].tolist() == [3, 5]
    assert found.per_step[:, 0].sum() == found.sent


def test_links_are_in_order_and_those_without_faults_only_counted(one: Run) -> None:
    health = link_health(one)
    assert [(each.sender, each.receiver) for each in health] == [
        (i, j) for i in range(1, 5) for j in range(1, 5) if i != j
    ]
    bare = link(one, 3, 4)
    assert not bare.recorded
    assert bare.sent == one.agents[4].links[3][:, 0].sum() + one.agents[4].links[3][:, 2].sum()
    assert (bare.loss, bare.latency(0.5), bare.profile) == (0.0, None, None)


def test_missing_numbers_are_lost_by_the_network_on_the_wall_clock_alone(one: Run) -> None:
    run = on_the_wall(one, passed=without(one, (1, 0), (1, 1), (7, 4)))
    found = link(run, 1, 2)
    assert found.lost == {"odd": 3, NETWORK: 3}
    by_network = [(each.step, each.round) for each in found.crossings if each.lost_by == NETWORK]
    assert by_network == [(1, 0), (1, 1), (7, 4)]
    virtual = replace(run, fleet=one.fleet)
    assert NETWORK not in link(virtual, 1, 2).lost


def test_what_nobody_was_there_to_hear_was_not_lost(one: Run) -> None:
    words = tuple("abstained" if step == 4 else word for step, word in enumerate(one.agents[2].stopped_by))
    gone = tuple(each for each in one.agents[2].passed if each.step != 4)
    assert absences(replace(one.agents[2], stopped_by=words)) == (4,)
    assert link(on_the_wall(one, passed=gone, stopped_by=words), 1, 2).lost == {"odd": 3}


def test_numbers_that_begin_anew_are_no_gap(one: Run) -> None:
    passed = one.agents[2].passed
    again = tuple(each._replace(sequence=each.sequence - 100) if each.step > 5 else each for each in passed)
    assert NETWORK not in link(on_the_wall(one, passed=again), 1, 2).lost


def test_messages_found_at_waking_up_have_no_latency_on_the_wall_clock(one: Run) -> None:
    log = one.agents[2]
    late = 500_000  # ns after the nominal begin of each step
    passed = tuple(
        each._replace(due=each.step * 200_000_000 + late - 1) if each.round == 0 and each.due >= 0 else each
        for each in log.passed
    )
    run = on_the_wall(one, passed=passed, sensed=log.sensed + late * 1e-9)
    assert np.unique(link(run, 1, 2).latencies).tolist() == [0.0, 0.001]
    assert late * 1e-9 == pytest.approx(np.unique(link(replace(run, fleet=one.fleet), 1, 2).latencies)[1], rel=1e-3)


def test_the_longest_gap_of_a_dead_link_is_the_run(tmp_path: Path) -> None:
    run = named(tmp_path, "[[faults.rule]]\nfrom = 1\nto = 2\nloss = 1.0\n", "safety.neighbour_silent.after=9.0")
    found = link(run, 1, 2)
    assert found.loss == 1.0
    assert found.longest_gap == pytest.approx(run.agents[2].acted[-1])
    assert link(run, 1, 3).longest_gap is None  # not recorded


def crashed_in_its_only_step(folder: Path, at: float) -> Run:
    """Push-sum on a directed ring, 0.5 ms for a message; agent 3 crashes in the middle of its only step."""
    text = Path(load("directed").source).read_text(encoding="utf-8")
    text = text.replace("max_rounds = 500", "max_rounds = 40\nround_timeout = 0.002")
    text += f"\n[faults]\nlatency = 0.0005\n\n[agents.3.faults]\ncrash = {{ at = {at} }}\n"
    (folder / "crash.toml").write_text(text, encoding="utf-8")
    return dcf_zenoh.simulate(folder / "crash.toml")


def test_the_longest_gap_of_a_receiver_that_crashed_in_its_first_step_counts_from_its_begin(tmp_path: Path) -> None:
    run = crashed_in_its_only_step(tmp_path, 0.0032)
    assert run.agents[3].step.tolist() == [0]
    found = link(run, 2, 3)
    came = [each.due * 1e-9 for each in found.crossings if each.due < 3_200_000]
    assert came == pytest.approx([0.0005 * number for number in range(1, 7)])
    assert found.longest_gap == pytest.approx(0.0005)


def test_a_receiver_that_crashed_before_anything_came_waited_from_the_begin_of_its_step(tmp_path: Path) -> None:
    assert link(crashed_in_its_only_step(tmp_path, 0.0004), 2, 3).longest_gap == pytest.approx(0.0004)


def test_a_link_over_which_nothing_came_on_the_wall_clock_was_silent_all_the_time(one: Run) -> None:
    passed = tuple(each for each in one.agents[2].passed if each.sender != 1)
    found = link(on_the_wall(one, passed=passed), 1, 2)
    assert (found.recorded, found.sent, found.profile) == (True, 0, None)
    assert found.longest_gap == pytest.approx(one.agents[2].acted[-1])


def test_clock_offsets_of_the_hello_are_told_on_the_wall_clock(one: Run) -> None:
    header = {**one.agents[2].header, "clock_offsets": {1: (2_000_000, 300_000)}}
    found = link(on_the_wall(one, header=header), 1, 2)
    assert found.clock_ahead == pytest.approx(2e-3)
    assert found.clock_error == pytest.approx(3e-4)
    assert link(one, 1, 2).clock_ahead is None


def test_a_recorded_network_can_be_replayed(tmp_path: Path) -> None:
    """Measure known faults, export, fly with the profile, measure again: both agree, and with the truth."""
    changes = ["time.duration=12.0"]
    first = dcf_zenoh.simulate(lossy(tmp_path, KNOWN), changes=changes)
    lines = export_links(first, link_health(first), tmp_path / "lab.json")
    assert read_profile(tmp_path / "lab.json") == tuple(each.profile for each in link_health(first))
    again = dcf_zenoh.simulate(lossy(tmp_path, lines), changes=["seed=7", *changes])
    for before, after in zip(link_health(first), link_health(again), strict=True):
        assert (before.sender, before.receiver) == (after.sender, after.receiver)
        for probability in (0.05, 0.5, 0.95):
            truth = 0.0002 + 0.0006 * probability
            assert after.latency(probability) == pytest.approx(truth, abs=5e-5)
            assert before.latency(probability) == pytest.approx(truth, abs=5e-5)
        lossy_link = (before.sender, before.receiver) == (2, 3)
        for found in (before, after):
            assert found.loss == pytest.approx(0.2 if lossy_link else 0.0, abs=0.06)
            assert found.mean_burst == pytest.approx(4.0 if lossy_link else 0.0, abs=1.0)
