"""Launch a fleet on this machine, supervise its daemons, and end them together."""

import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any, TypeAlias, TypeVar

from agentd.daemon.signals import ENDING, signal_name
from agentd.daemon.stop_requests import in_foreground
from agentd.endpoints import free_endpoints
from agentd.exit_codes import DONE, NEIGHBOUR_LOST, STOPPED, UNRECORDED
from agentd.launcher.child_process import ProcessStarter
from agentd.launcher.daemon_process import DaemonProcess, start_daemon
from agentd.launcher.key_presses import reading_keys
from agentd.launcher.terminal import Terminal
from agentd.operator_file import OperatorFile
from agentd.run_directory import followed, write_run_json
from dcf_zenoh.config import LoadedFleet, freeze
from dcf_zenoh.configuration.building.problem_and_plant import plant_classes
from dcf_zenoh.configuration.checks.bodies import shared_devices
from dcf_zenoh.errors import ConfigurationError, DcfError, Interrupted, RecordingError
from dcf_zenoh.messaging.address import Address, check_settings, prefix_of
from dcf_zenoh.plugins import load

REACTION = 2.0  # s that other daemons have to end by themselves after one has failed
LINGER = 30.0  # s that other daemons have to end after one has reached its planned end
TERM = 3.0  # s between SIGTERM and SIGKILL
LAST_STATUS = 1.0  # s to read what a daemon wrote before it ended
STATUS_PERIOD = 0.1  # s between calls of `on_status`
YES = "--yes agrees beforehand"

T = TypeVar("T")
OnStatus: TypeAlias = Callable[[Mapping[int, Mapping[str, Any]]], None]
OnMessage: TypeAlias = Callable[[str], None]


class FleetFailed(DcfError):
    """At least one agent did not reach its planned end. All processes have ended nevertheless."""


class RunFailures:
    """Failures of a run, reported when they occur and collected.

    Args:
        on_message: Called with the text of each failure.

    Attributes:
        causes: Failures with a cause of their own.
        effects: Failures because of another agent.
    """

    def __init__(self, on_message: OnMessage) -> None:
        self._on_message = on_message
        self.causes: list[str] = []
        self.effects: list[str] = []

    def add(self, text: str, *, effect: bool = False) -> None:
        """Add a failure: a cause, or an effect of another one."""
        (self.effects if effect else self.causes).append(text)
        self._on_message(text)


def launch(fleet: LoadedFleet, folder: Path, on_status: OnStatus, on_message: OnMessage, *, yes: bool = False) -> None:
    """Run a fleet as one daemon per agent; return when all daemons have ended.

    Args:
        fleet: Fleet to run.
        folder: An empty run directory.
        on_status: Called with agent -> latest status, every `STATUS_PERIOD`.
        on_message: Called with a line about an event that the operator should know of.
        yes: Whether real bodies may take off without a key press.

    Raises:
        FleetFailed: An agent failed.
        Interrupted: A signal stopped the fleet.
        NetworkError: Zenoh rejects a setting of the fleet file, or an agent cannot listen at its endpoint.
        RecordingError: The run directory cannot be written before the start.
        ConfigurationError: The take-off of real bodies needs consent, and there is no terminal; or two of them use one
            device of this machine.
    """
    on_status, on_message = _without_output_errors(on_status), _without_output_errors(on_message)
    check_settings(fleet.spec.zenoh.settings)
    plants = plant_classes(fleet.spec, fleet.folder)
    real = any(plant.real for plant in plants)
    landing = max((plant.landing_time for plant in plants), default=0.0)
    if real and not yes and not in_foreground():
        raise ConfigurationError(f"real bodies take off when a person presses a key: there is no terminal; {YES}")
    _check_devices(fleet)
    reaction = patience = REACTION + landing
    if fleet.spec.time.clock == "wall" and fleet.spec.safety.neighbour_silent.then in ("hold", "continue"):
        patience = fleet.spec.time.duration + landing + LINGER
    daemons: dict[int, DaemonProcess] = {}
    failures = RunFailures(on_message)
    interrupted: int | None = None
    modules = [plant.__module__ for plant in plants if not plant.real and plant.__module__.startswith("plants.")]
    with (
        ProcessStarter(len(fleet.spec.agents), modules) as starter,
        followed(folder) as place,
        _queued_signals() as signals,
        reading_keys() as keys,
    ):
        endpoints = free_endpoints(fleet.spec)
        frozen = freeze(fleet, folder)
        run_json = _describe_run(fleet, folder, endpoints)
        try:
            for agent in frozen.spec.ids:
                daemons[agent] = _start(starter, folder, agent)
            starter.close()
            terminal = Terminal(daemons, keys, on_message, real=real, yes=yes)
            interrupted = _supervise(
                daemons, signals, on_status, failures, terminal, reaction=reaction, patience=patience
            )
        finally:
            _end_all(daemons, failures, TERM + landing)
            if (now := place()) != folder:
                failures.add(f"{folder}: the run directory was renamed to {now}")
            _describe_end(now, run_json, daemons, failures)
    if interrupted is not None:
        raise Interrupted(f"stopped by {signal_name(interrupted)}", interrupted)
    if reasons := failures.causes or failures.effects:
        more = f"; and {len(reasons) - 1} more, see above" if len(reasons) > 1 else ""
        raise FleetFailed(reasons[0] + more)


