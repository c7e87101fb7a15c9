"""Decentralised SQP finds the solution of a central solver, in one step and in flight."""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.algorithms.sqp_admm import sqp_admm
from dcf_zenoh.analysis.oracle import consult
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.distance_swap import DistanceSwap
from dcf_zenoh.problems.problem import NonlinearGame
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.swap_options import CostOptions
from dcf_zenoh.testing import check_problem, fleet_of, lockstep, lossy
from tests.support.answers import AGENTS, TOPOLOGIES, Problems, cournot, course, graph
from tests.support.swaps import SAMPLE_TIME, distance_moment, together
from topologies.ring import ring

pytestmark = pytest.mark.no_cover  # many rounds of the same lines


class Ball(NonlinearGame):
    """Each agent has one coordinate x_i of a point in the unit ball, and the more of it the better: greatest w'x."""

    def __init__(self, agent: int, weights: Mapping[int, float]) -> None:
        self.agents = tuple(weights)
        self.T, self.t = np.eye(1), np.zeros(1)
        self._weight = weights[agent]

    def start(self, last: Array | None) -> Array:
        return np.full(1, 0.5) if last is None else last

    def contribution(self, u: Array) -> Array:
        return u

    def gradient(self, u: Array, sigma: Array) -> Array:
        return np.full(1, -self._weight)

    def project(self, u: Array) -> Array:
        inside: Array = np.minimum(np.maximum(u, -2.0), 2.0)
        return inside

    def constraints(self, outputs: Array) -> tuple[Array, Array]:
        return np.full(1, (outputs**2).sum() - 1), 2 * outputs[np.newaxis]

    def curvature(self, outputs: Array, prices: Array) -> Array:
        return 2 * float(prices[0]) * np.eye(outputs.size)

    def share(self) -> Share:
        zero, none = np.zeros((1, 1)), np.zeros(1)
        return Share(
            zero, np.array([-self._weight]), none - 2, none + 2, K=zero, Phi=zero + 1, phi=none, T=self.T, t=self.t
        )  # fmt: skip


def ball(weights: Mapping[int, float]) -> tuple[Problems, dict[int, Array]]:
    """The greatest w'x is at w / |w|."""
    length = float(np.hypot.reduce(list(weights.values())))
    return {i: Ball(i, weights) for i in weights}, {i: np.array([w / length]) for i, w in weights.items()}


def test_the_ball_keeps_the_contract() -> None:
    check_problem(lambda: Ball(1, {1: 2.0, 2: 1.0}))


def test_the_greatest_2_x_plus_y_on_the_unit_disc_is_at_2_1_over_the_root_of_5() -> None:
    problems, _ = ball({1: 2.0, 2: 1.0})
    answers = {1: np.array([2 / np.sqrt(5)]), 2: np.array([1 / np.sqrt(5)])}
    found = course(partial(sqp_admm, penalty=3.0, inner=3), problems, graph("path", (1, 2)), answers, 300)
    assert found.error < 1e-8


@pytest.mark.parametrize(("seed", "topology"), list(enumerate(TOPOLOGIES)))
def test_the_ball_of_four_agents(seed: int, topology: str) -> None:
    rng = np.random.default_rng(seed)
    problems, answers = ball({i: float(rng.uniform(0.5, 2.0)) for i in AGENTS})
    found = course(partial(sqp_admm, penalty=3.0, inner=3), problems, graph(topology), answers, 500)
    assert found.error < 1e-7


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("seed", range(3))
def test_random_moments_of_a_swap_agree_with_slsqp(seed: int, topology: str) -> None:
    games, answers = distance_moment(seed, AGENTS)
    found = course(sqp_admm, games, graph(topology), answers, 500)
    assert found.error < 1e-4  # of SLSQP, mostly
    stayed = together(games, np.concatenate([found.decisions[i] for i in AGENTS]))
    for i, decision in stayed.items():
        np.testing.assert_allclose(found.decisions[i], decision, atol=1e-5)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_true_constraints_hold_where_it_ends(topology: str) -> None:
    games, _ = distance_moment(1, AGENTS)
    residuals: list[float] = []

    def settled(_round: int, values: Mapping[int, float]) -> bool:
        residuals.append(max(values.values()))
        return residuals[-1] < 1e-5

    results = lockstep(sqp_admm, games, fleet_of(graph(topology)), 600, after_round=settled)
    assert residuals[-1] < 1e-5
    outputs = np.array([games[i].T @ results[i].decision + games[i].t for i in AGENTS])
    values = np.concatenate([game.constraints(outputs)[0] for game in games.values()])
    assert values.max() < 1e-4
    assert (abs(values) < 1e-4).any()  # and something is at its limit
    near = together(games, np.concatenate([results[i].decision for i in AGENTS]))
    assert max(float(abs(near[i] - results[i].decision).max()) for i in AGENTS) < 1e-3  # not between two linearisations


