"""A bad network in real time: four daemons on the wall clock, a fifth of all messages lost."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]


def test_the_robust_method_arrives_safely_in_real_time(tmp_path: Path) -> None:
    changes = ["faults.rule=[]", "faults.loss=0.2", "exchange.max_rounds=40", "exchange.round_timeout=0.003"]
    options = [word for change in changes for word in ("--set", change)]
    command = [sys.executable, "-m", "agentd", "launch", "position_swap_lossy", "--clock", "wall"]
    done = subprocess.run(
        [*command, *options, "--out", str(tmp_path / "run"), "--json", "--no-report"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["arrived"]
    assert summary["min_barrier"] >= 0.05
    assert 0.17 <= summary["lost_by"]["faults"]["loss"] / summary["messages"]["published"] <= 0.23
