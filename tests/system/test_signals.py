"""Signals to daemons and to the launcher: every one that can be caught lands, and nothing is left behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from agentd.daemon.signals import CTRL_Z, ENDING, CaughtSignals
from dcf_zenoh import Run
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name
from tests.support.bodies import Sandbox
from tests.support.daemons import PROCESSES, Launch
from tests.support.waiting import until

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.whole_fleet,
    pytest.mark.skipif(not (PROCESSES / "self").exists(), reason="processes are found in /proc"),
]
CHANGES = ["time.clock='wall'", "time.duration=60.0", "safety.neighbour_silent.then='continue'"]


@pytest.fixture
def sandbox(tmp_path: Path) -> Sandbox:
    found = Sandbox(tmp_path)
    found.write(duration=60.0)
    return found


@contextmanager
def started_by_hand(sandbox: Sandbox, folder: Path, *changes: str) -> Iterator[dict[int, subprocess.Popen[str]]]:
    """One daemon for each agent, without a launcher. Nothing reads their standard error."""
    words = [sys.executable, "-m", "agentd", "run", str(sandbox.file), "--out", str(folder)]
    words += [word for change in [*CHANGES, *changes] for word in ("--set", change)]
    port = 33000 + os.getpid() % 2000 * 8
    words += ["--set", f"zenoh.base_port={port}"]
    daemons = {
        i: subprocess.Popen(
            [*words, "--id", str(i)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            text=True, start_new_session=True,
        )
        for i in (1, 2, 3)
    }  # fmt: skip
    try:
        yield daemons
    finally:
        for daemon in daemons.values():
            daemon.kill()
            daemon.wait(10)
            assert daemon.stderr is not None
            daemon.stderr.close()


def steps(folder: Path, agent: int) -> int:
    path = folder / log_name(agent)
    data = path.read_bytes() if path.is_file() else b""
    return len(AgentLog.read(data, path.name).step) if data else 0


def test_every_signal_that_would_end_or_stop_a_daemon_is_caught() -> None:
    named = {signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGUSR1, signal.SIGALRM}
    assert named <= ENDING
    assert signal.SIGRTMAX in ENDING
    assert {signal.SIGTSTP} == CTRL_Z
    heard: list[int] = []
    numbers = sorted((ENDING | CTRL_Z) - {signal.SIGALRM})  # pytest has a handler of its own for this one
    for number in numbers:
        with CaughtSignals(ENDING | CTRL_Z) as signals:
            signal.raise_signal(number)
            until(lambda caught=signals: caught.number is not None, "it is heard", 5.0)  # type: ignore[misc]
            signals.react(heard.append)  # called at once
    assert heard == numbers


OPENING = """
import os, signal, sys
from dcf_zenoh.messaging.network import Network
declare = Network._declare_publisher
def interrupted(*words):
    os.kill(os.getpid(), signal.SIGINT)
    return declare(*words)
Network._declare_publisher = interrupted
from agentd.__main__ import main
sys.exit(main())
"""


def test_ctrl_c_while_a_session_is_being_opened_ends_the_process(sandbox: Sandbox, tmp_path: Path) -> None:
    words = ["run", str(sandbox.file), "--clock", "wall", "--id", "1", "--out", str(tmp_path / "run")]
    done = subprocess.run(
        [sys.executable, "-c", OPENING, *words], capture_output=True, text=True, timeout=20, check=False
    )
    assert done.stderr == "agentd: agent 1: stopped by SIGINT before all neighbours were ready\n"
    assert done.returncode == 130


def test_a_closed_terminal_ctrl_backslash_and_ctrl_z_land_daemons_that_were_started_by_hand(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    numbers = {1: signal.SIGHUP, 2: signal.SIGQUIT, 3: signal.SIGTSTP}
    folder = tmp_path / "run"
    with started_by_hand(sandbox, folder) as daemons:
        until(lambda: all(steps(folder, i) >= 3 for i in daemons), "all fly", 60.0)
        for i, daemon in daemons.items():
            daemon.send_signal(numbers[i])
        for i, daemon in daemons.items():
            assert daemon.wait(5.0) == 128 + numbers[i]
            assert daemon.stderr is not None
            assert daemon.stderr.read().endswith(f"agentd: stopped by {numbers[i].name}\n")
    for i, log in Run.read(folder).agents.items():
        assert sandbox.of(i)[-2:] == ["finish stopped", "close"]
        assert log.end is not None
        assert (log.end["end"], log.end["remark"]) == ("stopped", f"stopped by {numbers[i].name}")


@pytest.mark.large
def test_daemon_whose_algorithm_hangs_switches_its_motors_off_and_ends_after_a_signal(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    (tmp_path / "hang.py").write_text(
        "def hang(problem, me):\n"
        "    inbox = yield {'x': 0.0}, 1.0\n"
        "    step = me.recall('step', 0)\n"
        "    while step == 3 and me.id == 2:\n        pass\n"
        "    return me.result(problem.start(me.last), step=step + 1)\n"
    )
    folder = tmp_path / "run"
    with started_by_hand(sandbox, folder, "algorithm.kind='./hang.py:hang'") as daemons:
        until(lambda: steps(folder, 3) > 6, "agent 2 hangs", 60.0)
        daemons[2].send_signal(signal.SIGTERM)
        assert daemons[2].wait(8.0) == 128 + signal.SIGTERM  # 2.5 s, and 1 s for the landing
        assert sandbox.of(2)[-1] == "emergency"
        flown = steps(folder, 1)
        until(lambda: steps(folder, 1) > flown + 3, "the others fly on")


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGKILL, marks=pytest.mark.large)])
def test_others_go_on_whichever_signal_ended_one_agent(
    number: signal.Signals, sandbox: Sandbox, tmp_path: Path
) -> None:
    with Launch(sandbox.file, tmp_path / "run", *CHANGES, "time.duration=5.0") as launch:
        os.kill(launch.flying()[2], number)
        assert launch.end(30.0) == 1
        run = Run.read(launch.folder)
        for i in (1, 3):
            assert len(run.agents[i].step) == 25
            end = run.agents[i].end
            assert end is not None
            assert end["end"] == "done"
        assert run.about["exit_codes"] == {"1": 0, "2": -9 if number == signal.SIGKILL else 128 + number, "3": 0}


@pytest.mark.large
def test_launcher_that_gets_sigquit_lands_all(sandbox: Sandbox, tmp_path: Path) -> None:
    with Launch(sandbox.file, tmp_path / "run", *CHANGES) as launch:
        launch.flying()
        launch.process.send_signal(signal.SIGQUIT)
        assert launch.end() == 128 + signal.SIGQUIT
    for i in (1, 2, 3):
        assert sandbox.of(i)[-2:] == ["finish stopped", "close"]
