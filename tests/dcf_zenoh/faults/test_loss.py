from itertools import pairwise
from math import nan, sqrt

import pytest

from dcf_zenoh.faults.loss import Loss
from tests.support.deliveries import MANY, Z, convey, link, lost


def test_total_loss_drops_every_message() -> None:
    assert all(lost(convey(link(loss=Loss(probability=1.0)), 1000)))


def test_no_loss_drops_none() -> None:
    assert not any(lost(convey(link(loss=Loss(probability=0.0)), 1000)))


@pytest.mark.parametrize("probability", [0.01, 0.2, 0.5])
def test_as_many_messages_are_lost_as_configured(probability: float) -> None:
    share = sum(lost(convey(link(loss=Loss(probability=probability))))) / MANY
    assert abs(share - probability) < Z * sqrt(probability * (1 - probability) / MANY)  # binomial


def test_losses_are_independent() -> None:
    p = 0.3
    gone = lost(convey(link(loss=Loss(probability=p))))
    after = [b for a, b in pairwise(gone) if a]
    assert abs(sum(after) / len(after) - p) < Z * sqrt(p * (1 - p) / len(after))


@pytest.mark.parametrize("value", [-0.1, 1.5, nan])
def test_a_loss_that_is_no_probability_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match=rf"^probability must be a probability, from 0 to 1, not {value}$"):
        Loss(probability=value)
