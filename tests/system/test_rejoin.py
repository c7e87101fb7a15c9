"""A daemon dies while the others fly on, and a person starts it again."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh import Run
from tests.support.command_line import Answer
from tests.support.daemons import Launch
from tests.support.waiting import until

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]

CHANGES = (
    "time.duration=20.0",
    "time.arrived.for=0.6",
    "faults.rule=[]",
    "faults.loss=0.1",
)


def rejoin(folder: Path, agent: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "agentd", "run", str(folder / "fleet.toml"), "--id", str(agent)]
    return subprocess.Popen([*command, "--out", str(folder), "--rejoin"], stderr=subprocess.PIPE, text=True)


@pytest.mark.timeout(90)
def test_an_agent_that_is_started_again_reaches_its_target(tmp_path: Path) -> None:
    with Launch("position_swap_lossy", tmp_path / "run", *CHANGES) as launch:
        os.kill(launch.flying(8)[2], signal.SIGKILL)

        def noticed() -> bool:
            logs = [launch.log(i) for i in (1, 3, 4)]
            return all(log is not None and "neighbour 2 is lost" in " ".join(log.remarks) for log in logs)

        until(noticed, "the others notice it")
        before = launch.log(2)
        again = rejoin(launch.folder, 2)
        assert again.communicate(timeout=40)[1] == ""
        assert again.returncode == 0
        assert launch.end() == 1  # an agent has died, whatever came later
        assert "agent 2 was killed by SIGKILL" in launch.errors
    run = Run.read(launch.folder)
    own = run.agents[2]
    assert before is not None
    assert own.lives == 2
    (joined,) = (event for event in own.events if event["event"] == "joined")
    gap = own.step[len(before.step)]
    assert joined["step"] == gap > before.step[-1] + 1
    moved = own.state[len(before.step)] - before.state[-1]
    speed = np.linalg.norm(before.state[-1, 2:])
    assert np.linalg.norm(moved[:2]) <= speed**2 / 2 + 1e-9  # it braked at 2 m/s² per axis from where it was
    assert run.complete
    assert run.arrival_time is not None
    assert run.barriers.min() > 0
    for j in (1, 3, 4):
        said = " ".join(run.agents[j].remarks)
        assert "neighbour 2 is lost (its liveliness token is gone)" in said
        assert "neighbour 2 is back" in said


def test_who_has_never_flown_cannot_join_again(
    tmp_path: Path, agentd: Callable[..., Answer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told = agentd("run", "position_swap_lossy", "--id", "2", "--out", tmp_path, "--rejoin")
    assert told.code == 1
    assert told.err == f"agentd: --rejoin: {tmp_path / 'agent-2.msgpack'}: cannot be read: No such file or directory\n"
    told = agentd("run", "position_swap_lossy", "--clock", "virtual", "--id", "2", "--out", tmp_path, "--rejoin")
    assert told.code == 2
    assert told.err == "agentd: --rejoin: only on the wall clock; a run in virtual time can be repeated instead\n"
