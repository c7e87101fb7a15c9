"""One daemon as a child process: started, watched through its status lines, controlled through its standard input."""

import json
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agentd.launcher.child_process import ChildProcess, ProcessStarter


@dataclass
class DaemonProcess:
    """The process of one daemon.

    Attributes:
        agent: Id of the agent.
        process: The child process.
        errors: File with its standard error.
        status: Latest value of every key of its status lines.
        started: Whether the daemon has reported that the fleet has agreed on the start.
        code: Exit code once it has ended, negative for a signal; None while it runs.
        reader: Thread that reads the status lines.
    """

    agent: int
    process: ChildProcess
    errors: Path
    status: Mapping[str, Any] = field(default_factory=dict)
    started: bool = False
    code: int | None = None
    reader: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self.reader = threading.Thread(target=self._read_status, daemon=True)
        self.reader.start()

    def _read_status(self) -> None:
        """Read status lines until the daemon closes its standard output."""
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                with suppress(ValueError):  # the last line of a daemon that died may be cut off
                    self.status = {**self.status, **json.loads(line)}
                self.started = self.started or self.status.get("phase") == "start"

    def send_line(self, line: str) -> None:
        """Write a line to the daemon's standard input; do nothing if the daemon has ended."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError, ValueError):
            self.process.stdin.write(f"{line}\n")
            self.process.stdin.flush()

    def last_error_line(self) -> str:
        """Return the error that ended the daemon, or else the last line of its standard error, without "agentd: "."""
        if "error" in self.status:
            return str(self.status["error"])
        try:
            lines = self.errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:  # the directory is gone
            return ""
        return lines[-1].removeprefix("agentd: ") if lines else ""


def start_daemon(starter: ProcessStarter, folder: Path, agent: int) -> DaemonProcess:
    """Start the daemon of an agent.

    Raises:
        OSError: The process cannot be started, or the file for its standard error not be written.
    """
    path = folder / f"agent-{agent}.err"
    arguments = ["run", str(folder / "fleet.toml"), "--id", str(agent), "--out", str(folder), "--supervised"]
    with path.open("w", encoding="utf-8") as errors:
        return DaemonProcess(agent, starter.start(arguments, errors), path)
