"""Messages near and beyond all bounds: none raises anything but the refusal, and the flight goes on."""

import random
import resource
from pathlib import Path

import pytest

from tests.support.storms import forged_goodbyes, through_a_fleet, through_the_codec, through_the_receiver

MEMORY = 128 * 1024  # KiB by which a process may grow


@pytest.mark.parametrize("count", [8_000, pytest.param(500_000, marks=pytest.mark.large)])
def test_codec_and_receiver_refuse_what_is_beyond_their_bounds(count: int) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    codec = through_the_codec(random.Random(1), count)
    assert count // 2 < codec["refused"] < count
    found = through_the_receiver(random.Random(2), count)
    assert found["refused"] > count // 2
    assert found["healed"] >= found["of"] - 2  # the first may still wait for a message that a forged number promised
    assert max(codec["slowest"], found["slowest"]) < 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEMORY


@pytest.mark.large
@pytest.mark.real_time
@pytest.mark.timeout(120)
def test_fleet_flies_on_through_a_storm(tmp_path: Path) -> None:
    found = through_a_fleet(random.Random(3), tmp_path)
    assert found["code"] == 0
    assert all(end in ("arrived", "done") for end in found["ends"])
    assert min(found["refused"]) > 100
    assert max(found["logged"]) < 4096


@pytest.mark.real_time
def test_forged_goodbyes_end_no_flight(tmp_path: Path) -> None:
    found = forged_goodbyes(tmp_path)
    assert found["sent"] == 4
    assert found["code"] == 0
    assert all(end in ("arrived", "done") for end in found["ends"])
