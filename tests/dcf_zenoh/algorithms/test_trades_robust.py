from functools import partial

import numpy as np
import pytest

from dcf_zenoh.algorithms.shared.mean_tracker import TrackerOptions
from dcf_zenoh.algorithms.trades import trades
from dcf_zenoh.algorithms.trades_robust import trades_robust
from dcf_zenoh.config import load
from dcf_zenoh.errors import AlgorithmError, ConfigurationError
from dcf_zenoh.graph import Graph
from dcf_zenoh.testing import Delay, check_algorithm, fleet_of, lockstep, lossy
from tests.support.references import INSTANCES, Reference

pytestmark = pytest.mark.no_cover  # many rounds of the same lines


def error(reference: Reference, algorithm: object, rounds: int, links: Delay) -> float:
    """Largest distance of a decision from the equilibrium."""
    results = lockstep(algorithm, reference.games, fleet_of(reference.graph), rounds, links=links)  # type: ignore[arg-type]
    return max(float(abs(each.decision - reference.expected("u_star", i)).max()) for i, each in results.items())


@pytest.mark.parametrize("name", INSTANCES)
@pytest.mark.parametrize(
    ("loss", "delay"),
    [
        (0.0, 0),
        (0.5, 0),
        (0.0, 5),
        (0.2, 3),
        *(pytest.param(*each, marks=pytest.mark.large) for each in ((0.05, 0), (0.2, 0), (0.0, 1))),
    ],
)
def test_it_finds_the_equilibrium_whatever_is_lost_or_late(name: str, loss: float, delay: int) -> None:
    assert error(Reference.read(name), trades_robust, 5000 if delay else 2200, lossy(1, loss, delay)) < 1e-9


@pytest.mark.parametrize("name", INSTANCES)
@pytest.mark.parametrize("loss", [0.2, pytest.param(0.5, marks=pytest.mark.large)])
def test_the_plain_method_ends_elsewhere_when_messages_are_lost(name: str, loss: float) -> None:
    reference = Reference.read(name)
    assert error(reference, trades, 2200, lossy(1, 0.0)) < 1e-9
    assert error(reference, trades, 2200, lossy(1, loss)) > 1e-3


def test_a_silent_neighbour_pulls_no_estimate_towards_zero() -> None:
    # Agent 3 is cut off in both directions: the others agree on the mean of the rest.
    reference = Reference.read("n4_complete_start")
    games, fleet = reference.games, fleet_of(reference.graph)
    lockstep(trades_robust, games, fleet, 800, links=lambda j, i, _: None if 3 in (i, j) else 0)
    ends = [games[i].contribution(fleet[i].noted["u"]) for i in (0, 1, 2)]
    for i in (0, 1, 2):
        np.testing.assert_allclose(fleet[i].noted["mean"][:2], np.mean(ends, axis=0), atol=1e-6)


def test_weights_need_not_be_doubly_stochastic() -> None:
    reference = Reference.read("n4_star_boxactive")
    fleet = fleet_of(reference.graph, weights="uniform")
    results = lockstep(trades_robust, reference.games, fleet, 2200)
    for i, result in results.items():
        np.testing.assert_allclose(result.decision, reference.expected("u_star", i), atol=1e-9)


@pytest.mark.parametrize("name", ["n4_complete_start", "n6_line_nonpotential"])
def test_it_keeps_the_contract(name: str) -> None:
    reference = Reference.read(name)
    check_algorithm(trades_robust, lambda: reference.games, reference.graph)


@pytest.mark.parametrize(
    ("tracker", "message"),
    [
        (TrackerOptions(renew=1.5), r"trades_robust: tracker.renew must be in \(0, 1\], not 1.5"),
        (TrackerOptions(penalty=0.0), r"trades_robust: tracker.penalty must be in \(0, inf\], not 0"),
    ],
)
def test_options_out_of_range_are_refused(tracker: TrackerOptions, message: str) -> None:
    reference = Reference.read("n4_complete_start")
    with pytest.raises(AlgorithmError, match=message):
        lockstep(partial(trades_robust, tracker=tracker), reference.games, fleet_of(reference.graph), 1)


def test_options_of_the_tracker_are_a_table_of_the_fleet_file() -> None:
    algorithm = load("position_swap_lossy", changes=["algorithm.tracker.penalty=2.0"]).spec.algorithm
    assert algorithm.options["tracker"] == {"penalty": 2.0, "renew": 0.9}
    with pytest.raises(ConfigurationError, match=r"no key 'penalty' any more: it is called 'tracker\.penalty'"):
        load("position_swap_lossy", changes=["algorithm.penalty=2.0"])


def test_links_without_an_opposite_are_refused() -> None:
    directed = Graph.of(range(4), [(0, 1), (1, 2), (2, 3), (3, 0)])
    with pytest.raises(AlgorithmError, match=r"links in both directions; agent 0 hears \[3\] and is heard by \[1\]"):
        lockstep(trades_robust, Reference.read("n4_complete_start").games, fleet_of(directed, weights="uniform"), 1)
