"""Predictive control by ADMM agrees with the central solution: in one control step, and in all of a flight."""

from collections.abc import Mapping
from functools import partial
from typing import cast

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.algorithms.admm_mpc import admm_mpc
from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.analysis.oracle import consult
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.position_swap import PositionSwap, SwapGame
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.swap_options import DiamondOptions
from dcf_zenoh.testing import fleet_of, lockstep, lossy
from tests.support.answers import AGENTS, TOPOLOGIES, cournot, course, each, graph, quadratic
from tests.support.references import Reference
from tests.support.swaps import SAMPLE_TIME, moment
from topologies.ring import ring

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

POTENTIAL = ("n4_complete_start", "n4_line_agg", "n4_star_boxactive")


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("name", POTENTIAL)
def test_the_equilibrium_of_one_step_is_found_at_a_linear_rate(name: str, topology: str) -> None:
    reference = Reference.read(name)
    answers = {i: reference.expected("u_star", i) for i in reference.agents}
    found = course(admm_mpc, reference.games, graph(topology, reference.agents), answers, 300)
    assert found.error < 1e-7
    assert found.errors[100] < 1e-3  # the default threshold
    assert 0.7 < found.rate < 0.965
    assert found.straightness < -0.95


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("seed", range(3))
def test_random_moments_of_a_swap_agree_with_the_central_solution(seed: int, topology: str) -> None:
    games, answers = moment(seed, AGENTS)
    assert course(admm_mpc, games, graph(topology), answers, 400).error < 1e-7


@pytest.mark.parametrize("seed", range(2))
def test_six_agents_agree_with_it_too(seed: int) -> None:
    agents = tuple(range(1, 7))
    games, answers = moment(seed, agents, gather=20.0)
    assert course(admm_mpc, games, graph("ring", agents), answers, 600).error < 1e-6


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_a_market_finds_its_closed_form(topology: str) -> None:
    solver = partial(admm_mpc, penalty=1.0)
    for capacity, answer in ((None, each(3.0, 2.0, 1.0, 0.0)), (4.0, each(7 / 3, 4 / 3, 1 / 3, 0.0))):
        assert course(solver, cournot(capacity), graph(topology), answer, 300).error < 1e-10


@pytest.mark.parametrize("loss", [0.2, 0.5])
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_lost_messages_only_delay_it(topology: str, loss: float) -> None:
    games, answers = moment(1, AGENTS)
    assert course(admm_mpc, games, graph(topology), answers, 900, links=lossy(3, loss)).error < 1e-6


def test_the_swap_arrives_although_every_fifth_message_is_lost() -> None:
    run = dcf_zenoh.simulate("position_swap_lossy", algorithm="admm_mpc")
    assert run.summary()["messages"]["lost"] > 1000
    assert run.arrival_time is not None
    assert 10 < run.arrival_time < 13
    assert run.barriers.min() > 0.05


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_costs_stay_private_and_everything_else_is_shared(topology: str) -> None:
    games, _ = moment(0, AGENTS)
    network = graph(topology)
    fleet = fleet_of(network)
    heard: dict[int, dict[int, Share]] = {}

    def listening(game: SwapGame, me: Me) -> Dialogue[Result]:
        dialogue = admm_mpc(game, me)
        said, change = next(dialogue)
        while True:
            inbox = yield said, change
            for payload in inbox.values():
                heard.setdefault(me.id, {}).update(Share.all_in(payload))
            try:
                said, change = dialogue.send(inbox)
            except StopIteration as finished:
                return cast(Result, finished.value)

    lockstep(listening, games, fleet, network.diameter + 3)
    for told in heard.values():
        for i, share in told.items():
            assert not share.H.any()
            assert not share.g.any()
            np.testing.assert_array_equal(share.A, games[i].A)
    assert all(set(told) >= set(AGENTS) - {i} for i, told in heard.items())


def aside(seed: int) -> tuple[dict[int, SwapGame], dict[int, Array]]:
    """Agent 4 is lost, and the others continue."""
    rng = np.random.default_rng(seed)
    places = {1: (0.0, 1.0), 2: (0.1, -1.0), 3: (1.0, 0.1), 4: (-0.3, -0.2)}
    states = {i: np.array([*place, *rng.normal(scale=0.2, size=2)]) for i, place in places.items()}
    games = {
        i: PositionSwap(i, AGENTS, SAMPLE_TIME, target=tuple(-np.array(places[i]))).at(states, lost=(4,))
        for i in (1, 2, 3)
    }
    return games, solve_together({i: game.share() for i, game in games.items()})


