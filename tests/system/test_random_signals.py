"""Random signals to daemons and launcher at random instants: no body in the air, no process and no record is lost."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.daemons import PROCESSES

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.whole_fleet,
    pytest.mark.large,
    pytest.mark.skipif(not (PROCESSES / "self").exists(), reason="processes are found in /proc"),
]
COUNT = 30


@pytest.mark.timeout(300)
def test_random_signals_leave_no_body_in_the_air_no_process_and_lose_no_record(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.support.signal_storm", str(tmp_path), str(COUNT), "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=290, check=True)
    fleets = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(fleets) == COUNT
    assert [fleet for fleet in fleets if fleet["hung"] or fleet["faults"]] == []
    assert sum(fleet["flew"] == 3 for fleet in fleets) >= COUNT // 4
