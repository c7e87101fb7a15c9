"""The free space that docs/hardware.md asks for: how far the emulated drone flies on when its link is cut."""

import re
from pathlib import Path

import numpy as np
import pytest

from plants.crazyflie.options import HardwareFlightOptions
from tests.support.model_flight import model_flight

DOCUMENT = Path(__file__).parents[4] / "docs" / "hardware.md"
ROW = re.compile(r"^ *\| ([\d.]+) m/s \| ([\d.]+) m \|(?: ([\d.]+) m)? *\| ([\d.]+) m \|$", re.MULTILINE)
ROWS = [(float(speed), float(far), float(free)) for speed, far, _, free in ROW.findall(DOCUMENT.read_text("utf-8"))]


def test_table_covers_the_speeds_of_flights() -> None:
    assert [speed for speed, _, _ in ROWS] == [0.2, 0.33, 0.5, 0.9, 1.0]


@pytest.mark.parametrize(("speed", "documented", "free"), ROWS)
def test_drone_whose_link_is_cut_lies_where_the_document_says(
    tmp_path: Path, speed: float, documented: float, free: float
) -> None:
    with model_flight(tmp_path, flight=HardwareFlightOptions(speed_max=2.0)) as flight:
        flight.hover(0.5)
        for _ in range(20):
            flight.autopilot.setpoints.follow(np.array([speed, 0.0]), 0.5)
            flight.run(0.2)
        cut_at = flight.position
        assert np.hypot(*flight.firmware.body.velocity[:2]) == pytest.approx(speed, abs=0.03)
        flight.silence(60.0)
        flight.run(6.0)
        assert np.linalg.norm(flight.firmware.body.velocity) < 1e-6
        far = float(np.hypot(*(flight.position - cut_at)[:2]))
    assert far == pytest.approx(documented, abs=0.05)
    assert 1.15 * documented < free  # a margin
