"""A program that sends random signals to fleets, and tells what became of bodies, logs and processes.

    python -m tests.support.signal_storm FOLDER COUNT SEED

prints one JSON object per fleet. Half of the fleets are launched, half are daemons that were started one by one.
"""

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from agentd.daemon.signals import signal_name
from agentd.endpoints import free_endpoints
from dcf_zenoh.config import load
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name
from tests.support.bodies import Sandbox
from tests.support.daemons import PROCESSES

AGENTS = (1, 2, 3)
AT_ONCE = 3  # fleets
DURATION = 2.0  # s of flight
LATEST = 6.0  # s after the start of the processes, of a signal
DEADLINE = 15.0  # s after the last signal; the flight, its landing and all patience of the launcher are shorter

CAUGHT = [
    signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGUSR1, signal.SIGALRM,
    signal.SIGRTMIN + 3,
]  # fmt: skip
HARMLESS = [signal.SIGCONT, signal.SIGTTOU, signal.SIGTTIN, signal.SIGPIPE, signal.SIGWINCH]

# In addition to the diary of its body: how many setpoints it has followed.
COUNTING = """

class Counting(Body):
    acted = 0

    def act(self, setpoint, now):
        super().act(setpoint, now)
        self.acted += 1
        self.note(f"acted {self.acted}")
"""


class StormyFleet:
    """Three agents whose processes get signals."""

    def __init__(self, number: int, folder: Path, dice: random.Random) -> None:
        home = folder / str(number)
        home.mkdir(parents=True)
        self.sandbox = Sandbox(home)
        self.sandbox.write(duration=DURATION)
        with (home / "body.py").open("a") as plugin:
            plugin.write(COUNTING)
        fleet = self.sandbox.file.read_text()
        self.sandbox.file.write_text(fleet.replace("./body.py:Body", "./body.py:Counting"))
        self.folder = home / "run"
        self.launched = number % 2 == 0
        self.processes = self._launch() if self.launched else self._start_one_by_one()
        self.born = time.monotonic()
        self.plan = sorted(self._signal(dice) for _ in range(dice.randint(1, 3)))
        for target in sorted({target for _, target, _ in self.plan}):  # who was stopped goes on, as after `fg`
            self.plan.append((self.plan[-1][0] + 0.5, target, signal.SIGCONT))
        self.sent: list[tuple[float, int, str]] = []
        self.hung: list[int] = []

    def _command(self, *words: str) -> subprocess.Popen[bytes]:
        changes = ["time.clock='wall'", "plants.body.pauses=1", "plants.body.lands_in=2", "zenoh.ready_timeout=5.0"]
        changes.append("safety.neighbour_silent.then='continue'")
        command = [sys.executable, "-m", "agentd", words[0], str(self.sandbox.file), *words[1:]]
        command += [word for change in changes for word in ("--set", change)]
        return subprocess.Popen(
            [*command, "--out", str(self.folder)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip

    def _launch(self) -> dict[int, subprocess.Popen[bytes]]:
        return {0: self._command("launch", "--no-report", "--json")}

    def _start_one_by_one(self) -> dict[int, subprocess.Popen[bytes]]:
        port = min(int(each.rpartition(":")[2]) for each in free_endpoints(load(self.sandbox.file).spec).values())
        port = 20000 + port % 10000 // 4 * 4
        return {i: self._command("run", "--id", str(i), "--set", f"zenoh.base_port={port}") for i in AGENTS}

    def _signal(self, dice: random.Random) -> tuple[float, int, int]:
        """Return an instant, who gets a signal, 0 for the launcher, and which."""
        target = dice.choice([0, *AGENTS] if self.launched else AGENTS)
        kill = [signal.SIGKILL] if target == 0 else []
        return dice.uniform(0.0, LATEST), target, int(dice.choice([*CAUGHT, *HARMLESS, *kill]))

    def processes_alive(self) -> dict[int, int]:
        """Agent, 0 for the launcher, -> process id, of those that are alive."""
        found = {}
        for path in PROCESSES.glob("[0-9]*/cmdline"):
            try:
                words = path.read_bytes().decode(errors="replace").replace("\0", " ").split()
            except OSError:  # it has just ended
                continue
            if any(word.startswith(str(self.folder.parent)) for word in words) and "agentd" in words:
                found[int(words[words.index("--id") + 1]) if "--id" in words else 0] = int(path.parent.name)
        return found

    def look(self) -> bool:
        """Send what is due; return whether all processes have ended."""
        age = time.monotonic() - self.born
        while self.plan and self.plan[0][0] <= age:
            _, target, number = self.plan.pop(0)
            pid = self.processes_alive().get(target)
            if pid is not None:
                self.sent.append((round(age, 2), target, signal_name(number)))
                with_errors_ignored(pid, number)
        for process in self.processes.values():
            process.poll()
        alive = self.processes_alive()
        if not self.plan and alive and age > self.sent_last + DEADLINE:
            self.hung = sorted(alive)
            for pid in alive.values():
                with_errors_ignored(pid, signal.SIGKILL)
            time.sleep(0.5)  # until they are gone
            return True
        return not self.plan and not alive

    @property
    def sent_last(self) -> float:
        """Age at the last signal, s; 0 if there was none."""
        return max([0.0, *(when for when, _, _ in self.sent)])

    def report(self) -> dict[str, Any]:
        """What became of it."""
        return {
            "launched": self.launched,
            "sent": self.sent,
            "took": round(time.monotonic() - self.born - self.sent_last, 2),
            "hung": self.hung,
            "codes": {i: process.poll() for i, process in self.processes.items()},
            "faults": [fault for i in AGENTS for fault in self._faults(i)],
            "flew": sum(any(what.startswith("start ") for what in self.sandbox.of(i)) for i in AGENTS),
        }

    def _faults(self, agent: int) -> list[str]:
        """What is wrong with the body and the log of an agent."""
        told = self.sandbox.of(agent)
        found = []
        if "take_off" in told:
            after = told[told.index("take_off") :]
            ended = any(what.startswith("finish") for what in after) or "emergency" in after
            if not ended or after[-1] not in ("close", "emergency"):
                found.append(f"agent {agent} is left in the air: {after[-3:]}")
        acted = sum(what.startswith("acted") for what in told)
        path = self.folder / log_name(agent)
        data = path.read_bytes() if path.is_file() else b""
        try:
            log = AgentLog.read(data, path.name) if data else None
        except RecordingError as error:
            return [*found, str(error)]
        if acted and (log is None or len(log.step) < acted):
            found.append(f"agent {agent} followed {acted} setpoints; its log has {len(log.step) if log else 0} steps")
        if log is not None and (log.damage or (acted and log.end is None)):
            found.append(f"agent {agent}: {log.damage or 'its log has no end'}")
        return found


def with_errors_ignored(pid: int, number: int) -> None:
    """Send a signal to a process that may just have ended."""
    subprocess.run(["kill", f"-{number}", str(pid)], check=False, stderr=subprocess.DEVNULL)


def main(folder: Path, count: int, seed: int) -> None:
    """Send signals to `count` fleets."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # it is ignored under nohup, and then by all children
    dice = random.Random(seed)
    flying: list[StormyFleet] = []
    begun = 0
    while flying or begun < count:
        while begun < count and len(flying) < AT_ONCE:
            flying.append(StormyFleet(begun, folder, dice))
            begun += 1
        for fleet in [each for each in flying if each.look()]:
            flying.remove(fleet)
            print(json.dumps(fleet.report()), flush=True)
        time.sleep(0.05)  # between two looks


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
