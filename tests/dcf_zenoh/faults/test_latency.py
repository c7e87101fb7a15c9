from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from dcf_zenoh.faults.fault import FaultLink
from dcf_zenoh.faults.latency import Latency
from dcf_zenoh.faults.profile import LinkProfile, write_profile
from tests.support.deliveries import CONFIDENCE, MS, S, alone, convey, delivery, latencies, link

FAST = (0.010, 0.012, 0.013, 0.02, 0.05)
SLOW = (0.100, 0.150, 0.3)
HERE = Path()


def latency(**options: Any) -> Latency:
    return Latency(FaultLink(1, 2, HERE), **options)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where ``links.json`` is, with the links from 1 to 2 and from 2 to 1."""
    write_profile(
        tmp_path / "links.json",
        [LinkProfile(1, 2, 100, 0, 0.0, FAST, 0.0), LinkProfile(2, 1, 100, 0, 0.0, SLOW, 0.0)],
    )
    return tmp_path


def agrees(fault: Latency, cdf: Callable[[Any], Any]) -> bool:
    """Whether many latencies are distributed as `cdf` says, by the test of Kolmogorov and Smirnov."""
    return bool(stats.kstest(latencies(convey(link(latency=fault))), cdf).pvalue > 1 - CONFIDENCE)


def test_a_constant_latency_is_added_in_whole_nanoseconds() -> None:
    given = delivery(entered=7)._replace(due=5 * S)
    (after,) = alone(latency(mean=0.0301234567891), given)
    assert after == given._replace(due=5 * S + 30_123_457)


def test_uniform_latency_is_uniform() -> None:
    assert agrees(latency(distribution="uniform", low=0.01, high=0.03), stats.uniform(0.01, 0.02).cdf)


@pytest.mark.parametrize(("mean", "std"), [(0.03, 0.005), (0.01, 0.02), (0.0, 0.01)])
def test_normal_latency_is_a_normal_one_truncated_at_zero(mean: float, std: float) -> None:
    fault = latency(distribution="normal", mean=mean, std=std)
    assert agrees(fault, stats.truncnorm(-mean / std, np.inf, loc=mean, scale=std).cdf)


@pytest.mark.parametrize(("mean", "std"), [(0.03, 0.01), (0.02, 0.025)])
def test_gamma_latency_has_its_mean_and_standard_deviation(mean: float, std: float) -> None:
    expected = stats.gamma((mean / std) ** 2, scale=std**2 / mean)
    assert (expected.mean(), expected.std()) == pytest.approx((mean, std))
    assert agrees(latency(distribution="gamma", mean=mean, std=std), expected.cdf)


def measured(x: Any, quantiles: tuple[float, ...]) -> Any:
    return np.interp(x, quantiles, np.linspace(0, 1, len(quantiles)))


def test_empirical_latency_is_that_of_the_link(folder: Path) -> None:
    fault = Latency(FaultLink(2, 1, folder), distribution="empirical", file="links.json")
    assert agrees(fault, lambda x: measured(x, SLOW))


def test_a_link_that_was_not_measured_is_like_all_others(folder: Path) -> None:
    fault = Latency(FaultLink(3, 1, folder), distribution="empirical", file="links.json")
    assert agrees(fault, lambda x: (measured(x, FAST) + measured(x, SLOW)) / 2)


def test_a_wrong_distribution_is_distinguished_from_the_right_one() -> None:
    assert not agrees(latency(distribution="normal", mean=0.03, std=0.01), stats.norm(0.03, 0.0105).cdf)


def test_messages_may_overtake_each_other_by_default() -> None:
    options = {"distribution": "uniform", "low": 0.0, "high": 0.02}
    free, ordered = (
        [each.due for passage in convey(link(latency=latency(reorder=reorder, **options)), 1000) for each in passage[0]]
        for reorder in (True, False)
    )
    assert sorted(free) != free
    assert sorted(ordered) == ordered
    assert ordered == list(np.maximum.accumulate(free))  # held back for the one before, no longer


@given(st.lists(st.integers(0, 50 * MS), min_size=2, max_size=50), st.floats(0, 0.1), st.floats(1e-6, 0.1))
def test_without_reordering_messages_come_in_order(gaps: list[int], mean: float, std: float) -> None:
    over = link(latency=latency(distribution="normal", mean=mean, std=std, reorder=False))
    entered = np.cumsum(gaps).tolist()
    came = [over.convey(delivery(number, at)).deliveries[0] for number, at in enumerate(entered)]
    assert all(each.due >= each.entered for each in came)
    assert all(a.due <= b.due for a, b in pairwise(came))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "mean is missing: distribution 'constant' takes mean"),
        ({"mean": -0.1}, "mean must be at least 0, in s, not -0.1"),
        ({"mean": 0.1, "std": 0.1}, "std is no key of distribution 'constant', which takes mean"),
        (
            {"distribution": "uniform", "mean": 0.1},
            "mean is no key of distribution 'uniform', which takes low and high",
        ),
        ({"distribution": "uniform", "low": 0.1}, "high is missing: distribution 'uniform' takes low and high"),
        ({"distribution": "uniform", "low": -1, "high": 1}, "low must be at least 0, in s, not -1"),
        ({"distribution": "uniform", "low": 0.2, "high": 0.1}, "high must be at least 0.2, in s, not 0.1"),
        ({"distribution": "normal", "mean": 0.1}, "std is missing: distribution 'normal' takes mean and std"),
        ({"distribution": "normal", "mean": -0.1, "std": 0.1}, "mean must be at least 0, in s, not -0.1"),
        ({"distribution": "normal", "mean": 0.1, "std": 0.0}, "std must be positive, in s, not 0.0"),
        ({"distribution": "gamma", "mean": 0.0, "std": 0.1}, "mean must be positive, in s, not 0.0"),
        (
            {"distribution": "gamma", "mean": 0.1, "std": 0.1, "file": "a"},
            "file is no key of distribution 'gamma', which takes mean and std",
        ),
        ({"distribution": "empirical"}, "file is missing: distribution 'empirical' takes file"),
        (
            {"distribution": "empirical", "file": "none.json"},
            "cannot read none.json: No such file or directory",
        ),
        (
            {"distribution": "pareto"},
            "distribution must be one of constant, uniform, normal, gamma, empirical, not 'pareto'",
        ),
    ],
)
def test_keys_that_do_not_fit_are_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole text is compared
        latency(**options)
    assert str(caught.value) == text
