"""Four Crazyflies change places at any sample time, with a horizon of 0.6 s."""

from math import ceil

import pytest

import dcf_zenoh

LARGE = [pytest.param(sample_time, marks=pytest.mark.large) for sample_time in (0.02, 1 / 30, 0.05, 0.2, 0.3)]


@pytest.mark.parametrize("sample_time", [*LARGE, 0.1])
def test_crazyflies_change_places_at_any_sample_time(sample_time: float) -> None:
    """Under the reference "velocity" h is -0.19 at 0.05 s."""
    changes = [
        f"time.sample_time={sample_time}",
        f"exchange.budget={0.75 * sample_time}",
        f"problem.prediction.horizon={max(3, ceil(0.6 / sample_time - 1e-9))}",
    ]
    run = dcf_zenoh.simulate("position_swap", plant="twin", changes=changes)
    assert run.between_samples
    assert run.summary()["min_barrier"] >= 0
    assert run.arrival_time is not None
