"""The mean of values, where mixing finds it and where only push-sum does."""

from typing import Any

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Algorithm, Inbox
from dcf_zenoh.algorithms.average_consensus import average_consensus
from dcf_zenoh.algorithms.push_sum import push_sum
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Graph, metropolis
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.average import Average
from dcf_zenoh.testing import fleet_of, lockstep, lossy
from tests.support.answers import TOPOLOGIES, Problems, course, everywhere, graph, random_graph
from topologies.ring import ring

FIVE = (1, 2, 3, 4, 5)
CHORD = [*ring(FIVE, directed=True), (1, 3), (1, 4)]  # agent 1 has more out-neighbours than the others


def values(seed: int, agents: tuple[int, ...] = FIVE) -> tuple[Problems, Array]:
    drawn = np.random.default_rng(seed).normal(size=(len(agents), 2))
    return {i: Average(value=value.tolist()) for i, value in zip(agents, drawn, strict=True)}, drawn.mean(axis=0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("links", [ring(FIVE, directed=True), CHORD], ids=["ring", "chord"])
@pytest.mark.parametrize("weights", ["uniform", "uneven"])
def test_push_sum_finds_the_mean_on_directed_graphs_whatever_the_weights(
    weights: str, links: list[tuple[int, int]], seed: int
) -> None:
    problems, mean = values(seed)
    found = course(push_sum, problems, Graph.of(FIVE, links), everywhere(mean, FIVE), 200, weights=weights)
    assert found.error < 1e-12
    assert found.rate < 0.95


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_push_sum_finds_it_on_undirected_graphs_too(topology: str, seed: int) -> None:
    problems, mean = values(seed)
    found = course(push_sum, problems, graph(topology, FIVE), everywhere(mean, FIVE), 300)
    assert found.error < 1e-12


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("topology", ["ring", "path", "star"])  # on the complete graph it is there after one round
def test_average_consensus_is_as_fast_as_the_second_eigenvalue_of_its_weights(topology: str, seed: int) -> None:
    problems, mean = values(seed)
    network = graph(topology, FIVE)
    second = np.sort(abs(np.linalg.eigvalsh(metropolis(network))))[-2]
    found = course(average_consensus, problems, network, everywhere(mean, FIVE), 200)
    assert found.error < 1e-9
    assert found.rate == pytest.approx(second, abs=0.01)
    assert found.straightness < -0.99


def test_average_consensus_takes_one_round_on_the_complete_graph() -> None:
    problems, mean = values(0)
    assert course(average_consensus, problems, graph("complete", FIVE), everywhere(mean, FIVE), 1).error < 1e-15


@pytest.mark.parametrize("algorithm", [average_consensus, push_sum])
def test_lost_messages_leave_a_bias(algorithm: Algorithm) -> None:
    problems, mean = values(0)
    network = graph("ring", FIVE)
    found = course(algorithm, problems, network, everywhere(mean, FIVE), 300, links=lossy(1, 0.05))
    assert 1e-4 < found.error < 1.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("weights", ["metropolis", "laplacian"])
def test_average_consensus_finds_it_with_doubly_stochastic_weights(weights: str, seed: int) -> None:
    network = random_graph(seed)
    problems, mean = values(seed, network.agents)
    results = lockstep(average_consensus, problems, fleet_of(network, weights=weights), 300)
    for result in results.values():
        np.testing.assert_allclose(result.decision, mean, atol=1e-9)


@pytest.mark.parametrize("weights", ["uniform", "uneven"])
def test_average_consensus_refuses_weights_that_are_not(weights: str) -> None:
    fleet = fleet_of(Graph.of(FIVE, CHORD), weights=weights)
    with pytest.raises(AlgorithmError, match="average_consensus needs doubly stochastic weights; these are not"):
        lockstep(average_consensus, values(0)[0], fleet, 1)


def test_uneven_weights_are_not_doubly_stochastic_even_on_a_directed_ring() -> None:
    directed = Graph.of(FIVE, ring(FIVE, directed=True))
    assert all(me.neighbourhood.doubly_stochastic for me in fleet_of(directed, weights="uniform").values())
    assert not any(me.neighbourhood.doubly_stochastic for me in fleet_of(directed, weights="uneven").values())


def test_entries_of_another_shape_are_not_stretched_to_be_mixed() -> None:
    problems = {i: Average(value=[1.0, 2.0] if i == 3 else [float(i)]) for i in FIVE}
    fleet = fleet_of(graph("ring", FIVE))
    lockstep(average_consensus, problems, fleet, 1)
    assert {i: me.take_misshapen() for i, me in fleet.items()} == {
        1: {},
        2: {3: "'x' of shape (2,), expected (1,)"},
        3: {2: "'x' of shape (1,), expected (2,)", 4: "'x' of shape (1,), expected (2,)"},
        4: {3: "'x' of shape (2,), expected (1,)"},
        5: {},
    }


def test_a_neighbour_whose_entry_cannot_be_mixed_counts_as_missing_in_any_algorithm() -> None:
    me = fleet_of(graph("complete", FIVE))[1]
    own = {"x": np.array([1.0, 2.0])}
    weights = me.neighbourhood.weights

    def mixed(others: dict[int, dict[str, Any]]) -> Any:
        return me.mix(Inbox(own, others, stop=False), "x")

    right = {j: {"x": np.array([float(j), 0.0])} for j in (2, 3)}
    expected = (weights[1] + weights[4] + weights[5]) * own["x"] + sum(weights[j] * right[j]["x"] for j in right)
    assert mixed({**right, 4: {"x": np.zeros(3)}, 5: {}}) == pytest.approx(expected)
    assert me.take_misshapen() == {4: "'x' of shape (3,), expected (2,)", 5: "no entry 'x'"}
    with pytest.raises(AlgorithmError, match=r"differ in shape: \(2,\) here, \(3,\) from agent 2, \(3,\) from agent 3"):
        mixed({2: {"x": np.zeros(3)}, 3: {"x": np.zeros(3)}})
    with pytest.raises(AlgorithmError, match="the agent's own payload has no entry 'y' to mix"):
        me.mix(Inbox(own, right, stop=False), "y")
