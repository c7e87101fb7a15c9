import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.analysis.comparison import compare
from tests.support.faulty_runs import named


def fly() -> Run:
    return dcf_zenoh.simulate("position_swap", changes=["time.duration=2.0", "log.rounds=true"])


@pytest.fixture(scope="module")
def run() -> Run:
    return fly()


def changed(run: Run, agent: int, **values: Any) -> Run:
    return replace(run, agents={**run.agents, agent: replace(run.agents[agent], **values)})


def with_entry(run: Run, agent: int, name: str, place: tuple[int, ...], value: float) -> Run:
    """`run` with one number added to."""
    array = getattr(run.agents[agent], name).copy()
    array[place] += value
    return changed(run, agent, **{name: array})


def with_round(run: Run, agent: int, step: int, round: int, change: Callable[[list[Any]], None]) -> Run:
    """`run` with one record of a round changed: payload, residual, arrivals, noted."""
    rounds = deepcopy(run.agents[agent].rounds_log)
    record = list(rounds[step][round])
    change(record)
    rounds[step][round] = tuple(record)
    return changed(run, agent, rounds_log=rounds)


def test_equal_runs_are_identical(run: Run) -> None:
    found = compare(run, fly())
    assert found.identical
    assert found.first is None
    assert str(found) == "identical"


@pytest.mark.parametrize("name", ["state", "setpoint", "decision"])
def test_one_changed_number_is_found_where_it_is(run: Run, name: str) -> None:
    found = compare(run, with_entry(run, 3, name, (4, 1), 1e-6))
    assert not found.identical
    assert found.first is not None
    assert (found.first.quantity, found.first.agent, found.first.step, found.first.round) == (name, 3, 4, None)
    assert found.first.size == pytest.approx(1e-6, rel=1e-6)
    assert list(found.largest.values()) == [found.first]
    assert str(found) == (
        f"agent 3 differs first: step 4 (0.8 s), {name}: 1e-06; largest deviations: {name} 1e-06 (agent 3, step 4)"
    )


def test_a_changed_payload_is_found_in_its_round(run: Run) -> None:
    def change(record: list[Any]) -> None:
        record[0]["lam"][2] += 1e-3

    first = compare(run, with_round(run, 2, 4, 5, change)).first
    assert first is not None
    assert (first.quantity, first.agent, first.step, first.round) == ("lam", 2, 4, 5)
    assert first.size == pytest.approx(1e-3)


def test_a_changed_residual_or_note_of_a_round_is_found(run: Run) -> None:
    def residual(record: list[Any]) -> None:
        record[1] += 0.5

    def noted(record: list[Any]) -> None:
        record[3]["u"][0] += 0.5

    for change, quantity in ((residual, "residual"), (noted, "u")):
        first = compare(run, with_round(run, 1, 0, 3, change)).first
        assert first is not None
        assert (first.quantity, first.step, first.round) == (quantity, 0, 3)


def test_when_messages_arrived_makes_no_difference(run: Run) -> None:
    def change(record: list[Any]) -> None:
        record[2] = {j: due + 1 for j, due in record[2].items()}

    later = with_round(run, 1, 0, 3, change)
    slower = changed(later, 2, compute=run.agents[2].compute * 2, acted=run.agents[2].acted + 0.01)
    assert str(compare(run, slower)) == "identical"


def test_rounds_are_compared_only_where_both_runs_have_logged_them(run: Run) -> None:
    silent = changed(run, 1, rounds_log=tuple([] for _ in run.agents[1].step))
    assert compare(run, silent).identical


def test_payloads_for_single_neighbours_are_named_by_receiver(run: Run) -> None:
    def edges(x: float) -> Run:
        def change(record: list[Any]) -> None:
            record[0] = {2: {"x": [1.0]}, 3: {"x": [x]}}

        return with_round(run, 1, 0, 1, change)

    first = compare(edges(2.0), edges(2.5)).first
    assert first is not None
    assert (first.quantity, first.size) == ("x to 3", 0.5)


def test_the_first_is_by_step_then_agent_and_the_largest_is_over_all(run: Run) -> None:
    other = with_entry(run, 4, "state", (2, 0), 1e-9)
    other = with_entry(other, 1, "state", (3, 0), 2e-9)
    other = with_entry(other, 3, "state", (2, 0), 1e-9)
    found = compare(run, other)
    assert found.first is not None
    assert (found.first.step, found.first.agent) == (2, 3)
    assert (found.largest["state"].step, found.largest["state"].agent) == (3, 1)


def test_within_a_step_the_cause_comes_before_its_effects(run: Run) -> None:
    def change(record: list[Any]) -> None:
        record[0]["lam"][0] += 1.0

    other = with_entry(with_entry(run, 2, "setpoint", (4, 0), 1.0), 2, "decision", (4, 0), 1.0)
    first = compare(run, with_round(other, 2, 4, 5, change)).first
    assert first is not None
    assert first.quantity == "lam"


