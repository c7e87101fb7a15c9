"""``agentd emulate-crazyflie`` as a process that is spoken to by lines."""

import os
import select
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import IO, Self, cast


class EmulatorProcess:
    """``agentd emulate-crazyflie`` as a process. Use it in a ``with`` statement.

    Args:
        folder: Where it writes the truth.
        count: Number of drones.
        options: Other options of the command.

    Attributes:
        uris: Number of each drone -> where it listens.
    """

    def __init__(self, folder: Path, count: int, *options: str) -> None:
        command = [sys.executable, "-m", "agentd", "emulate-crazyflie", "--n", str(count), "--port", "0", *options]
        self._process = subprocess.Popen(
            [*command, "--truth", str(folder), "--until-stdin-closes"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
        )
        self._received = b""
        self._dialogue = threading.Lock()  # around a line and its answer
        lines = [self._line().split() for _ in range(count)]
        self.uris = {int(number): uri for _, number, uri in lines}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        cast(IO[bytes], self._process.stdin).close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(5)
        cast(IO[bytes], self._process.stdout).close()

    def send(self, drone: int, line: str) -> str:
        """Send a line such as ``battery 3.0`` for a drone; return the answer. From any thread."""
        with self._dialogue:
            cast(IO[bytes], self._process.stdin).write(f"{drone} {line}\n".encode())
            answer = self._line()
        assert not answer.startswith("error"), answer
        return answer

    def _line(self, within: float = 100.0) -> str:
        stream = cast(IO[bytes], self._process.stdout)
        while b"\n" not in self._received:
            ready, _, _ = select.select([stream], [], [], within)
            assert ready, f"the emulator says nothing within {within:g} s"
            data = os.read(stream.fileno(), 65536)
            assert data, "the emulator has ended"
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return line.decode().strip()
