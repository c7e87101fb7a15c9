"""Algorithms for games find the equilibrium."""

from functools import partial
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Algorithm
from dcf_zenoh.algorithms.pseudo_gradient import pseudo_gradient
from dcf_zenoh.algorithms.pseudo_gradient_partial import pseudo_gradient_partial
from dcf_zenoh.algorithms.trades import trades
from dcf_zenoh.algorithms.trades_primal import trades_primal
from dcf_zenoh.algorithms.trades_robust import trades_robust
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.cournot import Cournot
from dcf_zenoh.problems.quadratic_game import QuadraticGame
from dcf_zenoh.testing import fleet_of, lockstep, lossy
from tests.support.answers import TOPOLOGIES, Problems, cournot, course, each, graph, random_graph, two_players
from topologies.complete import complete

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

NASH, CAPPED = each(3.0, 2.0, 1.0, 0.0), each(7 / 3, 4 / 3, 1 / 3, 0.0)


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("algorithm", [trades_primal, pseudo_gradient_partial])
def test_cournot_s_equilibrium_is_found_on_every_graph_at_a_linear_rate(algorithm: Algorithm, topology: str) -> None:
    found = course(algorithm, cournot(), graph(topology), NASH, 2200)
    assert found.error < 1e-10
    assert 0.9 < found.rate < 0.99
    assert found.straightness < -0.99


def test_players_that_receive_all_actions_are_faster() -> None:
    found = course(pseudo_gradient, cournot(), graph("complete"), NASH, 300)
    assert found.error < 1e-10
    assert found.rate == pytest.approx(0.9, abs=1e-3)  # 1 - step, along the slowest direction


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("algorithm", [trades, trades_robust])
def test_the_equilibrium_under_a_capacity_has_its_price(algorithm: Algorithm, topology: str) -> None:
    found = course(algorithm, cournot(capacity=4.0), graph(topology), CAPPED, 1800)
    assert found.error < 1e-10
    assert found.rate < 0.99
    for memory in found.memories.values():
        np.testing.assert_allclose(memory["lam"], 8 / 3, atol=1e-9)


@pytest.mark.parametrize("order", ["adapt_then_combine", "combine_then_adapt"])
def test_both_orders_of_trades_find_it(order: Any) -> None:
    found = course(partial(trades, order=order), cournot(capacity=4.0), graph("ring"), CAPPED, 3500)
    assert found.error < 1e-10


def test_the_robust_one_finds_it_also_where_half_of_all_messages_are_lost() -> None:
    found = course(trades_robust, cournot(capacity=4.0), graph("path"), CAPPED, 2500, links=lossy(1, 0.5))
    assert found.error < 1e-9


def test_the_first_steps_of_primal_trades_are_those_of_the_formula() -> None:
    """On the complete graph of four with weights 1/4 the mean of s is known to all after one round."""
    game, step, relax = cournot(), 0.1, 0.6
    u, z = np.zeros(4), np.zeros(4)
    for _ in range(3):
        s = u + z
        F = np.arange(1.0, 5.0) - 10 + 4 * s + u
        new = u + relax * (np.maximum(u - step * F, 0.0) - u)
        u, z = new, s.mean() - u
    results = lockstep(partial(trades_primal, step=step, relax=relax), game, fleet_of(graph("complete")), 3)
    np.testing.assert_allclose([results[i].decision[0] for i in game], u, atol=1e-14)


@pytest.mark.parametrize("algorithm", [pseudo_gradient, pseudo_gradient_partial])
def test_two_players_meet_at_one_and_two(algorithm: Algorithm) -> None:
    both = Graph.of((1, 2), complete((1, 2)))
    found = course(algorithm, two_players(), both, each(1.0, 2.0), 1200)
    assert found.error < 1e-11
    assert found.rate < 0.98


def random_game(seed: int, agents: tuple[int, ...]) -> tuple[Problems, dict[int, Array]]:
    """Strongly monotone and not symmetric: no cost that all share has this gradient."""
    rng = np.random.default_rng(seed)
    n = len(agents)
    M = np.eye(n) + 0.15 * rng.normal(size=(n, n))
    assert np.linalg.eigvalsh((M + M.T) / 2).min() > 0.1
    r = rng.normal(size=n)
    problems = {i: QuadraticGame(i, agents, row=M[k].tolist(), constant=float(r[k])) for k, i in enumerate(agents)}
    x = np.linalg.solve(M, -r)
    return dict(problems), {i: np.array([x[k]]) for k, i in enumerate(agents)}


@pytest.mark.parametrize("seed", range(4))
def test_random_games_on_random_graphs(seed: int) -> None:
    network = random_graph(seed)
    problems, answers = random_game(seed, network.agents)
    assert course(pseudo_gradient_partial, problems, network, answers, 2500).error < 1e-9
    everybody = Graph.of(network.agents, complete(network.agents))
    assert course(pseudo_gradient, problems, everybody, answers, 1500).error < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_random_markets_on_random_graphs(seed: int) -> None:
    """With x_i = (price - c_i - slope S) / slope for all who sell, S = (n price - sum of c) / (slope (n + 1))."""
    network = random_graph(seed)
    rng = np.random.default_rng(seed)
    costs, slope = rng.uniform(1, 2, len(network.agents)), 0.5
    total = (len(costs) * 10.0 - costs.sum()) / (slope * (len(costs) + 1))
    x = (10.0 - costs - slope * total) / slope
    assert (x > 0).all()
    problems: Problems = {
        i: Cournot(i, network.agents, cost=float(costs[k]), slope=slope) for k, i in enumerate(network.agents)
    }
    answers = {i: x[[k]] for k, i in enumerate(network.agents)}
    assert course(trades_primal, problems, network, answers, 2500).error < 1e-8


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.large) for seed in (2, 3))])
@pytest.mark.parametrize("algorithm", [trades, trades_robust])
def test_random_markets_with_a_capacity_on_random_graphs(algorithm: Algorithm, seed: int) -> None:
    """Where the capacity C binds, x_i = (price - c_i - slope C - lam) / slope, and lam is such that they sum to C."""
    network = random_graph(seed)
    rng = np.random.default_rng(seed)
    costs, slope, capacity = rng.uniform(1, 2, len(network.agents)), 0.5, 9.0
    lam = 10.0 - slope * capacity - costs.mean() - slope * capacity / len(costs)
    x = (10.0 - costs - slope * capacity - lam) / slope
    assert (x > 0).all()
    assert lam > 0
    problems: Problems = {
        i: Cournot(i, network.agents, cost=float(costs[k]), slope=slope, capacity=capacity)
        for k, i in enumerate(network.agents)
    }
    found = course(algorithm, problems, network, {i: x[[k]] for k, i in enumerate(network.agents)}, 2500)
    assert found.error < 1e-5
    for memory in found.memories.values():
        np.testing.assert_allclose(memory["lam"], lam, atol=1e-5)


def test_full_information_needs_a_link_from_every_player() -> None:
    with pytest.raises(AlgorithmError, match=r"needs every agent to hear all others; agent 1 hears \[2, 4\] of 3"):
        lockstep(pseudo_gradient, cournot(), fleet_of(graph("ring")), 1)


@pytest.mark.parametrize("algorithm", [trades_primal, pseudo_gradient, pseudo_gradient_partial])
def test_algorithms_without_shared_constraints_refuse_them(algorithm: Algorithm) -> None:
    with pytest.raises(AlgorithmError, match="needs a game without shared constraints, which Cournot has not"):
        lockstep(algorithm, cournot(capacity=4.0), fleet_of(graph("complete")), 1)