@pytest.mark.parametrize("seed", range(3))
def test_agents_that_are_lost_are_not_waited_for(seed: int) -> None:
    games, answers = aside(seed)
    fleet = fleet_of(graph("complete"))
    results = lockstep(
        admm_mpc, games, {i: fleet[i] for i in games}, 200, links=lambda j, _i, _r: None if j == 4 else 0
    )
    for i, answer in answers.items():
        np.testing.assert_allclose(results[i].decision, answer, atol=1e-7)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_a_flight_agrees_with_the_central_solution_in_every_step(topology: str) -> None:
    exact = dcf_zenoh.simulate(
        "position_swap",
        algorithm="admm",
        topology=topology,
        changes=["exchange.threshold=1e-7", "exchange.max_rounds=600", "time.duration=2.0"],
    )
    beside = consult(exact)
    assert not beside.unsolved
    assert beside.gap.max() < 2e-5
    assert beside.violation.max() < 1e-6
    assert all(set(log.stopped_by) == {"agreed"} for log in exact.agents.values())


@pytest.mark.parametrize("topology", ["complete", pytest.param("path", marks=pytest.mark.large)])
def test_the_swap_arrives_and_keeps_clear(topology: str) -> None:
    run = dcf_zenoh.simulate("position_swap", algorithm="admm", topology=topology)
    assert run.arrival_time is not None
    assert 10 < run.arrival_time < 12.5  # the exact one 10.6 s, its mirrored branch 12.0 s
    assert run.barriers.min() > 0.1
    assert consult(run).gap.max() < 0.02
    assert max(log.rounds.max() for log in run.agents.values()) < 170


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_a_step_starts_from_the_one_before(topology: str) -> None:
    """A market is the same in every step: what was agreed on still holds."""
    network = graph(topology)
    fleet = fleet_of(network)
    rounds, most = list[int](), list[int]()

    def settled(number: int, residuals: Mapping[int, float]) -> bool:
        most[-1] = max(most[-1], *(me.noted.get("iterations", 0) for me in fleet.values()))
        if max(residuals.values()) < 1e-5:
            rounds.append(number)
        return max(residuals.values()) < 1e-5

    for _ in range(2):
        most.append(0)
        results = lockstep(partial(admm_mpc, penalty=1.0), cournot(4.0), fleet, 500, after_round=settled)
        for i, result in results.items():
            fleet[i].remember(result)
    assert rounds[0] > 30
    assert rounds[1] <= network.diameter + 5
    assert most[1] < most[0]  # of OSQP, in any solve


def test_a_solve_starts_from_the_one_before() -> None:
    games, _ = moment(0, AGENTS)
    fleet = fleet_of(graph("complete"))
    iterations: list[float] = []

    def watch(_round: int, _residuals: Mapping[int, float]) -> bool:
        iterations.append(max(me.noted.get("iterations", 0) for me in fleet.values()))
        return False

    lockstep(admm_mpc, games, fleet, 250, after_round=watch)
    assert set(iterations[-20:]) == {5}  # settled: OSQP checks after 5 iterations, and has converged
    assert max(iterations) >= 20


def test_infeasible_problem_is_an_error_of_one_line_with_the_solver_s_status() -> None:
    wall = ((0.0, 0.0, 0.5, 0.5),)  # ahead of agent 1, which is too fast to stop
    states = {1: np.array([0.55, 0.0, -6.0, 0.0]), 2: np.array([3.0, 3.0, 0.0, 0.0])}
    games = {
        i: PositionSwap(i, (1, 2), SAMPLE_TIME, target=(0.0, 0.0), barrier=DiamondOptions(obstacles=wall)).at(states)
        for i in states
    }
    with pytest.raises(
        AlgorithmError,
        match=r"^the local problem has no solution: the problem is infeasible: its constraints contradict each other$",
    ):
        lockstep(partial(admm_mpc, multiplier_max=None), games, fleet_of(graph("complete", (1, 2))), 20)
    with pytest.raises(AlgorithmError, match="the problem is infeasible: its constraints contradict each other"):
        solve_together({i: game.share() for i, game in games.items()})
    softly = lockstep(admm_mpc, games, fleet_of(graph("complete", (1, 2))), 60)
    assert softly[1].decision[0] == pytest.approx(2.0, abs=1e-3)  # it brakes as hard as it can


def test_a_game_without_a_common_cost_is_refused() -> None:
    reference = Reference.read("n6_line_nonpotential")
    with pytest.raises(AlgorithmError, match="the agents have no common cost to minimise, as they pay differently for"):
        lockstep(admm_mpc, reference.games, fleet_of(reference.graph), 20)


def test_what_it_cannot_solve_is_refused() -> None:
    directed = Graph.of(AGENTS, ring(AGENTS, directed=True))
    with pytest.raises(AlgorithmError, match="admm_mpc needs links in both directions; agent 1 hears"):
        lockstep(admm_mpc, cournot(4.0), fleet_of(directed, weights="uniform"), 1)
    with pytest.raises(AlgorithmError, match="admm_mpc solves an aggregative game with shared constraints, and Quadra"):
        lockstep(admm_mpc, quadratic(), fleet_of(graph("ring")), 1)
    with pytest.raises(AlgorithmError, match=r"admm_mpc: relax must be in \(0, 1\], not 1.5"):
        lockstep(partial(admm_mpc, relax=1.5), cournot(4.0), fleet_of(graph("ring")), 1)
