"""Algorithms for shared constraints find the allocation and its price."""

import numpy as np
import pytest
from scipy.optimize import brentq

from dcf_zenoh.algorithms.dual_subgradient import dual_subgradient
from dcf_zenoh.algorithms.tracking_admm import tracking_admm
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.resource_allocation import ResourceAllocation
from tests.support.answers import TOPOLOGIES, Problems, allocation, course, each, graph, random_graph

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

ANSWER = each(4.0, 3.0, 1.5, 1.5)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_tracking_admm_finds_allocation_and_price_at_a_linear_rate(topology: str) -> None:
    found = course(tracking_admm, allocation(), graph(topology), ANSWER, 500)
    assert found.error < 1e-11
    assert found.rate < 0.93
    for memory in found.memories.values():
        np.testing.assert_allclose(memory["lam"], -6.0, atol=1e-10)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_dual_subgradient_method_gets_near_it(topology: str) -> None:
    found = course(dual_subgradient, allocation(), graph(topology), ANSWER, 3000)
    assert found.error < 0.02
    for memory in found.memories.values():
        np.testing.assert_allclose(memory["lam"], -6.0, atol=0.05)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_an_inequality_that_does_not_bind_costs_nothing(topology: str) -> None:
    """Alone they would take 1, 2, 1, 2; the limit of 10 leaves them that."""
    wanted = (1.0, 2.0, 1.0, 2.0)
    problems: Problems = {
        i: ResourceAllocation((1, 2, 3, 4), demand=10.0, exactly=False, centre=centre)
        for i, centre in enumerate(wanted, 1)
    }
    found = course(dual_subgradient, problems, graph(topology), each(*wanted), 300)
    assert found.error == 0.0
    assert all(memory["lam"] == 0.0 for memory in found.memories.values())


def allocated(seed: int, agents: tuple[int, ...], *, exactly: bool = True) -> tuple[Problems, dict[int, Array]]:
    """Two resources; the answer by a root search for the price of each."""
    rng = np.random.default_rng(seed)
    weights, centres = rng.uniform(1, 4, (len(agents), 2)), rng.uniform(0, 2, (len(agents), 2))
    most, demand = rng.uniform(1, 3, (len(agents), 2)), np.array([0.5, 0.8]) * len(agents)

    def taken(price: Array) -> Array:
        return np.clip(centres - price / weights, 0.0, most)

    prices = [
        brentq(lambda p, k=k: taken(np.full(2, p))[:, k].sum() - demand[k], -50, 50, xtol=1e-14) for k in range(2)
    ]
    if not exactly:
        prices = [max(price, 0.0) for price in prices]
    answer = taken(np.array(prices))
    problems = {
        i: ResourceAllocation(
            agents, demand=demand.tolist(), exactly=exactly, weight=weights[row].tolist(), centre=centres[row].tolist(),
            upper=most[row].tolist(),
        )
        for row, i in enumerate(agents)
    }  # fmt: skip
    return dict(problems), {i: answer[row] for row, i in enumerate(agents)}


@pytest.mark.parametrize("seed", range(4))
def test_tracking_admm_on_random_problems_and_graphs(seed: int) -> None:
    network = random_graph(seed)
    problems, answers = allocated(seed, network.agents)
    assert course(tracking_admm, problems, network, answers, 800).error < 1e-10


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("exactly", [True, False])
def test_the_dual_subgradient_method_on_random_problems_and_graphs(seed: int, *, exactly: bool) -> None:
    network = random_graph(seed)
    problems, answers = allocated(seed, network.agents, exactly=exactly)
    assert course(dual_subgradient, problems, network, answers, 3000).error < 0.02
