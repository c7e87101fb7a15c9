"""Algorithms that agree on one decision find it: on every graph, at their rate, or with the bias that they have."""

from functools import partial

import numpy as np
import pytest

from dcf_zenoh.algorithms.admm_tracking_gradient import admm_tracking_gradient
from dcf_zenoh.algorithms.algorithm import Algorithm
from dcf_zenoh.algorithms.consensus_admm import consensus_admm
from dcf_zenoh.algorithms.dual_decomposition import dual_decomposition
from dcf_zenoh.algorithms.edge_admm import edge_admm
from dcf_zenoh.algorithms.exact_diffusion import exact_diffusion
from dcf_zenoh.algorithms.extra import extra
from dcf_zenoh.algorithms.gradient_tracking import gradient_tracking
from dcf_zenoh.algorithms.push_pull import push_pull
from dcf_zenoh.algorithms.subgradient import subgradient
from dcf_zenoh.graph import Graph, metropolis
from dcf_zenoh.testing import lossy
from tests.support.answers import (
    AGENTS,
    TOPOLOGIES,
    course,
    everywhere,
    graph,
    lasso,
    median,
    quadratic,
    random_graph,
    random_quadratic,
)
from topologies.ring import ring

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

# Linear on P1: rounds, and the slowest rate on any of the four graphs.
LINEAR: dict[str, tuple[Algorithm, int, float]] = {
    "gradient_tracking": (gradient_tracking, 500, 0.93),
    "push_pull": (push_pull, 400, 0.91),
    "extra": (extra, 250, 0.86),
    "exact_diffusion": (exact_diffusion, 250, 0.84),
    "consensus_admm": (consensus_admm, 200, 0.78),
    "edge_admm": (edge_admm, 200, 0.80),
    "admm_tracking_gradient": (admm_tracking_gradient, 250, 0.80),
    "dual_decomposition": (partial(dual_decomposition, step=0.2), 700, 0.96),
}
BEARS_LOSS = ("edge_admm", "admm_tracking_gradient", "dual_decomposition")


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("name", LINEAR)
def test_the_least_sum_of_squares_is_found_at_a_linear_rate(name: str, topology: str) -> None:
    algorithm, rounds, slowest = LINEAR[name]
    found = course(algorithm, quadratic(), graph(topology), everywhere(1.0), rounds)
    assert found.error < 1e-11
    assert 0.2 < found.rate < slowest
    assert found.straightness < -0.97


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", LINEAR)
def test_random_costs_on_random_graphs_meet_their_closed_form(name: str, seed: int) -> None:
    network = random_graph(seed)
    problems, answer = random_quadratic(seed, network.agents)
    algorithm, _, _ = LINEAR[name]
    options = {"step": 0.1} if name in ("extra", "exact_diffusion", "gradient_tracking", "dual_decomposition") else {}
    found = course(partial(algorithm, **options), problems, network, everywhere(answer, network.agents), 1200)
    assert found.error < 1e-10


@pytest.mark.parametrize("links", [ring(AGENTS, directed=True), [*ring(AGENTS, directed=True), (1, 3)]])
@pytest.mark.parametrize("weights", ["uniform", "uneven"])
def test_push_pull_needs_neither_opposite_links_nor_columns_that_sum_to_one(
    weights: str, links: list[tuple[int, int]]
) -> None:
    found = course(push_pull, quadratic(), Graph.of(AGENTS, links), everywhere(1.0), 500, weights=weights)
    assert found.error < 1e-11
    assert found.rate < 0.93


@pytest.mark.parametrize("loss", [0.05, 0.2, 0.5])
@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("name", BEARS_LOSS)
def test_half_of_all_messages_may_be_lost(name: str, topology: str, loss: float) -> None:
    algorithm, rounds, _ = LINEAR[name]
    found = course(algorithm, quadratic(), graph(topology), everywhere(1.0), 2 * rounds, links=lossy(3, loss))
    assert found.error < 1e-9


