from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.analysis.explanation import explain
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.spec import FaultRule
from tests.support.faulty_runs import named
from tests.support.lossy_fleets import lossy
from tests.support.own_region import fly


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Plain trades, 20 % loss: the safety region is violated."""
    folder = tmp_path_factory.mktemp("dense")
    changes = [
        "controller.kind=receding_horizon",
        "controller.sharing=piggyback",
        "safety.neighbour_silent.then=continue",
    ]
    return dcf_zenoh.simulate(
        lossy(folder, "[faults]\nloss = 0.2\n", "complete"),
        changes=["time.duration=10.0", *changes],
        out=folder / "run",
    )


def test_loss_is_found_at_the_closest_approach_and_the_replay_without_it_is_better(dense: Run) -> None:
    found = explain(dense)
    step, pair = map(int, np.unravel_index(dense.barriers.argmin(), dense.barriers.shape))
    assert found.quantity == "barrier"
    assert found.value == dense.barriers.min()
    assert found.step == step
    assert found.pair == [(i, j) for i in range(1, 5) for j in range(i + 1, 5)][pair]
    assert [each.step for each in found.before] == [step - 1, step - 2]
    assert found.disturbed
    latest = found.before[0]
    assert latest.value == dense.barriers[step - 1, pair]
    assert {(each.sender, each.receiver) for each in latest.between} == {found.pair, found.pair[::-1]}
    for each in latest.between:
        log = dense.agents[each.receiver]
        lost = [p.round for p in log.passed if (p.sender, p.step) == (each.sender, step - 1) and p.lost_by]
        assert each.lost == {"loss": tuple(lost)}
    assert [each.agent for each in latest.agents] == list(found.pair)
    assert latest.agents[0].stopped_by == dense.agents[found.pair[0]].stopped_by[step - 1]
    assert latest.agents[0].residual == dense.agents[found.pair[0]].residual[step - 1]
    assert max(each.value for each in found.alternatives) > found.value
    assert all(each.replay.agreed for each in found.alternatives)


def test_without_faults_nothing_was_lost_and_the_replay_is_the_run() -> None:
    found = explain(dcf_zenoh.simulate("position_swap", changes=["time.duration=5.0"]))
    assert not found.disturbed
    assert not found.took_time
    for each in found.alternatives:
        assert each.value == pytest.approx(found.value, abs=5e-3)


def test_one_lost_message_is_named_by_step_and_round(tmp_path: Path) -> None:
    free = named(tmp_path, "")
    i, j = explain(free).pair
    rule = f'[[faults.rule]]\nfrom = {i}\nto = {j}\nodd = {{ kind = "./named.py:Named", lost = [[8, 5]] }}\n'
    found = explain(named(tmp_path, rule))
    assert (found.step, found.pair) == (9, (i, j))
    (there,) = (each for each in found.before[0].between if each.sender == i)
    (back,) = (each for each in found.before[0].between if each.sender == j)
    assert (there.lost, back.lost) == ({"odd": (5,)}, {})
    assert not found.before[1].disturbed


def test_agents_that_are_no_neighbours_are_explained_along_the_path(tmp_path: Path) -> None:
    run = named(tmp_path, "[faults]\nloss = 0.1\n", topology="path")
    apart = replace(run, agents={i: run.agents[i] for i in (1, 4)})
    found = explain(apart)
    assert found.path == ((1, 2, 3, 4), (4, 3, 2, 1))
    assert {(each.sender, each.receiver) for each in found.before[0].between} == {(2, 1), (3, 4)}  # of those with logs


def test_an_absent_agent_is_named(tmp_path: Path) -> None:
    run = named(tmp_path, "[agents.2.faults]\ncrash = { at = 1.5 }\n", "safety.neighbour_silent.then=continue")
    found = explain(run)
    assert [each.agent for each in found.before[0].absent] == [2]
    assert "crashed at 1.5 s" in found.before[0].absent[0].remark
    assert found.disturbed


def test_payload_faults_of_any_time_in_the_steps_are_told_also_such_as_came_while_it_ran(tmp_path: Path) -> None:
    run = named(tmp_path, "")
    last = explain(run).before[0].step * run.fleet.time.sample_time

    on = {"kind": "noise", "std": 0.1}

    def noise(begin: float, end: float, fault: object) -> FaultRule:
        table = {"from": 1, "to": (2, 3), "during": (begin, end), "noise": fault}
        return FaultRule.model_validate(table)

    within, after = noise(last + 0.05, last + 0.06, on), noise(last + 0.2, last + 9.0, on)
    assert explain(run).falsified == {}
    assert explain(run, [within]).falsified == {"noise": 2}
    assert explain(run, [after]).falsified == {}
    assert explain(run, [within, noise(0.0, last + 0.1, fault=False)]).falsified == {}


def test_a_closest_approach_at_the_start_has_no_decision_before_it(tmp_path: Path) -> None:
    run = named(tmp_path, "", "time.duration=0.2")
    found = explain(run)
    assert (found.step, found.before, found.alternatives) == (0, (), ())


def test_without_plants_there_is_nothing_to_explain() -> None:
    with pytest.raises(RecordingError, match="average: there is nothing to explain: nothing moves, as no agent has a"):
        explain(dcf_zenoh.simulate("average"))


def test_without_a_safety_region_the_distance_is_explained(tmp_path: Path) -> None:
    run = fly(tmp_path, "Straight")
    found = explain(run)
    assert found.quantity == "distance"
    assert found.value == run.distances.min()
    assert found.alternatives[0].value == pytest.approx(found.value, abs=5e-3)


def test_messages_found_at_waking_up_have_no_latency_in_a_step_either(tmp_path: Path) -> None:
    """On the wall clock; what an agent finds after a pause has waited for the agent, not for the network."""
    run = named(tmp_path, "[[faults.rule]]\nfrom = 1\nto = 2\nlatency = 0.001\n")
    wall = run.fleet.model_copy(update={"time": run.fleet.time.model_copy(update={"clock": "wall"})})
    log, step = run.agents[2], explain(run).before[0].step
    woke = (step + 1) * 200_000_000
    passed = tuple(each._replace(due=woke) if each.step == step and each.round else each for each in log.passed)
    sensed = log.sensed.copy()
    sensed[step + 1] = woke * 1e-9
    found = explain(replace(run, fleet=wall, agents={**run.agents, 2: replace(log, passed=passed, sensed=sensed)}))
    (there,) = (each for each in found.before[0].links if (each.sender, each.receiver) == (1, 2))
    assert there.latency == pytest.approx(0.001)  # of the first round alone
