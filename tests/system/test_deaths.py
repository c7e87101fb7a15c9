"""Agents that die at random instants: whenever it is, the others come to an end of their own."""

import json
import subprocess
import sys
from typing import Any

import pytest

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]

STEPS = 16  # of the fleet


@pytest.fixture(scope="module", params=[20, pytest.param(50, marks=pytest.mark.large)])
def fleets(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What became of so many fleets."""
    folder = tmp_path_factory.mktemp("kills")
    command = [sys.executable, "-m", "tests.support.kills", str(folder), str(request.param), "7"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=True)
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == request.param
    return found


@pytest.mark.timeout(120)
def test_nobody_hangs_whenever_an_agent_is_killed(fleets: list[dict[str, Any]]) -> None:
    for fleet in fleets:
        for code, steps, end, error in fleet["survivors"].values():
            if code == 0:  # it flew on and recorded all of it
                assert (steps, end) == (STEPS, "done"), fleet
            else:  # the victim died before the fleet had started
                assert error.startswith("NotReady"), fleet
                assert "1" in error or "2" in error or "3" in error, fleet
                assert fleet["steps_of_victim"] == 0, fleet


@pytest.mark.timeout(120)
def test_the_kills_fell_before_the_start_in_flight_and_after_the_end(fleets: list[dict[str, Any]]) -> None:
    before = [fleet for fleet in fleets if fleet["killed"] and not fleet["steps_of_victim"]]
    flying = [fleet for fleet in fleets if fleet["killed"] and fleet["steps_of_victim"]]
    after = [fleet for fleet in fleets if not fleet["killed"]]
    assert len(before) >= len(fleets) // 16
    assert len(flying) >= len(fleets) // 5
    assert len(after) >= 1
