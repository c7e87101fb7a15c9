"""Error of injected latency on the wall clock.

Two daemons with a constant latency between them run synchronous rounds. Their algorithm sends the time of sending, and
notes the time of receiving. So a trip goes from the algorithm of the sender to that of the receiver and contains
everything between: encoding, Zenoh, the link, and waking up. Its duration beyond the injected latency is the error,
printed next to the part of it that lies before the due time in the log.

    python benchmarks/latency.py [--latencies 3 10 30]
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.records.run import Run

GOALS = 1.0, 5.0  # ms: median, 99th percentile
SECONDS = 4.0  # of rounds, for each latency
FLEET = """
name = "latency"

[time]
clock = "wall"
sample_time = {sample_time}

[exchange]
budget = {seconds}
max_rounds = 1000000
threshold = 0

[topology]
kind = "complete"

[problem]
kind = "average"
value = 0.0

[algorithm]
kind = "{file}:stamped"

[faults]
latency = {latency}

[log]
rounds = true

[agents.1]

[agents.2]
"""


def stamped(_problem: object, me: Me) -> Dialogue[Result]:
    """Send the time, and note how long it took. All processes of a machine have the same monotonic clock."""
    (other,) = me.neighbours
    while True:
        sent_at = time.monotonic_ns()
        inbox = yield {"sent_at": sent_at}, float("inf")
        if inbox.fresh(other):
            me.note(took=time.monotonic_ns() - inbox[other]["sent_at"])
        if inbox.stop:
            return me.result(0.0)


class Errors(NamedTuple):
    """Errors of one run, in ms beyond the injected latency: at the due time, and at the receiving algorithm."""

    due: npt.NDArray[np.float64]
    received: npt.NDArray[np.float64]


def measure(latency: float) -> Errors:
    """Run the two daemons with a latency in s."""
    with TemporaryDirectory() as folder:
        fleet, out = Path(folder) / "latency.toml", Path(folder) / "run"
        keys = {"file": Path(__file__).resolve(), "latency": latency, "seconds": SECONDS, "sample_time": SECONDS + 0.1}
        fleet.write_text(FLEET.format(**keys), encoding="utf-8")
        command = [sys.executable, "-m", "agentd", "launch", str(fleet), "--out", str(out), "--no-report"]
        subprocess.run(command, check=True, timeout=60, capture_output=True)
        logs = Run.read(out).agents.values()
    due = [each.due - each.entered for log in logs for each in log.passed]
    received = [noted["took"] for log in logs for *_, noted in log.rounds_log[0] if noted]
    return Errors(*(np.array(taken) * 1e-6 - latency * 1e3 for taken in (due, received)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--latencies", type=float, nargs="+", default=[3.0, 10.0, 30.0], help="ms")
    latencies = parser.parse_args().latencies
    print(f"error in ms; load {_load()} on {os.cpu_count()} cores")
    print("latency  messages   due: median    99 %     most   received: median    99 %     most")
    good = True
    for latency in latencies:
        errors = measure(latency * 1e-3)
        cells = ["%11.3f%8.3f%9.3f" % (*np.percentile(each, (50, 99)), each.max()) for each in errors]  # noqa: UP031
        print(f"{latency:7g}{len(errors.received):10d}  {cells[0]}     {cells[1]}")
        median, tail = np.percentile(errors.received, (50, 99))
        good = good and abs(median) < GOALS[0] and tail < GOALS[1]
    print(f"load {_load()}; goals at the algorithm: median < {GOALS[0]:g} ms, 99 % < {GOALS[1]:g} ms:", end=" ")
    print("met" if good else "missed")


def _load() -> str:
    return f"{os.getloadavg()[0]:.1f}"


if __name__ == "__main__":
    main()
