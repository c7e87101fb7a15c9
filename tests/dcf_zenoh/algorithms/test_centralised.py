"""One agent solves for all: the same answers as the distributed methods, on any graph, of any kind of problem."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from dcf_zenoh.algorithms.centralised import centralised
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.problems.resource_allocation import ResourceAllocation
from dcf_zenoh.problems.share import Share
from dcf_zenoh.testing import fleet_of, lockstep, lossy
from tests.support.answers import (
    AGENTS,
    TOPOLOGIES,
    Problems,
    allocation,
    cournot,
    each,
    everywhere,
    graph,
    lasso,
    median,
    quadratic,
    two_players,
)
from tests.support.references import INSTANCES, Reference
from topologies.ring import ring

KNOWN: dict[str, tuple[Problems, dict[int, Array]]] = {
    "P1": (quadratic(), everywhere(1.0)),
    "P1 with a bound": (quadratic(upper=0.5), everywhere(0.5)),
    "median": (median(), everywhere(2.0, (1, 2, 3, 4, 5))),
    "P3": (allocation(), each(4.0, 3.0, 1.5, 1.5)),
    "P4": (cournot(), each(3.0, 2.0, 1.0, 0.0)),
    "P4 with a capacity": (cournot(capacity=4.0), each(7 / 3, 4 / 3, 1 / 3, 0.0)),
    "P5": (two_players(), each(1.0, 2.0)),
}


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("name", KNOWN)
def test_it_finds_the_known_answers(name: str, topology: str) -> None:
    problems, answers = KNOWN[name]
    network = graph(topology, tuple(problems))
    results = lockstep(centralised, problems, fleet_of(network), 2 * network.diameter + 1)
    for i, answer in answers.items():
        np.testing.assert_allclose(results[i].decision, answer, atol=1e-8)


@pytest.mark.parametrize("name", INSTANCES)
def test_it_finds_the_equilibrium_of_the_position_swap_also_without_a_potential(name: str) -> None:
    reference = Reference.read(name)
    results = lockstep(centralised, reference.games, fleet_of(reference.graph), 2 * reference.graph.diameter + 1)
    for i, result in results.items():
        np.testing.assert_allclose(result.decision, reference.expected("u_star", i), atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_lasso(seed: int) -> None:
    problems, answer = lasso(seed, AGENTS)
    results = lockstep(centralised, problems, fleet_of(graph("path")), 7)
    np.testing.assert_allclose(results[1].decision, answer, atol=1e-7)


@pytest.mark.parametrize("hub", [1, 3])
def test_the_answer_is_everywhere_after_it_went_to_the_hub_and_back(hub: int) -> None:
    network = graph("path")
    away = max(network.distances(hub).values())
    residuals: list[list[float]] = []

    def watch(_round: int, values: object) -> bool:
        residuals.append(list(values.values()))  # type: ignore[attr-defined]
        return False

    lockstep(partial(centralised, hub=hub), quadratic(), fleet_of(network), 10, after_round=watch)
    first = next(number for number, values in enumerate(residuals) if not any(values))
    assert first == 2 * away


def test_a_directed_graph_is_enough() -> None:
    directed = Graph.of(AGENTS, ring(AGENTS, directed=True))
    results = lockstep(centralised, quadratic(), fleet_of(directed, weights="uneven"), 8)
    assert {round(result.decision[0], 8) for result in results.values()} == {1.0}


@pytest.mark.parametrize("seed", range(3))
def test_lost_messages_only_delay_it(seed: int) -> None:
    results = lockstep(centralised, allocation(), fleet_of(graph("path")), 60, links=lossy(seed, 0.5))
    for i, answer in each(4.0, 3.0, 1.5, 1.5).items():
        np.testing.assert_allclose(results[i].decision, answer, atol=1e-8)


def test_an_agent_without_an_answer_keeps_its_last_decision() -> None:
    results = lockstep(centralised, quadratic(), fleet_of(graph("path")), 2)
    assert results[4].decision == [0.0]


def test_infeasible_problem_is_an_error_with_the_solver_s_status() -> None:
    problems = {i: ResourceAllocation(AGENTS, demand=50.0, upper=4.0) for i in AGENTS}
    with pytest.raises(
        AlgorithmError, match="there is no solution: the problem is infeasible: its constraints contradict"
    ):
        lockstep(centralised, problems, fleet_of(graph("complete")), 5)
    apart = {i: Quadratic(centre=0.0, lower=float(i), upper=i + 0.5) for i in AGENTS}
    with pytest.raises(
        AlgorithmError, match="there is no solution: the problem is infeasible: its constraints contradict"
    ):
        lockstep(centralised, apart, fleet_of(graph("complete")), 5)


def test_a_cost_without_a_least_value_is_an_error() -> None:
    class Falling(Quadratic):
        """Its cost falls for ever."""

        def share(self) -> Share:
            return replace(super().share(), H=np.zeros((1, 1)), g=-np.ones(1))

    with pytest.raises(
        AlgorithmError, match="there is no solution: the problem is unbounded: its cost has no least value"
    ):
        lockstep(centralised, {i: Falling(centre=0.0) for i in AGENTS}, fleet_of(graph("complete")), 5)


def test_a_hub_that_is_no_agent_is_refused() -> None:
    with pytest.raises(AlgorithmError, match=r"hub must be one of the agents \[1, 2, 3, 4\], not 7"):
        lockstep(partial(centralised, hub=7), quadratic(), fleet_of(graph("ring")), 1)


def test_a_problem_without_share_is_refused() -> None:
    class Untold:
        """A consensus problem without share()."""

        size = 1

        def cost(self, x: Array) -> float:
            return 0.0

        def gradient(self, x: Array) -> Array:
            return x

        def argmin(self, slope: Array, weight: float) -> Array:
            return slope

    with pytest.raises(AlgorithmError, match=r"centralised needs a problem with share\(\), which Untold has not"):
        lockstep(centralised, {i: Untold() for i in AGENTS}, fleet_of(graph("ring")), 1)
