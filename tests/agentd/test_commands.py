"""Good input on the command line: what each command prints and writes."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh import Run
from dcf_zenoh.config import Overrides, load
from tests.support.command_line import QUICK, Answer

KEYS = {
    "fleet", "run", "clock", "plant", "topology", "agents", "steps", "arrived", "arrival_time", "min_barrier",
    "min_distance", "rounds_per_step", "compute_ms", "negotiation_ms", "deadline_misses", "messages", "digest",
}  # fmt: skip


@pytest.mark.parametrize("command", ["simulate", "launch"])
def test_json_prints_one_object_and_nothing_else(command: str, trio: Path, tmp_path: Path) -> None:
    words = [command, str(trio), "--json", "--seed", "3", "--clock", "virtual", "--set", "time.duration=1.0"]
    answer = subprocess.run(
        [sys.executable, "-m", "agentd", *words, "--out", tmp_path / "run"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert answer.returncode == 0
    assert answer.stderr == ""
    assert answer.stdout.count("\n") == 1
    summary = json.loads(answer.stdout)
    assert summary.keys() >= KEYS
    assert summary["fleet"] == "trio"
    assert summary["run"] == "run"
    assert (summary["clock"], summary["agents"], summary["steps"]) == ("virtual", 3, 5)
    for key in ("rounds_per_step", "compute_ms", "negotiation_ms"):
        assert summary[key].keys() == {"median", "p95", "max"}
    assert summary["messages"].keys() == {"published", "delivered", "lost", "late", "missing"}
    assert summary["digest"] == Run.read(tmp_path / "run").digest
    assert (tmp_path / "run" / "trajectories.png").is_file()  # a report is drawn unless told not to


def test_simulate_prints_a_table_and_the_names_of_the_figures(trio: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("simulate", trio, "--set", "time.duration=1.0", "--out", trio.parent / "run")
    assert answer.code == 0
    assert answer.out.splitlines()[0].rstrip() == "trio, run: complete topology, virtual clock"
    assert re.search(r"\n.*run: log of every agent, and .*\.png", answer.out)
    assert answer.err == ""


def test_check_prints_a_file_that_loads_again_as_the_same_fleet(trio: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("check", trio, "--seed", "7", "--set", "exchange.max_rounds=40", "--topology", "path")
    assert (answer.code, answer.err) == (0, "")
    copy = trio.with_name("copy.toml")
    copy.write_text(answer.out)
    assert load(copy).spec == load(trio, Overrides(seed=7, topology="path"), changes=["exchange.max_rounds=40"]).spec
    assert agentd("check", copy).out == answer.out


def test_check_warns_of_rounds_that_do_not_fit_and_runs_no_plug_in(trio: Path, agentd: Callable[..., Answer]) -> None:
    (trio.parent / "mine.py").write_text(
        "raise SystemExit('run')\ndef mine(problem, me, *, step: float = 1.0): yield\n"
    )
    answer = agentd("check", trio, "--set", "algorithm.kind=./mine.py:mine", "--set", "exchange.round_timeout=0.01")
    assert answer.code == 0
    assert answer.err.splitlines() == [
        "agentd: note: exchange: worst case 200 x 10 ms = 2.000 s > budget 0.150 s: a step may end by time, not by"
        " agreement",
        "agentd: note: algorithm: ./mine.py:mine was not run, so its keys are checked by name at most",
    ]
    answer = agentd("check", trio, "--load", "--set", "algorithm.kind=./mine.py:mine")
    assert answer.code == 2
    assert answer.err == (
        f"agentd: {trio}: algorithm.kind: ./mine.py:mine: importing {trio.parent / 'mine.py'}, line 1 failed:"
        " SystemExit: run\n"
    )


def test_plugins_lists_kinds_with_their_keys(agentd: Callable[..., Answer]) -> None:
    answer = agentd("plugins", "plants")
    assert answer.code == 0
    assert answer.out.splitlines()[0] == "plants"
    assert "accel_max: number = 2.0" in answer.out


def test_export_writes_what_the_run_holds(flown: Path, tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    for kind in ("csv", "npz", "mat"):
        answer = agentd("export", flown, "--to", kind, "--out", tmp_path / f"run.{kind}")
        assert answer == (0, f"{tmp_path / f'run.{kind}'}\n", "")
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 1 + 3 * 5
    with np.load(tmp_path / "run.npz") as arrays:
        assert arrays.files


def test_diff_prints_identical_or_where_two_runs_first_differ(
    flown: Path, trio: Path, agentd: Callable[..., Answer]
) -> None:
    same, other = trio.parent / "same", trio.parent / "other"
    assert agentd("simulate", trio, *QUICK, "--out", same).code == 0
    assert agentd("simulate", trio, *QUICK, "--set", "problem.prediction.horizon=4", "--out", other).code == 0
    assert agentd("diff", flown, same) == (0, "identical\n", "")
    answer = agentd("diff", flown, other)
    assert answer.code == 1
    assert re.search(r"agent 1.*step 0", answer.out)
    assert agentd("diff", flown, other, "--tolerance", "100").out != answer.out


def test_rerun_repeats_a_run_bit_by_bit(flown: Path, tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("rerun", flown, "--json", "--no-report", "--out", tmp_path / "again")
    assert answer.code == 0
    assert answer.err == "identical\n"
    assert json.loads(answer.out)["digest"] == Run.read(flown).digest
    assert Run.read(tmp_path / "again").digest == Run.read(flown).digest


def test_report_names_the_figures_it_draws(flown: Path, tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("report", flown, flown, "--out", tmp_path)
    assert answer.code == 0
    paths = [Path(line) for line in answer.out.splitlines()]
    assert {path.suffix for path in paths} == {".png", ".pdf"}
    assert all(path.parent == tmp_path and path.stat().st_size > 1000 for path in paths)


def test_a_daemon_imports_nothing_heavy_that_its_fleet_does_not_use() -> None:
    """The built-in position swap has tables for algorithms with OSQP and for plants with numba and cflib."""
    words = ["agentd.commands", "agentd.daemon.daemon", "agentd.daemon.runner"]
    code = (
        f"import sys, {', '.join(words)}; from dcf_zenoh.config import load; load('position_swap', unused=False);"
        "print(*sorted({'scipy', 'osqp', 'rich', 'matplotlib', 'networkx', 'numba', 'cflib'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "\n"


def test_no_command_fails_of_a_terminal_that_cannot_show_a_sign(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252", "COLUMNS": "200"}

    def run(*words: str) -> str:
        command = [sys.executable, "-m", "agentd", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False, timeout=60)
        assert done.returncode == 0, done.stderr
        return done.stdout.decode("cp1252")

    run("simulate", "position_swap_lossy", "--set", "time.duration=1", "--no-report", "--out", "r")
    for command in ("links", "why"):
        assert "->" in run(command, "r")
    run("check", "position_swap")
    run("plugins")


@pytest.mark.real_time
def test_a_fleet_without_plants_ends_on_the_wall_clock_when_it_has_decided(tmp_path: Path) -> None:
    began = time.monotonic()
    command = ["launch", "quadratic", "--clock", "wall", "--set", "time.sample_time=20", "--no-report", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "agentd", *command, "--out", str(tmp_path / "r")], capture_output=True, check=False
    )
    assert done.returncode == 0
    assert time.monotonic() - began < 15  # two control periods before
    assert json.loads(done.stdout)["ended_by"] == {"agreed": 4}
