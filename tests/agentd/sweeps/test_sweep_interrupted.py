"""Sweeps that do not go as planned: interrupted, terminated, with runs that fail or kill their process."""

import csv
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from agentd.cli import main
from agentd.sweeps.workers import WorkerDied, run_in_processes
from tests.support.command_line import Answer
from tests.support.waiting import until

pytestmark = pytest.mark.real_time

LONG = ("position_swap", "--vary", "exchange.max_rounds=20,30,40", "--seeds", "4", "--set", "time.duration=2.0")
MINE = """
import os
from dcf_zenoh.algorithms.trades import trades


def mine(game, me, *, mode: str = "good"):
    if mode == "raises":
        raise ValueError("not today")
    if mode == "dies":
        os._exit(7)
    return (yield from trades(game, me))
"""


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "sweep.csv").open() as stream:
        return list(csv.DictReader(stream))


def gone(group: int) -> bool:
    """Return whether a process group has no process left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The table of the sweep when nothing interrupts it."""
    folder = tmp_path_factory.mktemp("whole") / "sweep"
    assert main(["sweep", *LONG, "--no-oracle", "--out", str(folder)]) == 0
    return (folder / "sweep.csv").read_bytes()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_sweep_ends_all_its_processes_and_goes_on(
    number: signal.Signals, whole: bytes, tmp_path: Path, agentd: Callable[..., Answer]
) -> None:
    out = tmp_path / "sweep"
    command = [sys.executable, "-m", "agentd", "sweep", *LONG, "--no-oracle", "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        until(lambda: len(list((out / "rows").glob("*.json"))) >= 2 or process.poll() is not None, "two runs", 60)
        assert process.poll() is None
        process.send_signal(number)
        errors = process.communicate(timeout=20)[1]
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 128 + number
    there = len(list((out / "rows").glob("*.json")))
    assert f"{there} of 12 runs are in {out}" in errors
    until(lambda: gone(process.pid), "all its processes have ended", 5)
    answer = agentd("sweep", *LONG, "--no-oracle", "--out", out)
    assert f"{there} of 12 runs were there already" in answer.err
    assert (out / "sweep.csv").read_bytes() == whole


def test_a_run_that_fails_is_a_row_and_the_others_go_on(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    options = ("--set", f"algorithm.kind={tmp_path}/mine.py:mine", "--set", "time.duration=0.4", "--no-oracle")
    out = tmp_path / "sweep"
    vary = ("--vary", "algorithm.mode=good,raises,dies", "--seeds", "2")
    answer = agentd("sweep", "position_swap", *vary, *options, "--out", out)
    assert answer.code == 1
    failed = {(row["algorithm.mode"], row["seed"]): row["failed"] for row in rows(out)}
    assert {seed: failed["good", seed] for seed in "12"} == {"1": "", "2": ""}
    assert all("ValueError: not today" in failed["raises", seed] for seed in "12")
    assert all(failed["dies", seed] == "its process ended with exit code 7" for seed in "12")


def double(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def test_work_comes_back_with_its_number_and_a_death_costs_one_task() -> None:
    found = dict(run_in_processes(double, range(8), 2))
    dead = found.pop(3)
    assert isinstance(dead, WorkerDied)
    assert str(dead) == "its process was ended by SIGKILL"
    assert found == {number: 2 * number for number in (0, 1, 2, 4, 5, 6, 7)}
