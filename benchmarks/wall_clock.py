"""Daemons with simulated Crazyflies on the wall clock: steps in time, and the time until a daemon is ready.

    python benchmarks/wall_clock.py [--runs 3]

Four daemons fly the position swap in real time, with point masses and with Crazyflies in turn: the difference is the
cost of the Crazyflie. Then a single daemon is started several times and timed until its first control step is done. The
machine code of the model is compiled before. Other load has an effect, so it is printed.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dcf_zenoh.records.run import Run
from plants.crazyflie.simulated import Crazyflie

KEPT = 0.99  # of the agent-steps
READY = 2.0  # s
ALONE = """
name = "alone"
time = { clock = "wall", duration = 0.2 }
problem = { kind = "position_swap", target = [1.0, 0.0] }
algorithm = { kind = "trades" }
plants = { twin = { kind = "crazyflie" }, point = { kind = "point_mass" } }
plant = "PLANT"
agents = { 1 = { start = [0.0, 0.0] } }
"""


def flight(plant: str, folder: Path) -> str:
    """Fly with four daemons on the wall clock; return a line of results."""
    before = load()
    command = [sys.executable, "-m", "agentd", "launch", "position_swap", "--clock", "wall", "--plant", plant]
    options = ["--out", str(folder), "--json", "--no-report"]
    done = subprocess.run([*command, *options], check=False, capture_output=True, text=True)
    if done.returncode:  # on a busy machine neighbours fall silent
        return f"FAILED: {done.stderr.strip().splitlines()[-1].removeprefix('agentd: ')[:120]}; {before}"
    summary = Run.read(folder).summary()
    steps = sum(summary["ended_by"].values())
    kept = 1 - summary["deadline_misses"] / steps
    verdict = "as it should" if kept >= KEPT else f"MISSES the goal of {100 * KEPT:g} %"
    cut_short = summary["ended_by"].get("budget", 0)
    arrived = f"arrived at {summary['arrival_time']:.1f} s" if summary["arrived"] else "did not arrive"
    return (
        f"{100 * kept:6.2f} % of {steps} agent-steps in time, {verdict}; {cut_short} ended by the budget;"
        f" negotiation median {summary['negotiation_ms']['median']:.0f} ms; {arrived}; {before}"
    )


def ready(plant: str, folder: Path) -> float:
    """Return the seconds from the start of one daemon to its first status line, when its first step is done."""
    folder.mkdir()
    fleet = folder / "alone.toml"
    fleet.write_text(ALONE.replace("PLANT", plant), encoding="utf-8")
    command = [sys.executable, "-m", "agentd", "run", str(fleet), "--id", "1", "--out", str(folder), "--supervised"]
    began = time.perf_counter()
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as daemon:
        assert daemon.stdout is not None
        assert daemon.stdout.readline(), "the daemon has ended before its first step"
        took = time.perf_counter() - began
        daemon.stdout.read()  # to its end
    return took


def load() -> str:
    return f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3, help="flights and starts of each plant")
    runs = parser.parse_args().runs
    Crazyflie(np.zeros(2), 0.2, np.random.default_rng(1)).prepare()
    with TemporaryDirectory() as name:
        for number in range(runs):
            for plant in ("point", "twin"):
                print(f"{plant:6} {flight(plant, Path(name) / f'{plant}-{number}')}", flush=True)
        for plant in ("point", "twin"):
            times = [ready(plant, Path(name) / f"{plant}-ready-{number}") for number in range(runs)]
            verdict = "as it should" if statistics.median(times) < READY else f"MISSES the goal of {READY:g} s"
            print(
                f"{plant:6} first step done {statistics.median(times):.2f} s after the daemon's start"
                f" ({min(times):.2f} .. {max(times):.2f}), {verdict}; {load()}",
                flush=True,
            )


if __name__ == "__main__":
    main()
