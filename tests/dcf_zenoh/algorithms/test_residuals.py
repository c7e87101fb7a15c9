"""Residuals that are small at all agents in the same round mean that the answer is near: a fleet stops there."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import load
from dcf_zenoh.problems.average import Average
from dcf_zenoh.testing import fleet_of, lockstep
from tests.support.answers import TOPOLOGIES, Problems, allocation, cournot, each, everywhere, graph, quadratic

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

Case = tuple[Callable[[], Problems], dict[int, Array]]

SQUARES: Case = (quadratic, everywhere(1.0))
# At the first two steps from 0 every agent's own estimate stays where it is, at one bound or the other.
BOUNDED: Case = (lambda: quadratic(lower=0.0, upper=0.5), everywhere(0.5))
VALUES: Case = (lambda: {i: Average(value=float(i % 2)) for i in range(1, 5)}, everywhere(0.5))
ALLOCATION: Case = (allocation, each(4.0, 3.0, 1.5, 1.5))
MARKET: Case = (cournot, each(3.0, 2.0, 1.0, 0.0))
CAPPED: Case = (lambda: cournot(capacity=4.0), each(7 / 3, 4 / 3, 1 / 3, 0.0))

CASES: dict[str, list[Case]] = {
    "average_consensus": [VALUES],
    "push_sum": [VALUES],
    "subgradient": [SQUARES, BOUNDED, VALUES],
    "gradient_tracking": [SQUARES, VALUES],
    "push_pull": [SQUARES, VALUES],
    "extra": [SQUARES, VALUES],
    "exact_diffusion": [SQUARES, VALUES],
    "consensus_admm": [SQUARES, BOUNDED, VALUES],
    "edge_admm": [SQUARES, BOUNDED, VALUES],
    "admm_tracking_gradient": [SQUARES, VALUES],
    "dual_decomposition": [SQUARES, BOUNDED, VALUES],
    "dual_subgradient": [ALLOCATION],
    "tracking_admm": [ALLOCATION],
    "pseudo_gradient_partial": [MARKET],
    "trades_primal": [MARKET],
    "trades": [MARKET, CAPPED],
    "trades_robust": [MARKET, CAPPED],
    "admm_mpc": [CAPPED],
}


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("kind", CASES)
def test_a_fleet_that_agrees_to_stop_is_near_its_answer(kind: str, topology: str) -> None:
    def agreed(_number: int, residuals: Mapping[int, float]) -> bool:
        return max(residuals.values()) < 1e-3

    for problems, answer in CASES[kind]:
        algorithm = load("algorithms", kind, Path())
        results = lockstep(algorithm, problems(), fleet_of(graph(topology)), 2000, after_round=agreed)
        assert max(float(abs(results[i].decision - answer[i]).max()) for i in answer) < 0.1
