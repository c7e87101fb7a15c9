"""Launch a fleet on this machine, watch over it, and end it together."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any, TypeAlias

from agentd.exit_codes import NEIGHBOUR_LOST
from agentd.rundir import free_endpoints, write_about
from dcf_zenoh.config import LoadedFleet, freeze
from dcf_zenoh.errors import DcfError, Interrupted
from dcf_zenoh.messaging.network import check_settings

REACTION = 2.0  # s the others get to end by themselves after one has failed
LINGER = 30.0  # s the others get to end after one has reached its planned end
TERM = 3.0  # s between SIGTERM and SIGKILL
LAST_STATUS = 1.0  # s to read what a daemon wrote before it ended

Show: TypeAlias = Callable[[Mapping[int, Mapping[str, Any]]], None]
Say: TypeAlias = Callable[[str], None]


class FleetFailed(DcfError):
    """At least one agent did not reach its planned end. Every process is gone all the same."""


@dataclass
class Daemon:
    """One child process.

    Attributes:
        agent: Id.
        process: The process.
        errors: File with its standard error.
        status: Last status line.
        code: Its exit code once it has ended; negative for a signal.
        reader: Reads the status lines.
    """

    agent: int
    process: subprocess.Popen[str]
    errors: Path
    status: Mapping[str, Any] = field(default_factory=dict)
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
                self.status = json.loads(line)

    def last_words(self) -> str:
        """The last line of its standard error, without the name of the program."""
        lines = self.errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1].removeprefix("agentd: ") if lines else ""


class Problems:
    """What went wrong, told at once and kept.

    Args:
        say: Told of each.

    Attributes:
        causes: What went wrong by itself.
        effects: What went wrong because of another agent.
    """

    def __init__(self, say: Say) -> None:
        self._say = say
        self.causes: list[str] = []
        self.effects: list[str] = []

    def add(self, text: str, *, effect: bool = False) -> None:
        """Note `text`."""
        (self.effects if effect else self.causes).append(text)
        self._say(text)


def launch(fleet: LoadedFleet, folder: Path, show: Show, say: Say) -> None:
    """Run a fleet as one daemon per agent; return when all have ended.

    Args:
        fleet: What to run.
        folder: An empty run directory.
        show: Called with agent -> last status, several times a second.
        say: Called with a line when something happens that a person should know.

    Raises:
        FleetFailed: An agent failed.
        Interrupted: Somebody stopped the fleet.
        NetworkError: Zenoh does not accept a setting of the fleet file.
    """
    check_settings(fleet.spec.zenoh.settings)
    frozen = freeze(fleet, folder)
    about: dict[str, Any] = {
        "fleet": fleet.spec.name,
        "run": folder.resolve().name,
        "source": fleet.source,
        "clock": fleet.spec.time.clock,
        "launched": datetime.now(UTC).isoformat(),
        "endpoints": free_endpoints(fleet.spec),
    }
    write_about(folder, about)
    patient = fleet.spec.time.clock == "wall" and fleet.spec.safety.neighbour_silent.then != "stop"
    daemons: dict[int, Daemon] = {}
    problems = Problems(say)
    interrupted: signal.Signals | None = None
    with _stop_requests() as asked:
        try:
            for agent in frozen.spec.ids:
                daemons[agent] = _spawn(folder, agent)
            interrupted = _supervise(daemons, asked, show, problems, patient=patient)
        finally:
            _end(daemons, problems)
            about["ended"] = datetime.now(UTC).isoformat()
            about["exit_codes"] = {i: daemon.code for i, daemon in daemons.items()}
            about["problems"] = [*problems.causes, *problems.effects]
            write_about(folder, about)
    if interrupted is not None:
        raise Interrupted(f"stopped by {interrupted.name}", interrupted)
    if found := problems.causes or problems.effects:
        raise FleetFailed("; ".join(found))


def _spawn(folder: Path, agent: int) -> Daemon:
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
    return Daemon(agent, process, path)


def _supervise(
    daemons: Mapping[int, Daemon], asked: SimpleQueue[signal.Signals], show: Show, problems: Problems, *, patient: bool
) -> signal.Signals | None:
    """Watch until all daemons have ended, or until it is time to end them; note what went wrong.

    Returns:
        The signal that asked for the end, if one did.
    """
    began, shown = time.monotonic(), 0.0
    give_up = float("inf")
    while any(daemon.code is None for daemon in daemons.values()) and time.monotonic() < give_up:
        try:
            asking = asked.get(timeout=0.02)
            problems.add(f"the launcher got {asking.name}: the fleet was stopped")
            return asking
        except Empty:
            pass
        now = time.monotonic()
        for daemon in daemons.values():
            if daemon.code is None and (code := daemon.process.poll()) is not None:
                daemon.code = code
                if code:
                    daemon.status = {**daemon.status, "ended": True}
                    text = f"agent {daemon.agent} {_death(daemon, now - began)}"
                    problems.add(text, effect=code == NEIGHBOUR_LOST)
                if not (code and patient):
                    give_up = min(give_up, now + (REACTION if code else LINGER))
        if now - shown >= 0.1:
            shown = now
            show({i: daemon.status for i, daemon in daemons.items()})
    show({i: daemon.status for i, daemon in daemons.items()})
    return None


def _death(daemon: Daemon, after: float) -> str:
    """How a daemon ended, and when."""
    code = daemon.code or 0
    daemon.reader.join(LAST_STATUS)
    how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    words = daemon.last_words()
    return f"{how} {after:.1f} s after the launch{_progress(daemon)}" + (f": {words}" if words else "")


def _progress(daemon: Daemon) -> str:
    return f", after step {daemon.status['step']}" if "step" in daemon.status else ", before its first step"


def _end(daemons: Mapping[int, Daemon], problems: Problems) -> None:
    """Make sure that no daemon is left: ask, wait, and end by force whoever does not listen."""
    running = [daemon for daemon in daemons.values() if daemon.process.poll() is None]
    for daemon in running:
        daemon.process.terminate()
    deadline = time.monotonic() + TERM
    for daemon in running:
        try:
            daemon.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            problems.add(f"agent {daemon.agent} did not end within {TERM:g} s of SIGTERM: killed{_progress(daemon)}")
            daemon.process.kill()
    for daemon in daemons.values():
        daemon.code = daemon.process.wait(TERM)
        assert daemon.process.stdin is not None
        daemon.process.stdin.close()


@contextmanager
def _stop_requests() -> Iterator[SimpleQueue[signal.Signals]]:
    """SIGINT, SIGTERM and SIGHUP in a queue while the body runs; a second one of a kind acts at once."""
    asked: SimpleQueue[signal.Signals] = SimpleQueue()
    numbers = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]

    def on_signal(number: int, _frame: FrameType | None) -> None:
        asked.put(signal.Signals(number))
        signal.signal(number, before[signal.Signals(number)])

    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
