from collections.abc import Mapping

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Dialogue
from dcf_zenoh.controllers.fleet_states import ROUNDS_PER_HOP, FleetStates, FleetView
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.testing import Delay, converse, fleet_of, in_time

AGENTS = (1, 2, 3)
COMPLETE = Graph.of(AGENTS, [(i, j) for i in AGENTS for j in AGENTS if i != j])
PATH = Graph.of(AGENTS, [(1, 2), (2, 1), (2, 3), (3, 2)])
SAMPLE_TIME = 0.2  # s


def team(graph: Graph = COMPLETE, *, has_signs: bool = True) -> dict[int, FleetStates]:
    problem = {i: PositionSwap(i, AGENTS, SAMPLE_TIME, target=(0.0, 0.0)) if has_signs else object() for i in AGENTS}
    return {i: FleetStates(me, problem[i], SAMPLE_TIME, 0.6) for i, me in fleet_of(graph).items()}


def silent(*agents: int) -> Delay:
    """Links that lose every message from or to `agents`."""
    return lambda j, i, _round: None if j in agents or i in agents else 0


def share(
    fleet: Mapping[int, FleetStates],
    states: Mapping[int, Array],
    step: int,
    links: Delay = in_time,
    graph: Graph = COMPLETE,
) -> dict[int, FleetView | None]:
    """One step in which the agents share states and then send nothing but tables for some rounds."""

    def dialogue(i: int) -> Dialogue[FleetView | None]:
        view = yield from fleet[i].share(states[i], step)
        while view is not None and (yield from fleet[i].piggyback.tables_only()):
            pass
        return view

    return converse({i: dialogue(i) for i in fleet}, fleet_of(graph), 12, links=links)


def at(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Array:
    return np.array([x, y, vx, vy])


APART = {1: at(0, 1), 2: at(0.5, -1, 1.0), 3: at(-1, 0)}


@pytest.mark.parametrize("graph", [COMPLETE, PATH])
def test_without_losses_all_have_the_measured_states(graph: Graph) -> None:
    for view in share(team(graph), APART, 4, graph=graph).values():
        assert view is not None
        assert (view.lost, view.predicted) == ((), 0)
        for i, state in APART.items():
            np.testing.assert_array_equal(view.states[i], state)


def test_a_missing_state_is_predicted_and_in_the_end_the_agent_is_lost() -> None:
    fleet = team()
    share(fleet, APART, 0)
    for step in (1, 2, 3):
        view = share(fleet, APART, step, silent(2))[1]
        assert view is not None
        assert (view.lost, view.predicted) == ((), 1)
        np.testing.assert_allclose(view.states[2], [0.5 + step * SAMPLE_TIME, -1, 1, 0])
        np.testing.assert_array_equal(view.states[3], APART[3])
    view = share(fleet, APART, 4, silent(2))[1]
    assert view is not None
    assert (view.lost, view.predicted) == ((2,), 0)
    np.testing.assert_allclose(view.states[2], [0.5, -1, 0, 0])  # its last position, at rest
    assert set(view.signs) == {(1, 3)}
    back = share(fleet, APART, 5)[1]
    assert back is not None
    assert back.lost == ()


def test_there_is_no_view_while_an_agent_is_unknown() -> None:
    fleet = team()
    assert share(fleet, APART, 0, silent(2))[1] is None
    assert fleet[1].unknown == [2]


def test_the_first_exchange_lasts_until_all_are_known() -> None:
    late: Delay = lambda j, _i, round: 0 if j != 3 or round >= 9 else None  # noqa: E731
    for view in share(team(), APART, 0, late).values():
        assert view is not None


def test_it_waits_for_the_states_of_its_step() -> None:
    fleet = team()
    share(fleet, APART, 0)
    last = ROUNDS_PER_HOP * 2
    just: Delay = lambda _j, _i, round: 0 if round >= last - 1 else None  # noqa: E731
    over: Delay = lambda _j, _i, round: 0 if round >= last else None  # noqa: E731
    assert [view.predicted for view in share(fleet, APART, 1, just).values() if view] == [0, 0, 0]
    assert [view.predicted for view in share(fleet, APART, 2, over).values() if view] == [2, 2, 2]


def test_without_the_states_an_agent_takes_the_choice_of_the_lower_id() -> None:
    fleet = team()
    share(fleet, APART, 0)
    moved = {**APART, 1: at(1.0, 1.0)}  # to the other side of 2: the sign in x changes
    one_way = share(fleet, moved, 1, lambda j, i, _: None if j == 1 else 0)
    assert one_way[1] is not None
    np.testing.assert_array_equal(one_way[1].signs[1, 2], [1, 1])  # measured
    assert one_way[2] is not None
    np.testing.assert_array_equal(one_way[2].signs[1, 2], [-1, 1])  # of the step before


def test_a_disagreement_is_counted_by_the_higher_id_once_it_receives_it() -> None:
    fleet = team()
    share(fleet, APART, 0)
    moved = {**APART, 1: at(1.0, 1.0)}
    late: Delay = lambda j, _i, round: 0 if j != 1 or round >= ROUNDS_PER_HOP * 2 else None  # noqa: E731
    views = share(fleet, moved, 1, late)
    counts = {i: fleet[i].disagreements(view, 1) for i, view in views.items() if view}
    assert counts == {1: 0, 2: 1, 3: 0}  # of 1 and 3 no sign changes


def test_a_fresh_agent_learns_the_choices_that_it_made_before_it_crashed() -> None:
    fleet = team()
    states = {1: at(0.0, 1.0), 2: at(0.0, -1.0), 3: at(-1.0, 0.0)}
    share(fleet, states, 0)
    fleet[1] = team()[1]
    for view in share(fleet, states, 1).values():
        assert view is not None
    views = share(fleet, {**states, 1: at(-0.3, 1.0)}, 2)
    assert views[1] is not None
    assert views[2] is not None
    np.testing.assert_array_equal(views[1].signs[1, 2], views[2].signs[1, 2])


def test_a_problem_without_signs_has_none() -> None:
    for view in share(team(has_signs=False), APART, 0).values():
        assert view is not None
        assert view.signs == {}
