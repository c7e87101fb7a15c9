"""Two machines in one: network namespaces of the kernel, joined by a cable, with a daemon in each."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name

TOOLS = ("ip", "nft", "tc")
DEVICE = "cable"


class Cable:
    """Namespaces 1 and 2 and a veth pair between them. Use it in a ``with`` statement; the test is skipped without.

    What is set up in a namespace is nobody else's: addresses and ports in it need not be free anywhere.
    """

    def __init__(self, tools: Sequence[str] = TOOLS) -> None:
        self._tools = tools
        self._names = {end: f"dcf-{os.getpid()}-{end}" for end in (1, 2)}
        self._open = ExitStack()

    def __enter__(self) -> Self:
        if missing := [tool for tool in self._tools if shutil.which(tool) is None]:
            pytest.skip(f"the kernel's own faults need {', '.join(missing)}, which is not installed")
        with ExitStack() as cleaning:
            for name in self._names.values():
                made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
                if made.returncode:
                    pytest.skip(f"network namespaces are not permitted here: {made.stderr.strip()}")
                cleaning.callback(subprocess.run, ["ip", "netns", "delete", name], check=True)
            one, two = self._names.values()
            _run("ip", "-n", one, "link", "add", DEVICE, "type", "veth", "peer", "name", DEVICE, "netns", two)
            for end, name in self._names.items():
                _run("ip", "-n", name, "address", "add", f"{self.address(end)}/24", "dev", DEVICE)
                for device in ("lo", DEVICE):
                    _run("ip", "-n", name, "link", "set", device, "up")
            self._open = cleaning.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    @staticmethod
    def address(end: int) -> str:
        """Of one end of the cable."""
        return f"10.77.0.{end}"

    def inside(self, end: int, *command: str) -> str:
        """What a command prints in the namespace of one end."""
        return _run("ip", "netns", "exec", self._names[end], *command)

    def run(
        self, fleet: Path, folder: Path, within: float, meanwhile: Callable[[], None] = lambda: None
    ) -> Mapping[int, AgentLog]:
        """Run agents 1 and 2 of `fleet`, one daemon at each end, to their end; what they recorded."""
        with ExitStack() as ending:
            daemons = []
            for end, name in self._names.items():
                command = [sys.executable, "-m", "agentd", "run", str(fleet), "--id", str(end), "--out", str(folder)]
                daemon = subprocess.Popen(["ip", "netns", "exec", name, *command], stderr=subprocess.PIPE, text=True)
                ending.enter_context(daemon)
                ending.callback(daemon.kill)  # before its context waits for it
                daemons.append(daemon)
            meanwhile()
            for daemon in daemons:
                _, errors = daemon.communicate(timeout=within)
                assert daemon.returncode == 0, errors
        return {end: AgentLog.read((folder / log_name(end)).read_bytes(), log_name(end)) for end in self._names}


def _run(*command: str) -> str:
    """What a command prints; its complaints, if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stderr}"
    return done.stdout