def test_lost_messages_only_delay_it() -> None:
    games, answers = distance_moment(0, AGENTS)
    assert course(sqp_admm, games, graph("ring"), answers, 800, links=lossy(2, 0.3)).error < 1e-4


@pytest.mark.parametrize("topology", ["complete", pytest.param("star", marks=pytest.mark.large)])
def test_the_swap_arrives_and_keeps_its_distance(topology: str) -> None:
    run = dcf_zenoh.simulate("distance_swap", topology=topology)
    assert run.arrival_time is not None
    assert 6 < run.arrival_time < 10
    assert run.barriers.min() > 0.3
    apart = run.positions[:, [0, 0, 0, 1, 1, 2]] - run.positions[:, [1, 2, 3, 2, 3, 3]]
    e = np.sqrt((apart[..., 0] / 0.5) ** 2 + (apart[..., 1] / 0.25) ** 2) - 1
    assert e.min() > 0.2


def test_a_solve_starts_from_the_one_before() -> None:
    games, _ = distance_moment(5, AGENTS)
    fleet = fleet_of(graph("complete"))
    iterations: list[float] = []

    def watch(_round: int, _residuals: Mapping[int, float]) -> bool:
        iterations.append(max(me.noted.get("iterations", 0) for me in fleet.values()))
        return False

    lockstep(sqp_admm, games, fleet, 400, after_round=watch)
    assert set(iterations[-20:]) == {5}  # settled: OSQP checks after 5 iterations, and has converged
    assert max(iterations) >= 20


def test_infeasible_problem_is_an_error_of_one_line_with_the_solver_s_status() -> None:
    states = {1: np.array([0.3, 0.2, -1.5, 0.0]), 2: np.array([-0.3, 0.1, 1.5, 0.0])}
    games = {i: DistanceSwap(i, (1, 2), SAMPLE_TIME, target=(0.0, 0.0)).at(states) for i in states}
    with pytest.raises(
        AlgorithmError,
        match=r"^the local problem has no solution: the problem is infeasible: its constraints contradict each other$",
    ):
        lockstep(partial(sqp_admm, multiplier_max=None), games, fleet_of(graph("complete", (1, 2))), 20)
    softly = lockstep(sqp_admm, games, fleet_of(graph("complete", (1, 2))), 60)
    assert softly[1].decision[0] == pytest.approx(2.0, abs=1e-3)  # it brakes as hard as it can


def test_one_solver_for_all_refuses_what_is_not_linear() -> None:
    games, _ = distance_moment(0, AGENTS)
    with pytest.raises(AlgorithmError, match="no solution in one place: the shared constraints are not linear"):
        solve_together({i: game.share() for i, game in games.items()})
    beside = consult(dcf_zenoh.simulate("distance_swap", changes=["time.duration=0.4"]))
    assert set(beside.unsolved.values()) == {"there is no solution in one place: the shared constraints are not linear"}


def test_what_it_cannot_solve_is_refused() -> None:
    games, _ = distance_moment(0, AGENTS)
    directed = Graph.of(AGENTS, ring(AGENTS, directed=True))
    with pytest.raises(AlgorithmError, match="sqp_admm needs links in both directions; agent 1 hears"):
        lockstep(sqp_admm, games, fleet_of(directed, weights="uniform"), 1)
    with pytest.raises(
        AlgorithmError, match="sqp_admm solves an aggregative game with constraints that are not linear, an"
    ):
        lockstep(sqp_admm, cournot(4.0), fleet_of(graph("ring")), 1)
    with pytest.raises(AlgorithmError, match=r"sqp_admm: inner must be in \[1, inf\], not 0"):
        lockstep(partial(sqp_admm, inner=0), games, fleet_of(graph("ring")), 1)
    unequal = {
        i: DistanceSwap(i, AGENTS, SAMPLE_TIME, target=(0.0, 0.0), cost=CostOptions(gather=float(i))) for i in AGENTS
    }
    states = {i: np.array([2.0 * i, 0.0, 0.0, 0.0]) for i in AGENTS}
    with pytest.raises(AlgorithmError, match="the agents have no common cost to minimise, as they pay differently"):
        lockstep(sqp_admm, {i: each.at(states) for i, each in unequal.items()}, fleet_of(graph("ring")), 20)
