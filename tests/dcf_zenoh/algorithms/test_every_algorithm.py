"""Every installed algorithm keeps the contract, on a path and with any neighbours missing."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from dcf_zenoh.algorithms.needs import needs_of
from dcf_zenoh.plugins import known, load
from dcf_zenoh.problems.average import Average
from dcf_zenoh.testing import check_algorithm
from tests.support.answers import AGENTS, Problems, allocation, cournot, graph, quadratic
from tests.support.references import Reference
from tests.support.swaps import distance_moment


def values() -> Problems:
    return {i: Average(value=[float(i), -1.0]) for i in AGENTS}


def swap() -> Problems:
    return dict(Reference.read("n4_complete_start").games)


def distances() -> Problems:
    return dict(distance_moment(0, AGENTS)[0])


PROBLEMS: dict[str, list[Callable[[], Problems]]] = {
    "average_consensus": [values],
    "push_sum": [values],
    "dual_subgradient": [allocation],
    "tracking_admm": [allocation],
    "pseudo_gradient": [cournot],
    "pseudo_gradient_partial": [cournot],
    "trades_primal": [cournot],
    "admm_mpc": [lambda: cournot(capacity=4.0), swap],
    "sqp_admm": [distances],
    "trades": [lambda: cournot(capacity=4.0), swap],
    "trades_robust": [lambda: cournot(capacity=4.0), swap],
    "centralised": [quadratic, allocation, cournot, swap],
}


@pytest.mark.parametrize("kind", sorted(known("algorithms")))
def test_every_kind_keeps_the_contract(kind: str) -> None:
    algorithm = load("algorithms", kind, Path())
    for problems in PROBLEMS.get(kind, [quadratic, values]):
        agents = tuple(problems())
        for topology in ("complete",) if kind == "pseudo_gradient" else ("complete", "path"):
            check_algorithm(algorithm, problems, graph(topology, agents))


@pytest.mark.parametrize("kind", sorted(known("algorithms")))
def test_every_kind_declares_its_needs_and_its_source(kind: str) -> None:
    algorithm = load("algorithms", kind, Path())
    assert needs_of(algorithm) is not None
    document = f"{algorithm.__doc__}{__import__(algorithm.__module__, fromlist=['_']).__doc__}"
    assert re.search("Sources?: ", document) or kind == "centralised"
    assert "residual" in document
