from collections.abc import Mapping

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Dialogue
from dcf_zenoh.controllers.fleet_states import PATIENCE, FleetStates, Sight
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.testing import Delay, converse, fleet_of, in_time

AGENTS = (1, 2, 3)
COMPLETE = Graph.of(AGENTS, [(i, j) for i in AGENTS for j in AGENTS if i != j])
PATH = Graph.of(AGENTS, [(1, 2), (2, 1), (2, 3), (3, 2)])
SAMPLE_TIME = 0.2  # s


def team(graph: Graph = COMPLETE, *, signed: bool = True) -> dict[int, FleetStates]:
    problem = {i: PositionSwap(i, AGENTS, SAMPLE_TIME, target=(0.0, 0.0)) if signed else object() for i in AGENTS}
    return {i: FleetStates(me, problem[i], SAMPLE_TIME, 0.6) for i, me in fleet_of(graph).items()}


def silent(*agents: int) -> Delay:
    """Links of which nothing that is from or to `agents` arrives."""
    return lambda j, i, _round: None if j in agents or i in agents else 0


def meet(
    others: Mapping[int, FleetStates],
    states: Mapping[int, Array],
    step: int,
    links: Delay = in_time,
    graph: Graph = COMPLETE,
) -> dict[int, Sight | None]:
    """One step in which the agents meet and then say nothing but tables for some rounds."""

    def dialogue(i: int) -> Dialogue[Sight | None]:
        sight = yield from others[i].meet(states[i], step)
        while sight is not None and (yield from others[i].carrier.alone()):
            pass
        return sight

    return converse({i: dialogue(i) for i in others}, fleet_of(graph), 12, links=links)


def at(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Array:
    return np.array([x, y, vx, vy])


APART = {1: at(0, 1), 2: at(0.5, -1, 1.0), 3: at(-1, 0)}


@pytest.mark.parametrize("graph", [COMPLETE, PATH])
def test_without_losses_all_see_what_was_measured(graph: Graph) -> None:
    for sight in meet(team(graph), APART, 4, graph=graph).values():
        assert sight is not None
        assert (sight.lost, sight.predicted) == ((), 0)
        for i, state in APART.items():
            np.testing.assert_array_equal(sight.states[i], state)


def test_a_state_that_does_not_come_is_predicted_and_in_the_end_the_agent_is_lost() -> None:
    others = team()
    meet(others, APART, 0)
    for step in (1, 2, 3):
        sight = meet(others, APART, step, silent(2))[1]
        assert sight is not None
        assert (sight.lost, sight.predicted) == ((), 1)
        np.testing.assert_allclose(sight.states[2], [0.5 + step * SAMPLE_TIME, -1, 1, 0])
        np.testing.assert_array_equal(sight.states[3], APART[3])
    sight = meet(others, APART, 4, silent(2))[1]
    assert sight is not None
    assert (sight.lost, sight.predicted) == ((2,), 0)
    np.testing.assert_allclose(sight.states[2], [0.5, -1, 0, 0])  # its last position, at rest
    assert set(sight.signs) == {(1, 3)}
    back = meet(others, APART, 5)[1]
    assert back is not None
    assert back.lost == ()


def test_an_agent_that_was_never_heard_leaves_nothing_to_go_by() -> None:
    others = team()
    assert meet(others, APART, 0, silent(2))[1] is None
    assert others[1].unknown == [2]


def test_the_first_meeting_lasts_until_all_are_known() -> None:
    late: Delay = lambda j, _i, round: 0 if j != 3 or round >= 9 else None  # noqa: E731
    for sight in meet(team(), APART, 0, late).values():
        assert sight is not None


def test_a_meeting_waits_with_patience_for_the_states_of_its_step() -> None:
    others = team()
    meet(others, APART, 0)
    patience = PATIENCE * 2
    just: Delay = lambda _j, _i, round: 0 if round >= patience - 1 else None  # noqa: E731
    over: Delay = lambda _j, _i, round: 0 if round >= patience else None  # noqa: E731
    assert [sight.predicted for sight in meet(others, APART, 1, just).values() if sight] == [0, 0, 0]
    assert [sight.predicted for sight in meet(others, APART, 2, over).values() if sight] == [2, 2, 2]


def test_who_does_not_hear_the_states_goes_by_the_choice_of_the_lower_id() -> None:
    others = team()
    meet(others, APART, 0)
    moved = {**APART, 1: at(1.0, 1.0)}  # to the other side of 2: the sign in x changes
    heard_by_one = meet(others, moved, 1, lambda j, i, _: None if j == 1 else 0)
    assert heard_by_one[1] is not None
    np.testing.assert_array_equal(heard_by_one[1].signs[1, 2], [1, 1])  # measured
    assert heard_by_one[2] is not None
    np.testing.assert_array_equal(heard_by_one[2].signs[1, 2], [-1, 1])  # of the step before


def test_a_disagreement_is_counted_by_the_higher_id_once_it_hears_of_it() -> None:
    others = team()
    meet(others, APART, 0)
    moved = {**APART, 1: at(1.0, 1.0)}
    late: Delay = lambda j, _i, round: 0 if j != 1 or round >= PATIENCE * 2 else None  # noqa: E731
    sights = meet(others, moved, 1, late)
    counts = {i: others[i].disagreements(sight, 1) for i, sight in sights.items() if sight}
    assert counts == {1: 0, 2: 1, 3: 0}  # of 1 and 3 no sign changes


def test_a_fresh_agent_learns_the_choices_that_it_made_before_it_crashed() -> None:
    others = team()
    states = {1: at(0.0, 1.0), 2: at(0.0, -1.0), 3: at(-1.0, 0.0)}
    meet(others, states, 0)
    others[1] = team()[1]
    for sight in meet(others, states, 1).values():
        assert sight is not None
    sights = meet(others, {**states, 1: at(-0.3, 1.0)}, 2)
    assert sights[1] is not None
    assert sights[2] is not None
    np.testing.assert_array_equal(sights[1].signs[1, 2], sights[2].signs[1, 2])


def test_a_problem_without_signs_has_none() -> None:
    for sight in meet(team(signed=False), APART, 0).values():
        assert sight is not None
        assert sight.signs == {}
