"""Fleets of real daemons: launched as processes of their own, watched, and always cleaned up."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from agentd.run_directory import read_run_json
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name
from tests.support.small_fleet import small_fleet
from tests.support.waiting import until

PROCESSES = Path("/proc")

# Three agents that change places, for longer than any test lasts.
TRIO = small_fleet("trio", time={"clock": "wall", "duration": 60.0})


def launch_virtual(fleet: str | Path, out: Path, *options: str) -> dict[str, Any]:
    """Launch daemons in virtual time, wait for their end and return the summary."""
    command = [sys.executable, "-m", "agentd", "launch", str(fleet), "--clock", "virtual", "--out", str(out)]
    done = subprocess.run(
        [*command, "--json", "--no-report", *options], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary


@contextmanager
def both_cores_busy() -> Iterator[None]:
    """Keep two processes computing."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


class Launch:
    """``agentd launch FLEET --no-report`` in a process of its own. Use it in a ``with`` statement.

    Args:
        fleet: Fleet file, or a name.
        folder: Run directory; standard output and error of the launcher go beside it.
        changes: Each for ``--set``.
        before: Python that runs first in the launcher's process.
        yes: Real bodies may take off.
        quiet: The launcher prints an object, and not how far it is (``--json``).
    """

    def __init__(
        self, fleet: Path | str, folder: Path, *changes: str, before: str = "", yes: bool = False, quiet: bool = True
    ) -> None:
        self.folder = folder
        start = ["-c", f"{before}\nimport sys; from agentd.cli import main; sys.exit(main())"]
        options = [word for change in changes for word in ("--set", change)] + ["--yes"] * yes + ["--json"] * quiet
        command = [sys.executable, *(start if before else ["-m", "agentd"]), "launch", str(fleet), *options]
        folder.parent.mkdir(parents=True, exist_ok=True)
        self._out, self._err = folder.with_suffix(".out"), folder.with_suffix(".err")
        with self._out.open("w") as out, self._err.open("w") as err:
            self.process = subprocess.Popen(
                [*command, "--out", str(folder), "--no-report"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(10)
        for pid in self.daemons().values():
            os.kill(pid, signal.SIGKILL)

    def daemons(self) -> dict[int, int]:
        """Agent -> process id, of the daemons that are alive now (or frozen)."""
        found = {}
        for path in PROCESSES.glob("[0-9]*/cmdline"):
            try:
                words = path.read_bytes().decode(errors="replace").replace("\0", " ").split()
            except OSError:  # it has just ended
                continue
            if str(self.folder / "fleet.toml") in words and "--id" in words:
                found[int(words[words.index("--id") + 1])] = int(path.parent.name)
        return found

    def log(self, agent: int) -> AgentLog | None:
        """What an agent has recorded so far; None if not even a header."""
        path = self.folder / log_name(agent)
        data = path.read_bytes() if path.is_file() else b""
        return AgentLog.read(data, path.name) if data else None

    def flying(self, steps: int = 3, agents_at_least: int = 2, within: float = 60.0) -> dict[int, int]:
        """Wait until every agent has recorded so many steps; the daemons' process ids."""
        agents: dict[int, int] = {}

        def all_there() -> bool:
            assert self.process.poll() is None, f"the launcher has ended: {self.errors}"
            agents.update(self.daemons())
            logs = [self.log(i) for i in agents]
            return len(agents) >= agents_at_least and all(log is not None and len(log.step) >= steps for log in logs)

        until(all_there, f"{steps} steps of all agents", within)
        return agents

    def end(self, within: float = 20.0) -> int:
        """Wait until the launcher has ended; its exit code. No daemon may be left."""
        code = self.process.wait(within)
        assert self.daemons() == {}, "daemons are left behind"
        return code

    @property
    def about(self) -> dict[str, Any]:
        """What the launcher has noted of the run so far."""
        return read_run_json(self.folder)

    @property
    def errors(self) -> str:
        """What the launcher has written to standard error."""
        return self._err.read_text(encoding="utf-8")

    @property
    def output(self) -> str:
        """What it has written to standard output."""
        return self._out.read_text(encoding="utf-8")

    @property
    def summary(self) -> dict[str, Any]:
        """The object that it has printed."""
        found: dict[str, Any] = json.loads(self.output)
        return found
