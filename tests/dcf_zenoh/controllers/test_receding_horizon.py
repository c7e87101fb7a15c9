from collections.abc import Generator, Mapping
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, Me
from dcf_zenoh.controllers.controller import Decision
from dcf_zenoh.controllers.receding_horizon import RecedingHorizon
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.plugins.schema import accepted
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.testing import converse, fleet_of
from tests.support.closed_loop import fly

PAIR = Graph.of((1, 2), [(1, 2), (2, 1)])
PLAN = np.arange(6.0) / 10


def planned(_problem: object, me: Me) -> Dialogue[Any]:
    while not (yield {"x": 1.0}, 0.0).stop:
        pass
    return me.result(PLAN)


class Plain:
    """A problem without signs that does not handle lost agents; it keeps its arguments."""

    def __init__(self) -> None:
        self.told: Mapping[int, Array] = {}

    def at(self, states: Mapping[int, Array]) -> "Plain":
        self.told = states
        return self

    def setpoint(self, decision: Array, stage: int) -> Setpoint | None:
        return Setpoint(acceleration=decision[2 * stage : 2 * stage + 2]) if stage < 3 else None


def end(dialogue: Generator[Any, Inbox, Decision], inbox: Inbox) -> Decision:
    with pytest.raises(StopIteration) as finished:
        dialogue.send(inbox)
    decision: Decision = finished.value.value
    return decision


def test_after_the_plan_is_flown_its_next_stages_are() -> None:
    problem = PositionSwap(1, (1, 2), 0.2, target=(1.0, 0.0))
    controller = RecedingHorizon(problem, planned, fleet_of(PAIR)[1], 0.2)
    dialogue = controller.control(State(np.zeros(2), np.zeros(2)), 0)
    table, _ = next(dialogue)
    other = {"ids": np.array([2]), "states": np.array([[0.0, 1.0, 0.0, 0.0]])}
    dialogue.send(Inbox(table, {2: other}, stop=False))  # type: ignore[arg-type]
    decision = end(dialogue, Inbox({}, {2: {}}, stop=True))
    flown = [decision.setpoint, controller.next_of_plan(), controller.next_of_plan()]
    np.testing.assert_array_equal([each.acceleration for each in flown if each], PLAN.reshape(3, 2))
    assert controller.next_of_plan() is None  # the plan is used up


def test_flooding_that_does_not_reach_all_gives_no_setpoint() -> None:
    controller = RecedingHorizon(Plain(), planned, fleet_of(PAIR)[1], 0.2)
    dialogue = controller.control(State(np.zeros(2), np.zeros(2)), 0)
    table, _ = next(dialogue)
    decision = end(dialogue, Inbox(table, {}, stop=False, missing=(2,)))  # type: ignore[arg-type]
    assert decision.setpoint is None
    assert decision.notes == {"unknown_agents": 1}


def test_value_of_an_earlier_version_is_refused_with_its_present_name() -> None:
    _, errors = accepted(RecedingHorizon).convert({"sharing": "ride"})
    assert errors == {"sharing": "expected 'flood' or 'piggyback', not 'ride'; it is called 'piggyback' now"}


@pytest.mark.parametrize("sharing", ["flood", "piggyback"])
def test_the_problem_starts_from_where_the_body_will_be(sharing: Any) -> None:
    fleet, problems = fleet_of(PAIR), {1: Plain(), 2: Plain()}
    controllers = {
        i: RecedingHorizon(problems[i], planned, fleet[i], 0.2, sharing=sharing, predict_delay=0.2) for i in (1, 2)
    }
    state = State(np.array([1.0, 2.0]), np.array([0.5, 0.0]))
    for step in (0, 1):
        converse({i: each.control(state, step) for i, each in controllers.items()}, fleet, 4)
        x, vx, ay = (1.1, 0.5, 0.0) if step == 0 else (1.1, 0.5, 0.1)  # of PLAN, the first stage is (0, 0.1)
        for told in (problems[1].told, problems[2].told):
            for agent in (1, 2):
                np.testing.assert_allclose(told[agent], [x, 2.0 + 0.02 * ay, vx, 0.2 * ay])
    controllers[1].next_of_plan()  # (0.2, 0.3) is flown now
    converse({i: each.control(state, 2) for i, each in controllers.items()}, fleet, 4)
    np.testing.assert_allclose(problems[2].told[1], [1.1 + 0.02 * 0.2, 2.0 + 0.02 * 0.3, 0.5 + 0.2 * 0.2, 0.2 * 0.3])


def test_a_problem_that_does_not_handle_lost_agents_gets_their_last_positions() -> None:
    fleet, problems = fleet_of(PAIR), {1: Plain(), 2: Plain()}
    controllers = {i: RecedingHorizon(problems[i], planned, fleet[i], 0.2, sharing="piggyback") for i in (1, 2)}
    state = State(np.array([1.0, 2.0]), np.array([0.5, 0.0]))
    for step, lost in ((0, 0), (3, 0), (4, 1)):
        links = (lambda *_: 0) if step == 0 else (lambda *_: None)
        decisions = converse({i: each.control(state, step) for i, each in controllers.items()}, fleet, 20, links=links)
        assert decisions[1].notes == {
            "predicted": 1 - lost if step else 0, "lost_agents": lost, "sign_disagreements": 0,
        }  # fmt: skip
        assert decisions[1].setpoint is not None
    np.testing.assert_array_equal(problems[1].told[2], [1.0, 2.0, 0.0, 0.0])


def test_without_any_state_of_the_others_there_is_no_setpoint() -> None:
    fleet = fleet_of(PAIR)
    controllers = {i: RecedingHorizon(Plain(), planned, fleet[i], 0.2, sharing="piggyback") for i in (1, 2)}
    state = State(np.zeros(2), np.zeros(2))
    dialogues = {i: each.control(state, 0) for i, each in controllers.items()}
    for decision in converse(dialogues, fleet, 10, links=lambda *_: None).values():
        assert decision.setpoint is None
        assert decision.notes == {"unknown_agents": 1}


@pytest.mark.parametrize("option", ["predict_delay", "lost_after"])
def test_times_below_zero_are_refused(option: str) -> None:
    with pytest.raises(ValueError, match=f"{option} must be a time >= 0, in s, not -0.1"):
        RecedingHorizon(Plain(), planned, fleet_of(PAIR)[1], 0.2, **{option: -0.1})  # type: ignore[arg-type]


# tests/system/test_robust_swap.py flies many seeds in the simulator; here is what it does not fly.


@pytest.mark.parametrize("begin", [15, pytest.param(20, marks=pytest.mark.large)])
@pytest.mark.parametrize("steps", [3, 5])  # 1 s is longer than it takes to count as lost
def test_a_fleet_that_falls_apart_for_a_while_keeps_its_distance(steps: int, begin: int) -> None:
    group = {1: 0, 2: 0, 3: 1, 4: 1}
    flight = fly(
        lambda step: lambda j, i, _: None if begin <= step < begin + steps and group[j] != group[i] else 0, rounds=40
    )
    assert flight.arrival is not None
    assert flight.least_barrier > 0.1
    assert bool(flight.notes["lost_agents"]) is (steps > 3)


def test_the_others_keep_clear_of_the_last_position_of_a_lost_agent() -> None:
    flight = fly(lambda step: lambda j, i, _: None if step >= 4 and 3 in (j, i) else 0, rounds=60, stops={3: 0})
    assert flight.least_barrier > -1e-3  # agent 4 presses against 3, which stays where 4 wants to be: h goes to 0
    assert flight.notes["lost_agents"] > 100
