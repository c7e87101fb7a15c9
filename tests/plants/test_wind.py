import numpy as np
import pytest

from plants.wind import Wind, WindOptions


def test_wind_without_gusts_is_its_mean() -> None:
    wind = Wind(WindOptions((1.0, -2.0)), rng=np.random.default_rng(0))
    wind.step(1.0)
    np.testing.assert_array_equal(wind.velocity, [1.0, -2.0, 0.0])


@pytest.mark.parametrize("step", [0.01, 0.5])
def test_gusts_have_the_spread_and_memory_asked_for_whatever_the_step(step: float) -> None:
    wind = Wind(WindOptions((3.0, 0.0, 0.5), gusts=0.5, gust_time=0.5), rng=np.random.default_rng(1))
    ahead, values = round(0.5 / step), []
    for _ in range(2000 * ahead):
        wind.step(step)
        values.append(wind.velocity)
    gusts = np.array(values) - [3.0, 0.0, 0.5]
    np.testing.assert_array_equal(gusts[:, 2], 0)
    np.testing.assert_allclose(gusts[:, :2].std(axis=0), 0.5, rtol=0.08)
    remembered = np.mean(gusts[ahead:, :2] * gusts[:-ahead, :2], axis=0) / 0.5**2
    np.testing.assert_allclose(remembered, np.exp(-1), atol=0.08)
