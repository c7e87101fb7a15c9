"""Launch a fleet on this machine, watch over it, and end it together."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any, TypeAlias

from agentd.daemon.stop_requests import in_foreground
from agentd.endpoints import free_endpoints
from agentd.exit_codes import NEIGHBOUR_LOST, STOPPED
from agentd.launcher.daemon_process import DaemonProcess, spawn
from agentd.launcher.key_presses import listen
from agentd.launcher.terminal import Terminal
from agentd.run_directory import write_run_json
from dcf_zenoh.config import LoadedFleet, freeze
from dcf_zenoh.configuration.building.problem_and_plant import plant_classes
from dcf_zenoh.errors import ConfigurationError, DcfError, Interrupted
from dcf_zenoh.messaging.network import check_settings

REACTION = 2.0  # s the others get to end by themselves after one has failed
LINGER = 30.0  # s the others get to end after one has reached its planned end
TERM = 3.0  # s between SIGTERM and SIGKILL
LAST_STATUS = 1.0  # s to read what a daemon wrote before it ended
YES = "--yes agrees beforehand"

Show: TypeAlias = Callable[[Mapping[int, Mapping[str, Any]]], None]
Say: TypeAlias = Callable[[str], None]


class FleetFailed(DcfError):
    """At least one agent did not reach its planned end. Every process is gone all the same."""


class RunFailures:
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


def launch(fleet: LoadedFleet, folder: Path, show: Show, say: Say, *, yes: bool = False) -> None:
    """Run a fleet as one daemon per agent; return when all have ended.

    Args:
        fleet: What to run.
        folder: An empty run directory.
        show: Called with agent -> last status, several times a second.
        say: Called with a line when something happens that a person should know.
        yes: Real bodies may take off without a key press.

    Raises:
        FleetFailed: An agent failed.
        Interrupted: Somebody stopped the fleet.
        NetworkError: Zenoh does not accept a setting of the fleet file.
        ConfigurationError: Real bodies shall fly, and nobody is there to agree to it.
    """
    check_settings(fleet.spec.zenoh.settings)
    plants = plant_classes(fleet.spec, fleet.folder)
    real = any(plant.real for plant in plants)
    landing = max((plant.landing_time for plant in plants), default=0.0)
    if real and not yes and not in_foreground():
        raise ConfigurationError(f"real bodies take off when a person presses a key: there is no terminal; {YES}")
    frozen = freeze(fleet, folder)
    about: dict[str, Any] = {
        "fleet": fleet.spec.name,
        "run": folder.resolve().name,
        "source": fleet.source,
        "clock": fleet.spec.time.clock,
        "launched": datetime.now(UTC).isoformat(),
        "endpoints": free_endpoints(fleet.spec),
    }
    write_run_json(folder, about)
    reaction = patience = REACTION + landing
    if fleet.spec.time.clock == "wall" and fleet.spec.safety.neighbour_silent.then in ("hold", "continue"):
        patience = fleet.spec.time.duration + landing + LINGER
    daemons: dict[int, DaemonProcess] = {}
    problems = RunFailures(say)
    interrupted: signal.Signals | None = None
    with _stop_requests() as asked, listen() as keys:
        try:
            for agent in frozen.spec.ids:
                daemons[agent] = spawn(folder, agent)
            pilot = Terminal(daemons, keys, say, real=real, yes=yes)
            interrupted = _supervise(daemons, asked, show, problems, pilot, reaction=reaction, patience=patience)
        finally:
            _end(daemons, problems, TERM + landing)
            about["ended"] = datetime.now(UTC).isoformat()
            about["exit_codes"] = {i: daemon.code for i, daemon in daemons.items()}
            about["problems"] = [*problems.causes, *problems.effects]
            write_run_json(folder, about)
    if interrupted is not None:
        raise Interrupted(f"stopped by {interrupted.name}", interrupted)
    if found := problems.causes or problems.effects:
        more = f"; and {len(found) - 1} more, see above" if len(found) > 1 else ""
        raise FleetFailed(found[0] + more)


def _supervise(
    daemons: Mapping[int, DaemonProcess],
    asked: SimpleQueue[signal.Signals],
    show: Show,
    problems: RunFailures,
    pilot: Terminal,
    *,
    reaction: float,
    patience: float,
) -> signal.Signals | None:
    """Watch until all daemons have ended, or until it is time to end them; note what went wrong.

    Args:
        daemons: The fleet.
        asked: Signals that the launcher got.
        show: Told of the last status of all.
        problems: What went wrong.
        pilot: Looks after take-off and landing.
        reaction: What the others get to end by themselves after one has failed, s.
        patience: The same after one has failed in flight, s: as long as the flight may take if the others go on.

    Returns:
        The signal that asked for the end, if one did.
    """
    began, shown = time.monotonic(), 0.0
    give_up = never_to_start = inf

    def over(now: float) -> bool:
        """Whether it is time to end those who are left: without one of them a fleet does not start."""
        return now >= give_up or (now >= never_to_start and not any(daemon.started for daemon in daemons.values()))

    while any(daemon.code is None for daemon in daemons.values()) and not over(time.monotonic()):
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
                if code < 0 and not daemon.started:  # it may have had no time to say so
                    never_to_start = min(never_to_start, now + reaction)
                in_flight = code != STOPPED and (code < 0 or daemon.started)
                rest = LINGER if not code else patience if in_flight else reaction
                give_up = min(give_up, now + rest)
        pilot.look()
        if now - shown >= 0.1:
            shown = now
            show({i: daemon.status for i, daemon in daemons.items()})
    show({i: daemon.status for i, daemon in daemons.items()})
    return None


def _death(daemon: DaemonProcess, after: float) -> str:
    """How a daemon ended, and when."""
    code = daemon.code or 0
    daemon.reader.join(LAST_STATUS)
    how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    words = daemon.last_words()
    return f"{how} {after:.1f} s after the launch{_progress(daemon)}" + (f": {words}" if words else "")


def _progress(daemon: DaemonProcess) -> str:
    return f", after step {daemon.status['step']}" if "step" in daemon.status else ", before its first step"


def _end(daemons: Mapping[int, DaemonProcess], problems: RunFailures, patience: float) -> None:
    """Make sure that no daemon is left: ask, wait for `patience` s, and end by force whoever does not listen."""
    running = [daemon for daemon in daemons.values() if daemon.process.poll() is None]
    for daemon in running:
        daemon.process.terminate()
    deadline = time.monotonic() + patience
    for daemon in running:
        try:
            daemon.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            problems.add(
                f"agent {daemon.agent} did not end within {patience:g} s of SIGTERM: killed{_progress(daemon)}"
            )
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