@pytest.mark.parametrize("name", ["gradient_tracking", "push_pull", "extra", "exact_diffusion", "consensus_admm"])
def test_the_others_are_left_with_a_bias_by_lost_messages(name: str) -> None:
    algorithm, rounds, _ = LINEAR[name]
    found = course(algorithm, quadratic(), graph("ring"), everywhere(1.0), 2 * rounds, links=lossy(3, 0.05))
    assert 1e-3 < found.error < 2.0
    assert abs(found.errors[-50:] - found.error).max() < 0.2 * found.error  # it has settled there


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize(
    ("algorithm", "rounds", "within"),
    [(consensus_admm, 100, 1e-9), (edge_admm, 100, 1e-9), (dual_decomposition, 500, 1e-9), (subgradient, 800, 0.01)],
)
def test_a_bound_is_kept_and_met(algorithm: Algorithm, rounds: int, within: float, topology: str) -> None:
    found = course(algorithm, quadratic(upper=0.5), graph(topology), everywhere(0.5), rounds)
    assert found.error < within


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize(
    ("algorithm", "rounds", "within"),
    [(consensus_admm, 500, 1e-8), (edge_admm, 1500, 1e-8), (partial(subgradient, step=5.0), 1500, 0.05)],
)
def test_the_median_is_found_although_the_cost_has_a_kink(
    algorithm: Algorithm, rounds: int, within: float, topology: str
) -> None:
    problems = median()
    agents = tuple(problems)
    found = course(algorithm, problems, graph(topology, agents), everywhere(2.0, agents), rounds)
    assert found.error < within


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_the_subgradient_method_gets_near_with_steps_that_shrink(topology: str) -> None:
    found = course(subgradient, quadratic(), graph(topology), everywhere(1.0), 4000)
    assert found.error < 0.003
    assert found.errors[999] / found.errors[3999] == pytest.approx(4.0, rel=0.1)  # like 1 / k


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("step", [0.02, 0.04, 0.1])
def test_constant_steps_leave_the_bias_of_their_fixed_point(topology: str, step: float) -> None:
    W, A, c = metropolis(graph(topology)), np.diag([1.0, 2.0, 3.0, 4.0]), np.array([4.0, -1.0, 2.0, 0.5])
    I = np.eye(4)  # noqa: E741
    fixed = np.linalg.solve(I - (I - step * A) @ W, step * A @ c)  # x = v - a A (v - c) with v = W x
    answers = {i: fixed[[i - 1]] for i in AGENTS}
    found = course(partial(subgradient, step=step, decay=0.0), quadratic(), graph(topology), answers, 2500)
    assert found.error < 1e-10
    if (topology, step) == ("complete", 0.04):
        assert abs(fixed - 1.0).max() == pytest.approx(0.16, abs=1e-12)


@pytest.mark.parametrize(("seed", "topology"), list(enumerate(TOPOLOGIES)))
@pytest.mark.parametrize(
    ("algorithm", "rounds", "within"),
    [
        (partial(consensus_admm, penalty=2.0), 250, 1e-7),
        (partial(edge_admm, penalty=2.0), 250, 1e-7),
        (partial(subgradient, step=0.1, decay=0.6), 2000, 0.02),
    ],
    ids=["consensus_admm", "edge_admm", "subgradient"],
)
def test_the_lasso_is_that_of_all_data_in_one_place(
    algorithm: Algorithm, rounds: int, within: float, topology: str, seed: int
) -> None:
    problems, answer = lasso(seed, AGENTS)
    found = course(algorithm, dict(problems), graph(topology), everywhere(answer), rounds)
    assert found.error < within
    if within < 1e-3:
        used = abs(answer) > 1e-5
        assert used.any()
        assert not used.all()
        for decision in found.decisions.values():
            assert (abs(decision[~used]) < 1e-8).all()  # what is not needed is left out
