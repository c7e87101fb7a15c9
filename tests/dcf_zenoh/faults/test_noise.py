from math import sqrt

import numpy as np
import pytest
from scipy import stats

from dcf_zenoh.faults.noise import Noise
from tests.support.deliveries import CONFIDENCE, Z, alone, convey, delivery, link


def test_noise_is_gaussian_and_independent() -> None:
    std, count = 0.3, 100_000
    given = delivery(payload={"x": np.arange(float(count))})
    (after,) = alone(Noise(std=std), given)
    error = np.asarray(after.message.payload["x"]) - np.asarray(given.message.payload["x"])
    assert stats.kstest(error, stats.norm(0, std).cdf).pvalue > 1 - CONFIDENCE
    assert abs(np.corrcoef(error[:-1], error[1:])[0, 1]) < Z / sqrt(count)


def test_noise_differs_from_message_to_message() -> None:
    first, second = (passage.deliveries[0].message.payload["x"] for passage in convey(link(noise=Noise(std=1.0)), 2))
    assert np.all(first != second)


def test_only_real_numbers_are_noisy() -> None:
    given = delivery(payload={
        "x": np.zeros(2), "f": np.zeros((2, 2), "f4"), "point": np.float64(1.0), "scalar": np.array(2.0),
        "n": 3, "ids": np.arange(3), "free": np.array([True, False]),
    })  # fmt: skip
    before, (after,) = given.message.payload, alone(Noise(std=0.1), given)
    payload = after.message.payload
    assert list(payload) == list(before)
    for name in ("x", "f", "point", "scalar"):
        assert np.all(payload[name] != before[name]), name
        assert type(payload[name]) is type(before[name])
        assert np.asarray(payload[name]).dtype == np.asarray(before[name]).dtype
        assert np.shape(payload[name]) == np.shape(before[name])
    for name in ("n", "ids", "free"):
        assert payload[name] is before[name]


def test_only_what_is_named_is_noisy() -> None:
    given = delivery(payload={"x": 1.0, "y": 1.0})
    (after,) = alone(Noise(std=0.1, names=("y", "of another phase")), given)
    assert after.message.payload["x"] == 1.0
    assert after.message.payload["y"] != 1.0


def test_the_message_of_the_others_stays_as_it_was() -> None:
    given = delivery(payload={"x": np.ones(2)})
    (after,) = alone(Noise(std=1.0), given)
    assert np.all(given.message.payload["x"] == 1.0)
    assert not after.message.payload["x"].flags.writeable  # type: ignore[union-attr]
    assert after._replace(message=given.message) == given


def test_what_is_too_large_overflows_without_a_warning() -> None:
    given = delivery(payload={"x": np.full(2, 3e38, "f4")})
    (after,) = alone(Noise(std=1e300), given)
    assert np.all(np.isinf(after.message.payload["x"]))


def test_negative_noise_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^std must be at least 0, not -1$"):
        Noise(std=-1)
