"""Start and end of a fleet: `agentd launch` with forked daemons, and with spawned ones in turn.

The fleet computes an average over Zenoh in virtual time, which takes some ms; the rest is starting and ending. Printed
are the medians of the time of the whole command, of its processor time with that of its daemons, and of the ratios.

    python benchmarks/start.py [--agents 5] [--pairs 8]
"""

import argparse
import random
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

SPAWN = "from agentd.launcher import child_process; child_process.FORKS_FROM = 10**9"
COMMAND = "import sys; from agentd.cli import main; sys.exit(main())"
FLEET = """
name = "start"
[topology]
kind = "ring"
[problem]
kind = "average"
[algorithm]
kind = "average_consensus"
"""


def measured(fleet: Path, folder: Path, *, forked: bool) -> tuple[float, float]:
    """Launch once; return the time of the command and the processor time of all its processes, s."""
    program = COMMAND if forked else f"{SPAWN}\n{COMMAND}"
    command = [sys.executable, "-c", program, "launch", str(fleet), "--clock", "virtual", "--no-report", "--json"]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run([*command, "--out", str(folder)], check=True, stdout=subprocess.DEVNULL, timeout=300)
    took, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, default=5)
    parser.add_argument("--pairs", type=int, default=8)
    options = parser.parse_args()
    found: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    with TemporaryDirectory() as name:
        fleet = Path(name) / "start.toml"
        agents = "".join(f"[agents.{i}]\nproblem.value = [{i}.0]\n" for i in range(1, options.agents + 1))
        fleet.write_text(FLEET + agents, encoding="utf-8")
        for pair in range(options.pairs):
            for forked in random.sample((True, False), 2):
                found[forked].append(measured(fleet, Path(name) / f"{pair}-{forked}", forked=forked))
    print(f"{options.agents} daemons, {options.pairs} launches of each in turn; medians")
    for column, what in enumerate(("command, s", "processor time, s")):
        fast, slow = ([each[column] for each in found[how]] for how in (True, False))
        ratios = [one / other for one, other in zip(fast, slow, strict=True)]
        print(
            f"  {what:18} forked {statistics.median(fast):5.2f}  spawned {statistics.median(slow):5.2f}"
            f"  ratio {statistics.median(ratios):.2f} [{min(ratios):.2f} .. {max(ratios):.2f}]"
        )


if __name__ == "__main__":
    main()
