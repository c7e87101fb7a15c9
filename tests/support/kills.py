"""A program that kills agents of small fleets at random instants, and tells what became of the others.

Agents are processes forked from this one, which has imported everything before: so a fleet costs no start-up time.

    python -m tests.support.kills FOLDER COUNT SEED

prints one JSON object per fleet.
"""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any, NoReturn

from agentd.daemon.daemon import Assignment, run_agent
from agentd.endpoints import free_endpoints
from dcf_zenoh.config import LoadedFleet, freeze, load
from dcf_zenoh.errors import DcfError
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name
from tests.support.small_fleet import small_fleet

AT_ONCE = 3  # fleets
DEADLINE = 15.0  # s for the survivors of a fleet to end
LATEST = 1.6  # s after the fork; by then the fleet has said goodbye

FLEET = small_fleet(
    "short",
    time={"clock": "wall", "sample_time": 0.05, "duration": 0.8},
    exchange={"budget": 0.04, "max_rounds": 20, "round_timeout": 0.002},
    safety={"neighbour_silent": {"after": 0.2, "then": "continue"}},
    zenoh={"ready_timeout": 3.0},
    controller={"kind": "receding_horizon", "sharing": "piggyback", "lost_after": 0.2},
    algorithm={"kind": "trades_robust"},
)


class Fleet:
    """Three agents, one of which is to be killed."""

    def __init__(self, number: int, folder: Path, dice: random.Random) -> None:
        source = folder / f"{number}.toml"
        source.write_text(FLEET, encoding="utf-8")
        self.folder = folder / f"run-{number}"
        self.fleet = freeze(load(source), self.folder)
        self.victim = dice.choice(self.fleet.spec.ids)
        self.after = dice.uniform(0.0, LATEST)
        endpoints = free_endpoints(self.fleet.spec)
        self.born = time.monotonic()
        self.pids = {i: _fork(self.fleet, i, self.folder, endpoints) for i in self.fleet.spec.ids}
        self.codes: dict[int, int] = {}
        self.ended = 0.0
        self._killed = False

    def look(self) -> bool:
        """Kill when it is time; whether all processes have ended."""
        age = time.monotonic() - self.born
        if age >= self.after and not self._killed:
            self._killed = True
            if self.victim not in self.codes:
                os.kill(self.pids[self.victim], signal.SIGKILL)
        if age > self.after + DEADLINE:
            for i in self.pids.keys() - self.codes.keys():
                os.kill(self.pids[i], signal.SIGKILL)
        for i in self.pids.keys() - self.codes.keys():
            pid, status = os.waitpid(self.pids[i], os.WNOHANG)
            if pid:
                self.codes[i] = os.waitstatus_to_exitcode(status)
                self.ended = time.monotonic() - self.born
        return len(self.codes) == len(self.pids)

    def report(self) -> dict[str, Any]:
        """What became of it."""
        survivors = [i for i in self.pids if i != self.victim]
        return {
            "victim": self.victim,
            "after": self.after,
            "took": self.ended - self.after,
            "killed": self.codes[self.victim] == -signal.SIGKILL,
            "steps_of_victim": self._steps(self.victim)[0],
            "survivors": {i: (self.codes[i], *self._steps(i), self._error(i)) for i in survivors},
        }

    def _steps(self, agent: int) -> tuple[int, str]:
        path = self.folder / log_name(agent)
        data = path.read_bytes() if path.is_file() else b""
        if not data:
            return 0, ""
        log = AgentLog.read(data, path.name)
        return len(log.step), log.end["end"] if log.end else ""

    def _error(self, agent: int) -> str:
        path = self.folder / f"error-{agent}"
        return path.read_text(encoding="utf-8") if path.is_file() else ""


def _fork(fleet: LoadedFleet, agent: int, folder: Path, endpoints: dict[int, str]) -> int:
    pid = os.fork()
    return pid or _live(fleet, agent, folder, endpoints)


def _live(fleet: LoadedFleet, agent: int, folder: Path, endpoints: dict[int, str]) -> NoReturn:
    """One agent, as in `agentd run`."""
    code = 70
    try:
        run_agent(fleet, Assignment(agent, folder.name, folder, endpoints))
        code = 0
    except DcfError as error:
        (folder / f"error-{agent}").write_text(f"{type(error).__name__}: {error}", encoding="utf-8")
        code = 1
    finally:
        os._exit(code)


def main(folder: Path, count: int, seed: int) -> None:
    """Kill one agent of each of `count` fleets."""
    dice = random.Random(seed)
    flying: list[Fleet] = []
    begun = 0
    while flying or begun < count:
        while begun < count and len(flying) < AT_ONCE:
            flying.append(Fleet(begun, folder, dice))
            begun += 1
        for fleet in [each for each in flying if each.look()]:
            flying.remove(fleet)
            print(json.dumps(fleet.report()), flush=True)
        time.sleep(0.005)  # between two looks


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
