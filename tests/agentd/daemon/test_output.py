"""Output that nothing takes: a pipe that is not read, a disk that is full or stalls."""

import fcntl
import os
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import pytest

from agentd.daemon.output import BackgroundStream, LogFile, StatusPipe
from agentd.run_directory import read_run_json
from tests.support.daemons import TRIO, Launch
from tests.support.waiting import until

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]
SMALL_PIPES = """
import fcntl, os
def small(pipe=os.pipe):
    ends = pipe()
    fcntl.fcntl(ends[1], fcntl.F_SETPIPE_SZ, 4096)
    return ends
os.pipe = small
"""


@contextmanager
def small_pipe() -> Iterator[tuple[int, int]]:
    """A pipe with room for 4096 bytes."""
    reading, writing = os.pipe()
    try:
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
        yield reading, writing
    finally:
        os.close(reading)
        os.close(writing)


def test_status_pipe_that_is_not_read_drops_whole_lines_and_counts_them() -> None:
    with small_pipe() as (reading, writing):
        status = StatusPipe(writing)
        for number in range(100):
            status.write(f"{number:099d}")
        assert status.dropped == 60
        first = os.read(reading, 4096).split(b"\n")
        status.write("at last")
        assert [int(line) for line in first[:-1]] == [*range(40)]
        assert os.read(reading, 4096) == b"at last\n"


def test_status_line_that_was_written_in_part_is_completed_before_the_next() -> None:
    with small_pipe() as (reading, writing):
        status = StatusPipe(writing)
        status.write("x" * 6000)  # longer than what a pipe takes as a whole
        status.write("dropped")
        assert os.read(reading, 4096) == b"x" * 4096
        status.write("next")
        assert os.read(reading, 4096) == b"x" * (6000 - 4096) + b"\nnext\n"
        assert status.dropped == 1


def test_standard_error_that_is_not_read_holds_nothing_up_and_drops_lines() -> None:
    with small_pipe() as (reading, writing):
        stream = BackgroundStream(writing)
        began = time.monotonic()
        for _ in range(20_000):
            print("y" * 99, file=stream)
        assert time.monotonic() - began < 2.0
        assert stream.dropped == pytest.approx(20_000 - 2**20 / 100, abs=60)
        received = b""
        while b"dropped" not in received:
            received += os.read(reading, 65536)
        assert received.endswith(f"agentd: {stream.dropped} lines were dropped here: nothing took them\n".encode())


def unbuffered(descriptor: int) -> BinaryIO:
    return os.fdopen(descriptor, "wb", buffering=0, closefd=False)


def test_log_on_a_stalled_disk_is_warned_of_once_and_loses_nothing() -> None:
    warnings: list[str] = []
    with small_pipe() as (reading, writing):
        log = LogFile(unbuffered(writing), warnings.append)
        began = time.monotonic()
        for number in range(99):
            log.write(f"{number:0200d}".encode())
        assert time.monotonic() - began < 0.5
        assert warnings == []
        time.sleep(0.25)  # the disk stalls that long
        log.write(f"{99:0200d}".encode())
        assert warnings == ["the disk takes longer than 0.2 s for a record of the log; the agent goes on"]
        received = b""
        while len(received) < 100 * 200:
            received += os.read(reading, 65536)
        log.close()
        assert received == b"".join(f"{number:0200d}".encode() for number in range(100))
        assert log.failure == ""
        assert log.longest > 0.2
        assert warnings[1:] == [f"the disk took {log.longest:.2f} s for a record of the log at worst"]


def test_log_on_a_full_disk_is_warned_of_once() -> None:
    warnings: list[str] = []
    with Path("/dev/full").open("wb", buffering=0) as full:
        log = LogFile(full, warnings.append)
        for _ in range(10):
            assert log.write(b"record") == 6
        log.close()
    assert log.failure == "cannot write the log: No space left on device"
    assert warnings == [f"{log.failure}; the agent goes on without it"]


SMALL_FILES = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (8000, 8000))"  # as on a full disk


def test_fleet_flies_on_to_its_end_on_a_full_disk_and_its_result_is_printed(tmp_path: Path) -> None:
    (tmp_path / "trio.toml").write_text(TRIO)
    fast = ["time.sample_time=0.05", "time.duration=3.0"]
    with Launch(tmp_path / "trio.toml", tmp_path / "run", *fast, before=SMALL_FILES) as launch:
        assert launch.end(40.0) == 1
        *lines, last = (line for line in launch.errors.splitlines() if not line.startswith("agentd: note: "))
        assert len(lines) == 3
        for i, line in enumerate(sorted(lines), start=1):
            assert line.startswith(f"agentd: agent {i} ended with exit code 5 ")
            assert line.endswith(
                f", after step 59: agent {i}: reached its end, but its log is incomplete:"
                " cannot write the log: File too large"
            )
        assert last.endswith("; and 2 more, see above")
        assert launch.about["exit_codes"] == {"1": 5, "2": 5, "3": 5}
        assert 3 < launch.summary["steps"] < 60


@pytest.mark.large
def test_fleet_flies_on_to_its_end_when_its_directory_is_removed(tmp_path: Path) -> None:
    (tmp_path / "trio.toml").write_text(TRIO)
    with Launch(tmp_path / "trio.toml", tmp_path / "run", "time.duration=4.0") as launch:
        launch.flying()
        shutil.rmtree(launch.folder)
        assert launch.end(40.0) == 1
        missing = f"agentd: {launch.folder}/run.json: cannot be written: No such file or directory"
        assert launch.errors.splitlines() == [missing, missing]


@pytest.mark.large
def test_fleet_flies_on_to_its_end_when_its_directory_is_renamed_and_its_result_is_printed(tmp_path: Path) -> None:
    (tmp_path / "trio.toml").write_text(TRIO)
    with Launch(tmp_path / "trio.toml", tmp_path / "run", "time.duration=4.0") as launch:
        launch.flying()
        launch.folder.rename(tmp_path / "elsewhere")
        assert launch.end(40.0) == 1
        renamed = f"agentd: {launch.folder}: the run directory was renamed to {tmp_path}/elsewhere"
        assert launch.errors.splitlines() == [renamed, renamed]
        assert launch.summary["steps_of_all"] == 20
        assert read_run_json(tmp_path / "elsewhere")["exit_codes"] == {"1": 0, "2": 0, "3": 0}


def test_fleet_flies_on_while_its_launcher_is_stopped(tmp_path: Path) -> None:
    (tmp_path / "trio.toml").write_text(TRIO)
    fast = ["time.sample_time=0.05", "time.duration=30.0"]
    with Launch(tmp_path / "trio.toml", tmp_path / "run", *fast, before=SMALL_PIPES) as launch:
        launch.flying()
        launch.process.send_signal(signal.SIGSTOP)  # as Ctrl-Z does

        def flown() -> int:
            return min(len(log.step) for i in (1, 2, 3) if (log := launch.log(i)))

        before = flown()  # a pipe has room for 40 lines of status
        until(lambda: flown() > before + 60, "the fleet flies on", 10.0)
        launch.process.send_signal(signal.SIGCONT)
        launch.process.send_signal(signal.SIGINT)
        assert launch.end() == 130
        for i in (1, 2, 3):
            assert "status lines were dropped: the launcher did not read them" in (
                (launch.folder / f"agent-{i}.err").read_text()
            )
