"""Daemons as child processes, forked by a server or spawned one by one."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from agentd.launcher.child_process import FORKS_FROM, AdoptedProcess, ChildProcess, ProcessStarter
from tests.support.waiting import until

pytestmark = pytest.mark.real_time
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems do not adopt orphans")
ENDLESS = ("emulate-crazyflie", "--port", "0")


@pytest.fixture(scope="module")
def starter() -> Iterator[ProcessStarter]:
    with ProcessStarter(FORKS_FROM) as server:
        yield server


@contextmanager
def started(starter: ProcessStarter, folder: Path, *arguments: str) -> Iterator[ChildProcess]:
    """Start a process; kill it at the end."""
    with (folder / "errors").open("w", encoding="utf-8") as errors:
        process = starter.start(arguments, errors)
    assert process.stdin is not None
    assert process.stdout is not None
    with process.stdin, process.stdout:
        yield process
        process.kill()
        process.wait(5)


@linux
def test_a_forked_daemon_ends_with_the_output_and_exit_code_of_a_spawned_one(
    starter: ProcessStarter, tmp_path: Path
) -> None:
    found = []
    for each in (starter, ProcessStarter(1)):
        with started(each, tmp_path, "check", "no_such_fleet") as process:
            assert isinstance(process, AdoptedProcess) == (each is starter)
            assert process.stdout is not None
            found.append((process.stdout.read(), process.wait(20), (tmp_path / "errors").read_text()))
    assert found[0] == found[1]
    assert found[0][1] == 2
    assert "no_such_fleet" in found[0][2]


@linux
def test_a_forked_daemon_is_a_child_with_a_session_and_a_title_of_its_own(
    starter: ProcessStarter, tmp_path: Path
) -> None:
    with started(starter, tmp_path, *ENDLESS) as process:
        assert f"PPid:\t{os.getpid()}\n" in Path(f"/proc/{process.pid}/status").read_text()
        until(lambda: os.getsid(process.pid) == process.pid, "a session of its own", 5)
        until(lambda: "-m agentd emulate-c" in Path(f"/proc/{process.pid}/cmdline").read_text(), "its title", 5)
        assert process.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.01)
        process.kill()
        assert process.wait(5) == -signal.SIGKILL
        process.terminate()  # it has ended: nothing happens


@linux
def test_daemons_outlive_their_server_and_are_spawned_without_it(tmp_path: Path) -> None:
    with ProcessStarter(FORKS_FROM) as starter, started(starter, tmp_path, *ENDLESS) as before:
        server = starter._server
        assert server is not None
        server.kill()
        server.wait()
        with started(starter, tmp_path, "--version") as after:
            assert isinstance(after, subprocess.Popen)
            assert after.stdout is not None
            assert after.stdout.read().startswith("dcf-zenoh ")
        assert isinstance(before, AdoptedProcess)
        assert before.poll() is None


def test_a_few_daemons_need_no_server() -> None:
    with ProcessStarter(FORKS_FROM - 1) as starter:
        assert starter._server is None
