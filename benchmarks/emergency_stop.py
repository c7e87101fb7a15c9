"""Time of an emergency stop, from the start of the command to the last motor that is off.

A fleet is launched whose bodies write down when their motors are switched off. Then `agentd stop` is started as a
process of its own, as a person would, and printed is how long it took until the last body was stopped, and until the
command had ended. With --load some processes compute meanwhile.

    python benchmarks/emergency_stop.py [--repeats 5] [--load 9]
"""

import argparse
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

GOAL, GOAL_UNDER_LOAD = 0.5, 1.0  # s
AGENTS = 4
READY = 60.0  # s, longest wait for the fleet to fly
BODY = """
import time
from pathlib import Path
from plants.point_mass import PointMass

class Body(PointMass):
    def __init__(self, agent, start, *, folder: str):
        super().__init__(start)
        self.file = Path(folder) / str(agent)

    def act(self, setpoint, now):
        super().act(setpoint, now)
        self.file.with_suffix(".flies").touch()

    def emergency_stop(self):
        self.file.with_suffix(".off").write_text(str(time.monotonic()))
"""
FLEET = """
name = "emergency"

[time]
clock = "wall"
duration = 600.0

[topology]
kind = "complete"

[problem]
kind = "position_swap"

[algorithm]
kind = "trades"

[plants.body]
kind = "{folder}/body.py:Body"
folder = "{folder}"

[agents.1]
start = [0.0, 1.0]
target = [0.0, -1.0]

[agents.2]
start = [0.0, -1.0]
target = [0.0, 1.0]

[agents.3]
start = [1.0, 0.0]
target = [-1.0, 0.0]

[agents.4]
start = [-1.0, 0.0]
target = [1.0, 0.0]
"""


def measure(load: int) -> tuple[float, float]:
    """Return the times until all motors are off, and until the command has ended, in s."""
    agentd = [sys.executable, "-m", "agentd"]
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "body.py").write_text(BODY, encoding="utf-8")
        (folder / "fleet.toml").write_text(FLEET.format(folder=folder), encoding="utf-8")
        run = folder / "run"
        launch = subprocess.Popen(
            [*agentd, "launch", str(folder / "fleet.toml"), "--out", str(run), "--json", "--no-report"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        busy: list[subprocess.Popen[bytes]] = []
        try:
            _await(folder, "flies")
            busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(load)]
            began = time.monotonic()
            subprocess.run([*agentd, "stop", str(run)], check=True, stdout=subprocess.DEVNULL, timeout=30)
            ended = time.monotonic()
            _await(folder, "off")
            off = max(float(path.read_text(encoding="utf-8")) for path in folder.glob("*.off"))
            return off - began, ended - began
        finally:
            for process in busy:
                process.kill()
                process.wait()
            launch.send_signal(signal.SIGTERM)
            launch.wait(30)


def _await(folder: Path, suffix: str) -> None:
    """Wait until each body has written a file with this suffix."""
    deadline = time.monotonic() + READY
    while len(list(folder.glob(f"*.{suffix}"))) < AGENTS:
        if time.monotonic() > deadline:
            raise TimeoutError(f"not all agents: {suffix}, within {READY:g} s")
        time.sleep(0.05)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="emergency stops (default: 5)")
    parser.add_argument("--load", type=int, default=0, help="processes that compute meanwhile (default: 0)")
    options = parser.parse_args()
    goal = GOAL_UNDER_LOAD if options.load else GOAL
    times = [measure(options.load) for _ in range(options.repeats)]
    for what, column in (("motors off", 0), ("command ended", 1)):
        values = [each[column] for each in times]
        print(f"{what}: median {statistics.median(values):.2f} s, longest {max(values):.2f} s")
    print(f"goal for motors off, with {options.load} processes that compute: {goal:g} s")


if __name__ == "__main__":
    main()
