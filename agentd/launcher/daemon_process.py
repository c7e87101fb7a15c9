"""One daemon as a child process: started, listened to, told."""

import json
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class DaemonProcess:
    """One child process.

    Attributes:
        agent: Id.
        process: The process.
        errors: File with its standard error.
        status: Last status line.
        started: Whether it has said that the fleet has agreed on the start.
        code: Its exit code once it has ended; negative for a signal.
        reader: Reads the status lines.
    """

    agent: int
    process: subprocess.Popen[str]
    errors: Path
    status: Mapping[str, Any] = field(default_factory=dict)
    started: bool = False
    code: int | None = None
    reader: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self.reader = threading.Thread(target=self._read_status, daemon=True)
        self.reader.start()

    def _read_status(self) -> None:
        """Keep the last status line; returns when the daemon closes its output."""
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self.status = {**self.status, **json.loads(line)}
                self.started = self.started or self.status.get("phase") == "start"

    def tell(self, line: str) -> None:
        """Write a line to its standard input; one that has ended needs none."""
        assert self.process.stdin is not None
        with suppress(BrokenPipeError, ValueError):
            self.process.stdin.write(f"{line}\n")
            self.process.stdin.flush()

    def last_words(self) -> str:
        """The last line of its standard error, without the name of the program."""
        lines = self.errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1].removeprefix("agentd: ") if lines else ""


def spawn(folder: Path, agent: int) -> DaemonProcess:
    """Start one daemon, in a session of its own so that Ctrl-C reaches the launcher alone."""
    command = [sys.executable, "-m", "agentd", "run", str(folder / "fleet.toml"), "--id", str(agent)]
    command += ["--out", str(folder), "--supervised"]
    path = folder / f"agent-{agent}.err"
    with path.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
        )
    return DaemonProcess(agent, process, path)