def _check_devices(fleet: LoadedFleet) -> None:
    """Refuse bodies that share a device, such as a radio: all daemons run on this machine.

    Raises:
        ConfigurationError: Two agents use one device.
    """
    for each in shared_devices(fleet.spec, lambda kind: load("plants", kind, fleet.folder)):
        raise ConfigurationError(f"{each.key}: {each.text}", fleet.source)


def _describe_run(fleet: LoadedFleet, folder: Path, endpoints: Mapping[int, str]) -> dict[str, Any]:
    """Write ``run.json`` and ``operator.json``; return the content of the first.

    Raises:
        RecordingError: The run directory cannot be written.
    """
    run_json: dict[str, Any] = {
        "fleet": fleet.spec.name,
        "run": folder.resolve().name,
        "source": fleet.source,
        "clock": fleet.spec.time.clock,
        "launched": datetime.now(UTC).isoformat(),
        "endpoints": endpoints,
    }
    _write_run_json(folder, run_json)
    prefix = prefix_of(fleet.spec.name, run_json["run"])
    address = Address(prefix, "", tuple(endpoints.values()), fleet.spec.zenoh.settings)
    OperatorFile.of(fleet.spec.name, fleet.spec.ids, address).write(folder)
    return run_json


def _describe_end(
    folder: Path, run_json: dict[str, Any], daemons: Mapping[int, DaemonProcess], failures: RunFailures
) -> None:
    """Add the end of the run to ``run.json``, or a failure if it cannot be written."""
    run_json["ended"] = datetime.now(UTC).isoformat()
    run_json["exit_codes"] = {i: daemon.code for i, daemon in daemons.items()}
    run_json["problems"] = [*failures.causes, *failures.effects]
    try:
        _write_run_json(folder, run_json)
    except RecordingError as error:
        failures.add(str(error))


def _start(starter: ProcessStarter, folder: Path, agent: int) -> DaemonProcess:
    """Start the daemon of an agent.

    Raises:
        RecordingError: The file for its standard error cannot be written.
    """
    try:
        return start_daemon(starter, folder, agent)
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        raise RecordingError(f"agent {agent}: cannot be started: {reason}") from error


def _write_run_json(folder: Path, content: Mapping[str, Any]) -> None:
    """Write ``run.json``.

    Raises:
        RecordingError: The disk is full, or the directory is gone.
    """
    try:
        write_run_json(folder, content)
    except OSError as error:
        raise RecordingError(f"{folder / 'run.json'}: cannot be written: {error.strerror}") from error


def _without_output_errors(function: Callable[[T], None]) -> Callable[[T], None]:
    """Return `function` as one that does not fail because its output goes nowhere: terminal closed, disk full."""

    def call(argument: T) -> None:
        with suppress(OSError, ValueError):
            function(argument)

    return call


