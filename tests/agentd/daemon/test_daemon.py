import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.command_line import Answer

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]

LOUD = """
print("imported")
def loud(problem, me):
    while True:
        print("a round" * 1000)
        inbox = yield {"x": 1.0}, 1.0
        if inbox.stop:
            return me.result([1.0])
"""


def test_output_of_a_plug_in_disturbs_neither_the_launcher_nor_the_json(tmp_path: Path) -> None:
    (tmp_path / "loud.py").write_text(LOUD)
    for command in (["launch", "--clock", "virtual"], ["simulate"]):
        out = tmp_path / command[0]
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "agentd",
                *command,
                "average",
                "--json",
                "--no-report",
                "--out",
                str(out),
                "--algorithm",
                f"{tmp_path}/loud.py:loud",
                "--set",
                "exchange.max_rounds=50",
            ],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["rounds_per_step"]["max"] == 50
    assert (tmp_path / "launch" / "agent-1.err").read_text().startswith("imported\na round")


def test_start_that_failed_can_be_tried_again(trio: Path, tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    for _ in range(2):
        answer = agentd("run", trio, "--id", "1", "--out", tmp_path / "run", "--set", "zenoh.ready_timeout=0.1")
        assert answer.code == 1
        assert "agent 1: not ready within 0.1 s: nothing heard of agents 2, 3\n" in answer.err