def test_deviations_up_to_the_tolerance_do_not_count_but_are_told(run: Run) -> None:
    other = with_entry(run, 3, "state", (4, 1), 1e-9)
    found = compare(run, other, tolerance=1e-8)
    assert found.identical
    assert str(found) == "identical within 1e-08; largest deviations: state 1e-09 (agent 3, step 4)"
    assert str(compare(run, run, tolerance=1e-8)) == "identical"


def test_what_is_not_a_number_is_equal_to_itself_alone(run: Run) -> None:
    resting = with_entry(run, 1, "setpoint", (2, 5), math.nan)
    assert compare(resting, resting).identical
    assert compare(
        with_entry(run, 1, "residual", (2,), math.inf), with_entry(run, 1, "residual", (2,), math.inf)
    ).identical
    found = compare(run, resting)
    assert found.first is not None
    assert found.first.size == math.inf
    assert str(found).startswith("agent 1 differs first: step 2 (0.4 s), setpoint: a number in one run only;")


def test_arrays_of_different_sizes_differ(run: Run) -> None:
    taller = changed(run, 1, state=np.pad(run.agents[1].state, ((0, 0), (0, 2))))
    first = compare(run, taller).first
    assert first is not None
    assert (first.quantity, first.step) == ("state", 0)


def test_a_different_number_of_rounds_is_told_in_rounds(run: Run) -> None:
    assert str(compare(run, with_entry(run, 1, "rounds", (3,), 7))).startswith(
        "agent 1 differs first: step 3 (0.6 s), rounds: 7;"
    )


def test_a_shorter_run_differs_where_it_ends(run: Run) -> None:
    shorter = dcf_zenoh.simulate("position_swap", changes=["time.duration=1.4", "log.rounds=true"])
    for found in (compare(run, shorter), compare(shorter, run)):
        assert str(found).startswith("agent 1 differs first: step 7 (1.4 s), number of steps: 3 more in one run;")


def test_runs_of_different_agents_are_not_comparable(run: Run) -> None:
    fewer = replace(run, agents={i: run.agents[i] for i in (1, 2)})
    found = compare(run, fewer)
    assert not found.identical
    assert str(found) == (
        "not comparable: position_swap (agents 1, 2, 3, 4) and position_swap (agents 1, 2)"
        " have logs of different agents"
    )


def test_different_fleets_with_the_same_agents_are_compared_all_the_same(run: Run) -> None:
    renamed = replace(run, fleet=run.fleet.model_copy(update={"name": "other"}))
    assert str(compare(run, renamed)) == "different fleets: position_swap and other; identical"


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Run]:
    """Ten steps in which the link from 1 to 2 does what is named."""
    folder = tmp_path_factory.mktemp("faulty")

    def fly_with(keys: str) -> Run:
        rule = f'[[faults.rule]]\nfrom = 1\nto = 2\nodd = {{ kind = "./named.py:Named", {keys} }}\n'
        return named(folder, rule)

    return fly_with


def test_a_message_lost_in_one_run_only_is_where_they_first_differ(faulty: Callable[[str], Run]) -> None:
    one, other = faulty("lost = [[2, 4], [3, 7]]"), faulty("lost = [[2, 4], [3, 9]]")
    assert str(compare(one, other)).startswith(
        "agent 2 differs first: step 3 (0.6 s), round 7, message from 1: lost or doubled in one run only;"
    )
    assert compare(one, faulty("lost = [[2, 4], [3, 7]]")).identical


def test_a_message_that_was_delayed_by_another_time_differs_by_it(faulty: Callable[[str], Run]) -> None:
    one, other = (faulty(f"delayed = [[3, 5]], by = {by}") for by in (0.0005, 0.0007))
    first = compare(one, other).first
    assert first is not None
    assert (first.quantity, first.agent, first.step, first.round) == ("message from 1", 2, 3, 5)
    assert first.size == pytest.approx(0.0002)
    assert "message from 1: 0.0002 s" in str(compare(one, other))


def test_a_copy_is_a_difference_although_nobody_notices_it(faulty: Callable[[str], Run]) -> None:
    one, other = faulty("doubled = [[4, 1]]"), faulty("doubled = []")
    assert one.digest == other.digest
    first = compare(one, other).first
    assert first is not None
    assert (first.quantity, first.step, first.round) == ("message from 1", 4, 1)


def test_a_loss_differs_from_a_run_without_faults(faulty: Callable[[str], Run]) -> None:
    one = faulty("lost = [[3, 7]]")
    bare = replace(one, agents={i: replace(log, passed=()) for i, log in one.agents.items()})
    first = compare(bare, one).first
    assert first is not None
    assert (first.quantity, first.step, first.round) == ("message from 1", 3, 7)


def test_on_the_wall_clock_messages_are_not_compared(faulty: Callable[[str], Run]) -> None:
    one = faulty("lost = [[3, 7]]")
    bare = replace(one, agents={i: replace(log, passed=()) for i, log in one.agents.items()})
    wall = one.fleet.model_copy(update={"time": one.fleet.time.model_copy(update={"clock": "wall"})})
    assert compare(replace(bare, fleet=wall), replace(one, fleet=wall)).identical