def _supervise(
    daemons: Mapping[int, DaemonProcess],
    signals: SimpleQueue[int],
    on_status: OnStatus,
    failures: RunFailures,
    terminal: Terminal,
    *,
    reaction: float,
    patience: float,
) -> int | None:
    """Wait until all daemons have ended, or until the remaining ones have to be ended.

    Args:
        daemons: Agent -> its daemon.
        signals: Signals that the launcher has received.
        on_status: As in `launch`.
        failures: Failures are added to it.
        terminal: Polled regularly.
        reaction: Time that the other daemons have to end after one has failed before the start, s.
        patience: Time that they have after one has failed in flight, s: as long as they may go on flying without it.

    Returns:
        The number of the signal that stopped the fleet, if any.
    """
    began, last_shown = time.monotonic(), 0.0
    end_all_by = end_unstarted_by = inf

    def time_is_up(now: float) -> bool:
        """Return whether to end the remaining daemons. A fleet that lacks an agent never starts."""
        return now >= end_all_by or (now >= end_unstarted_by and not any(daemon.started for daemon in daemons.values()))

    while any(daemon.code is None for daemon in daemons.values()) and not time_is_up(time.monotonic()):
        try:
            number = signals.get(timeout=0.02)
            failures.add(f"the launcher got {signal_name(number)}: the fleet was stopped")
            return number
        except Empty:
            pass
        now = time.monotonic()
        for daemon in daemons.values():
            if daemon.code is None and (code := daemon.process.poll()) is not None:
                daemon.code = code
                if code:
                    daemon.status = {**daemon.status, "ended": True}
                    text = f"agent {daemon.agent} {_end_text(daemon, now - began)}"
                    failures.add(text, effect=code == NEIGHBOUR_LOST)
                if code < 0 and not daemon.started:  # its last status line may be missing, so the fleet may fly
                    end_unstarted_by = min(end_unstarted_by, now + reaction)
                in_flight = code != STOPPED and (code < 0 or daemon.started)
                rest = LINGER if code in (DONE, UNRECORDED) else patience if in_flight else reaction
                end_all_by = min(end_all_by, now + rest)
        terminal.poll()
        if now - last_shown >= STATUS_PERIOD:
            last_shown = now
            on_status({i: daemon.status for i, daemon in daemons.items()})
    on_status({i: daemon.status for i, daemon in daemons.items()})
    return None


def _end_text(daemon: DaemonProcess, after: float) -> str:
    """Describe how a daemon ended, `after` s after the launch."""
    code = daemon.code or 0
    daemon.reader.join(LAST_STATUS)
    how = f"was killed by {signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
    error = daemon.last_error_line()
    return f"{how} {after:.1f} s after the launch{_progress_text(daemon)}" + (f": {error}" if error else "")


def _progress_text(daemon: DaemonProcess) -> str:
    return f", after step {daemon.status['step']}" if "step" in daemon.status else ", before its first step"


def _end_all(daemons: Mapping[int, DaemonProcess], failures: RunFailures, patience: float) -> None:
    """End all daemons that still run: SIGTERM, then SIGKILL for those that have not ended after `patience` s."""
    running = [daemon for daemon in daemons.values() if daemon.process.poll() is None]
    for daemon in running:
        daemon.process.terminate()
    deadline = time.monotonic() + patience
    for daemon in running:
        try:
            daemon.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            failures.add(
                f"agent {daemon.agent} did not end within {patience:g} s of SIGTERM: killed{_progress_text(daemon)}"
            )
            daemon.process.kill()
    for daemon in daemons.values():
        daemon.code = daemon.process.wait(TERM)
        assert daemon.process.stdin is not None
        daemon.process.stdin.close()


@contextmanager
def _queued_signals() -> Iterator[SimpleQueue[int]]:
    """Queue the signals that would end the process, within the context; a second one of a kind has its usual effect."""
    queue: SimpleQueue[int] = SimpleQueue()

    def on_signal(number: int, _frame: FrameType | None) -> None:
        queue.put(number)
        signal.signal(number, before[number])

    before = {}
    for number in sorted(ENDING):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler) or number == signal.SIGINT:
            before[number] = signal.signal(number, on_signal)
    try:
        yield queue
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
