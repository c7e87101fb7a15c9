"""An algorithm refuses what it cannot solve, in one line, before its first round."""

from functools import partial
from typing import Any

import pytest

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Me, Result
from dcf_zenoh.algorithms.average_consensus import average_consensus
from dcf_zenoh.algorithms.consensus_admm import consensus_admm
from dcf_zenoh.algorithms.dual_decomposition import dual_decomposition
from dcf_zenoh.algorithms.edge_admm import edge_admm
from dcf_zenoh.algorithms.extra import extra
from dcf_zenoh.algorithms.gradient_tracking import gradient_tracking
from dcf_zenoh.algorithms.needs import Fraction, needs, needs_of
from dcf_zenoh.algorithms.tracking_admm import tracking_admm
from dcf_zenoh.algorithms.trades import trades
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.average import Average
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.problems.resource_allocation import ResourceAllocation
from dcf_zenoh.spec import PositiveFloat
from dcf_zenoh.testing import fleet_of, lockstep
from tests.support.answers import AGENTS, Problems, allocation, cournot, graph, median, quadratic
from topologies.ring import ring

DIRECTED = Graph.of(AGENTS, ring(AGENTS, directed=True))
AT_MOST = {i: ResourceAllocation(AGENTS, demand=3.0, exactly=False) for i in AGENTS}


@pytest.mark.parametrize(
    ("algorithm", "problems", "text"),
    [
        (gradient_tracking, allocation(), "solves a consensus problem, and ResourceAllocation is a problem with"),
        (trades, quadratic(), "solves an aggregative game with shared constraints, and Quadratic is a consensus"),
        (tracking_admm, quadratic(), "solves a problem with shared constraints, and Quadratic is a consensus problem"),
        (consensus_admm, cournot(), "Cournot is an aggregative game with shared constraints and a game"),
        (average_consensus, quadratic(), "average_consensus solves a mean of values, and Quadratic is a consensus"),
        (gradient_tracking, median(), "needs a cost with a gradient everywhere, which AbsoluteValue has not"),
        (dual_decomposition, median(), "needs a strongly convex cost, which AbsoluteValue has not"),
        (extra, quadratic(upper=1.0), "extra needs a decision without bounds, which Quadratic has not"),
        (tracking_admm, AT_MOST, "needs shared constraints that are equations, which ResourceAllocation has not"),
        (extra, {i: object() for i in AGENTS}, "and object has no gradient, size"),
    ],
)  # fmt: skip
def test_a_problem_of_another_structure_is_refused(algorithm: Algorithm, problems: Problems, text: str) -> None:
    agents = tuple(problems)
    with pytest.raises(AlgorithmError, match=text) as refused:
        lockstep(algorithm, problems, fleet_of(graph("ring", agents)), 1)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("algorithm", "text"),
    [
        (extra, r"extra needs links in both directions; agent 1 hears \[4\] and is heard by \[2\] \(use an undirected"),
        (edge_admm, r"edge_admm needs links in both directions; agent 1 hears \[4\]"),
    ],
)
def test_directed_links_are_refused_where_both_directions_are_needed(algorithm: Algorithm, text: str) -> None:
    with pytest.raises(AlgorithmError, match=text):
        lockstep(algorithm, quadratic(), fleet_of(DIRECTED, weights="uniform"), 1)


def test_weights_that_do_not_keep_the_mean_are_refused() -> None:
    with pytest.raises(AlgorithmError, match="gradient_tracking needs doubly stochastic weights; these are not"):
        lockstep(gradient_tracking, quadratic(), fleet_of(DIRECTED, weights="uneven"), 1)
    lockstep(gradient_tracking, quadratic(), fleet_of(DIRECTED, weights="uniform"), 1)  # a directed ring's are


def test_too_few_agents_are_refused() -> None:
    alone = Graph.of((1,), [])
    with pytest.raises(AlgorithmError, match="consensus_admm needs at least 2 agents, not 1"):
        lockstep(consensus_admm, quadratic(), fleet_of(alone), 1)
    assert lockstep(gradient_tracking, quadratic(), fleet_of(alone), 200)[1].decision == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("algorithm", "options", "text"),
    [
        (gradient_tracking, {"step": 0.0}, r"gradient_tracking: step must be in \(0, inf\], not 0"),
        (extra, {"step": float("nan")}, r"extra: step must be in \(0, inf\], not nan"),
        (edge_admm, {"relax": 1.5}, r"edge_admm: relax must be in \(0, 1\], not 1.5"),
    ],
)
def test_options_out_of_their_range_are_refused(algorithm: Any, options: dict[str, float], text: str) -> None:
    with pytest.raises(AlgorithmError, match=text):
        lockstep(partial(algorithm, **options), quadratic(), fleet_of(graph("ring")), 1)


@needs(ConsensusProblem, traits=("smooth",), links="undirected")
def careful(problem: Any, me: Me, *, step: PositiveFloat = 0.1, share: Fraction | None = None) -> Dialogue[Result]:
    while not (yield {"x": step}, share or 0.0).stop:
        pass
    return me.result(problem.gradient(problem.start(me.last)))


class Duck:
    """Has all methods of a consensus problem, but derives from no structure."""

    size = 1

    def start(self, last: Array | None) -> Array:
        return Average(value=0.0).start(last)

    def cost(self, x: Array) -> float:
        return 0.0

    def gradient(self, x: Array) -> Array:
        return x + 7.0

    def argmin(self, slope: Array, weight: float) -> Array:
        return slope


def test_a_third_party_algorithm_can_declare_its_needs() -> None:
    assert needs_of(careful).links == "undirected"  # type: ignore[union-attr]
    with pytest.raises(AlgorithmError, match=r"careful: share must be in \(0, 1\], not 2"):
        lockstep(partial(careful, share=2.0), quadratic(), fleet_of(graph("ring")), 1)
    lockstep(partial(careful, share=None), quadratic(), fleet_of(graph("ring")), 1)


def test_a_problem_with_all_methods_need_not_derive_from_a_structure() -> None:
    results = lockstep(careful, {i: Duck() for i in AGENTS}, fleet_of(graph("ring")), 1)
    assert results[1].decision == [7.0]


def test_an_algorithm_without_declaration_is_not_restricted() -> None:
    def free(problem: object, me: Me) -> Dialogue[Result]:
        while not (yield {}, 0.0).stop:
            pass
        return me.result([1.0])

    assert needs_of(free) is None
    lockstep(free, {i: object() for i in AGENTS}, fleet_of(DIRECTED, weights="uneven"), 1)
