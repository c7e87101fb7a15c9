from itertools import groupby, pairwise
from math import sqrt
from typing import Any

import numpy as np
import pytest
from scipy import stats

from dcf_zenoh.faults.bursts import Bursts
from tests.support.deliveries import CONFIDENCE, MANY, Z, convey, link, lost


def share(p: float, r: float, loss_good: float = 0.0, loss_bad: float = 1.0) -> tuple[float, float]:
    """Share of lost messages, and its standard deviation over `MANY`: of a sum of correlated variables.

    The covariance of the loss of two messages that are k apart is that of the two states, which decays with the k-th
    power of the chain's second eigenvalue 1 - p - r.
    """
    bad = p / (p + r)
    mean = bad * loss_bad + (1 - bad) * loss_good
    decay = 1 - p - r
    variance = mean * (1 - mean) + 2 * bad * (1 - bad) * (loss_bad - loss_good) ** 2 * decay / (1 - decay)
    return mean, sqrt(variance / MANY)


def run_lengths(gone: list[bool]) -> list[int]:
    """Lengths of the runs of lost messages, without one that is cut off at either end."""
    runs = [(each, len(list(group))) for each, group in groupby(gone)][1:-1]
    return [length for each, length in runs if each]


@pytest.mark.parametrize(("mean_loss", "mean_length"), [(0.05, 4.0), (0.3, 1.0), (0.2, 12.5), (0.5, 2.0)])
def test_as_many_messages_are_lost_as_configured(mean_loss: float, mean_length: float) -> None:
    gone = lost(convey(link(bursts=Bursts(mean_loss=mean_loss, mean_length=mean_length))))
    r = 1 / mean_length
    mean, std = share(r * mean_loss / (1 - mean_loss), r)
    assert mean == pytest.approx(mean_loss)
    assert abs(sum(gone) / MANY - mean) < Z * std


def test_lengths_of_bursts_are_geometric() -> None:
    mean_length = 4.0
    lengths = run_lengths(lost(convey(link(bursts=Bursts(mean_loss=0.2, mean_length=mean_length)))))
    r = 1 / mean_length
    assert abs(np.mean(lengths) - mean_length) < Z * sqrt((1 - r) / r**2 / len(lengths))
    longest = int(np.log(5 / len(lengths)) / np.log(1 - r))  # so the tail is expected five times and more
    measured = [lengths.count(length) for length in range(1, longest + 1)] + [sum(x > longest for x in lengths)]
    expected = [*(stats.geom.pmf(range(1, longest + 1), r)), stats.geom.sf(longest, r)]
    assert stats.chisquare(measured, np.array(expected) * len(lengths)).pvalue > 1 - CONFIDENCE


def test_both_states_lose_as_configured() -> None:
    chain = {"good_to_bad": 0.02, "bad_to_good": 0.1, "loss_good": 0.01, "loss_bad": 0.7}
    gone = lost(convey(link(bursts=Bursts(**chain))))
    mean, std = share(*chain.values())
    assert abs(sum(gone) / MANY - mean) < Z * std


def test_first_message_finds_the_stationary_state() -> None:
    count, mean_loss = 5000, 0.3
    first = [
        lost(convey(link((0, 1, i), bursts=Bursts(mean_loss=mean_loss, mean_length=20.0)), 1))[0] for i in range(count)
    ]
    assert abs(sum(first) / count - mean_loss) < Z * sqrt(mean_loss * (1 - mean_loss) / count)


def test_a_certain_chain_alternates() -> None:
    gone = lost(convey(link(bursts=Bursts(good_to_bad=1.0, bad_to_good=1.0)), 100))
    assert all(a != b for a, b in pairwise(gone))


def test_a_chain_that_never_turns_bad_loses_nothing() -> None:
    assert not any(lost(convey(link(bursts=Bursts(mean_loss=0.0, mean_length=3.0)), 1000)))


def test_largest_loss_that_bursts_allow_is_one_message_between_two() -> None:
    gone = lost(convey(link(bursts=Bursts(mean_loss=2 / 3, mean_length=2.0)), 1000))
    assert {len(list(group)) for each, group in groupby(gone) if not each} == {1}


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "good_to_bad and bad_to_good must be given together, or mean_loss and mean_length"),
        ({"mean_loss": 0.1}, "mean_loss and mean_length must be given together"),
        ({"mean_length": 3.0}, "mean_loss and mean_length must be given together"),
        ({"good_to_bad": 0.1}, "good_to_bad and bad_to_good must be given together, or mean_loss and mean_length"),
        ({"loss_bad": 0.5}, "good_to_bad and bad_to_good must be given together, or mean_loss and mean_length"),
        (
            {"mean_loss": 0.1, "mean_length": 3.0, "loss_good": 0.1},
            "give mean_loss and mean_length, or good_to_bad and bad_to_good, not some of both",
        ),
        (
            {"mean_loss": 0.1, "bad_to_good": 0.1},
            "give mean_loss and mean_length, or good_to_bad and bad_to_good, not some of both",
        ),
        ({"mean_loss": 1.0, "mean_length": 3.0}, "mean_loss must be at least 0 and less than 1, not 1.0"),
        ({"mean_loss": 0.1, "mean_length": 0.5}, "mean_length must be at least 1, in messages, not 0.5"),
        (
            {"mean_loss": 0.9, "mean_length": 2.0},
            "mean_loss must be at most mean_length / (1 + mean_length) = 0.6667, not 0.9:"
            " there is at least one message between two bursts",
        ),
        ({"good_to_bad": 1.2, "bad_to_good": 0.1}, "good_to_bad must be a probability, from 0 to 1, not 1.2"),
        ({"good_to_bad": 0.1, "bad_to_good": -1}, "bad_to_good must be a probability, from 0 to 1, not -1"),
        ({"good_to_bad": 0.0, "bad_to_good": 0.0}, "good_to_bad and bad_to_good must not both be 0"),
        (
            {"good_to_bad": 0.1, "bad_to_good": 0.1, "loss_good": 2},
            "loss_good must be a probability, from 0 to 1, not 2",
        ),
    ],
)
def test_a_chain_that_cannot_be_is_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole text is compared
        Bursts(**options)
    assert str(caught.value) == text
