"""One agent as a process: the composition root, where plant, controller, network and clock come together."""

import hashlib
import json
import logging
import os
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, cast

from agentd import exit_codes
from agentd.daemon.operator_protocol import HALT, Control, changes_in
from agentd.daemon.output import LogFile, StatusPipe, drain_output
from agentd.daemon.runner import VirtualRunner, WallRunner, await_goodbyes, spare_collector
from agentd.daemon.signals import CTRL_Z, ENDING, CaughtSignals, signal_name
from agentd.daemon.stop_requests import STOP_WITHIN, EmergencyStop, read_lines
from dcf_zenoh.assembly import AgentParts, Blueprint, Restart
from dcf_zenoh.config import LoadedFleet, to_toml
from dcf_zenoh.errors import Interrupted, LogIncomplete, NetworkError, NotReady, RecordingError, Stopped
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.loop.agent import Ending
from dcf_zenoh.message import VERSION, Last
from dcf_zenoh.messaging.address import Address, endpoints_to_connect, prefix_of
from dcf_zenoh.messaging.events import Agreed, Stop
from dcf_zenoh.messaging.handshake import ClockOffset
from dcf_zenoh.messaging.network import Network
from dcf_zenoh.plant import State, read_only
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import StepRecord, log_name, open_log
from dcf_zenoh.requests import Report
from dcf_zenoh.runner import Runner, drive
from dcf_zenoh.spec import FleetSpec

log = logging.getLogger(__name__)
GOODBYE_TIMEOUT = 2.0  # s, longest wait for the neighbours' goodbyes
SEND_TIMEOUT = 0.5  # s, longest wait of a message for a neighbour that accepts none, on the wall clock
END_WITHIN = 2.5  # s from a signal to the end of the process, in addition to the landing time of the plant
LEASE = 2.0  # s without any sign of life after which a link is given up, on the wall clock; Zenoh opens it again
CLOCK_OFFSET_MAX = 0.02  # s, largest offset between two machines on the wall clock


@dataclass(frozen=True)
class Assignment:
    """Task of a daemon, in addition to the fleet file.

    Attributes:
        agent: Id of the agent to run.
        run: Name of the run; part of all keys.
        folder: Run directory.
        endpoints: Agent -> endpoint on which it listens.
        rejoin: Whether the agent joins its running fleet again, after an earlier incarnation.
        status: Pipe for status lines to the launcher, which holds the other end of standard input; None: there is no
            launcher.
        agreed: Whether a person has agreed to the take-off.
    """

    agent: int
    run: str
    folder: Path
    endpoints: dict[int, str]
    rejoin: bool = False
    status: StatusPipe | None = None
    agreed: bool = False


def fingerprint(fleet: LoadedFleet) -> str:
    """Return a short hash of all that must be the same at every agent: protocol, resolved fleet, plug-in files."""
    total = hashlib.sha256(f"{VERSION}\n{to_toml(fleet.spec)}".encode())
    plugins = fleet.folder / "plugins.json"
    if plugins.is_file():
        total.update(plugins.read_bytes())
    return total.hexdigest()[:16]


def run_agent(fleet: LoadedFleet, task: Assignment) -> Last:
    """Run one agent to its planned end.

    All signals that can be caught land it, from before its session is opened until it has ended.

    Raises:
        Interrupted: A signal ended it early.
        LogIncomplete: It has reached its end, but records of its log are missing.
        DcfError: Another error that ended it early.
    """
    emergency = EmergencyStop()
    with CaughtSignals(ENDING | CTRL_Z) as signals:
        try:
            return _run_agent(fleet, task, emergency, signals)
        except (Stopped, NotReady) as error:
            if signals.number is None or _stopped_by(signals.number) not in str(error):
                raise
            raise Interrupted(str(error), signals.number) from error


def _run_agent(fleet: LoadedFleet, task: Assignment, emergency: EmergencyStop, signals: CaughtSignals) -> Last:
    """Run one agent as `run_agent` does; a signal stops it like an operator."""
    blueprint = Blueprint.of(fleet)
    signals.end_within(lambda: END_WITHIN + emergency.landing_time, partial(_end_process, task.agent, emergency))
    neighbourhood = blueprint.neighbourhood(task.agent)
    address = _address(fleet.spec, task, neighbourhood)
    restart = restart_of(fleet.spec, task.folder, task.agent) if task.rejoin else None
    incarnation = restart.incarnation if restart else 0
    with (
        Network(
            task.agent, neighbourhood, address, lambda request: emergency.pull() if request == HALT else None
        ) as network,
        open_log(task.folder, task.agent, again=task.rejoin) as file,  # after the port: no other daemon writes it
        closing(LogFile(file, partial(_warn, task.agent))) as stream,
    ):
        signals.react(lambda number: network.notify(Stop(_stopped_by(number))))
        read_lines(network, emergency, supervised=task.status is not None)
        if task.agreed:
            network.notify(Agreed())
        offsets = network.do_handshake(fingerprint(fleet), fleet.spec.zenoh.ready_timeout, incarnation)
        if restart and not network.start:
            raise NetworkError(f"agent {task.agent}: --rejoin: this fleet has not started yet")
        _check_offsets(task.agent, offsets, wall=fleet.spec.time.clock == "wall")
        header = {
            "run": task.run,
            "incarnation": incarnation,
            "clock_offsets": {j: (offset.ahead, offset.error) for j, offset in offsets.items()},
        }
        status = Status(task.agent, task.status)
        parts = blueprint.build(task.agent, cast(BinaryIO, stream), header, status.observe, restart)
        if stream.failure:  # before anything moves
            raise RecordingError(f"agent {task.agent}: {stream.failure}")
        emergency.guard(parts.plant)

        def end(why: str) -> None:
            emergency.settle(STOP_WITHIN)  # motors off before the landing begins
            network.notify(Stop(why))

        control = Control(task.agent, fleet, neighbourhood.receives_from, parts.links, parts.recorder, end)
        if restart:
            control.restore(changes_in(read_log(fleet.spec, task.folder, task.agent)))
        try:
            ending = _run(fleet, parts, network, offsets, control, status)
        finally:
            parts.plant.close()
            if status.dropped:
                _warn(task.agent, f"{status.dropped} status lines were dropped: the launcher did not read them")
            for command in network.unanswered():
                if command.request == HALT:  # it has stopped the body, and the loop has ended without an answer
                    command.reply(control.handle(command.request, 0))
    if ending.cause:
        raise ending.cause
    if stream.failure:
        raise LogIncomplete(f"agent {task.agent}: reached its end, but its log is incomplete: {stream.failure}")
    return ending.last


def _stopped_by(number: int) -> str:
    return f"stopped by {signal_name(number)}"


def _end_process(agent: int, emergency: EmergencyStop, number: int) -> None:
    """End a process that a signal was not able to end in time: the motors are switched off."""
    emergency.pull()
    emergency.settle(STOP_WITHIN)
    _warn(agent, f"did not end in time after {signal_name(number)}: motors off, and the process ends")
    drain_output()
    os._exit(exit_codes.SIGNALLED + number)


def _warn(agent: int, text: str) -> None:
    log.warning("agentd: agent %d: %s", agent, text)


def _address(fleet: FleetSpec, task: Assignment, neighbourhood: Neighbourhood) -> Address:
    linked = sorted({*neighbourhood.receives_from, *neighbourhood.sends_to})
    wall = fleet.time.clock == "wall"
    return Address(
        prefix=prefix_of(fleet.name, task.run),
        listen=task.endpoints[task.agent],
        connect=endpoints_to_connect(task.agent, linked, task.endpoints),
        settings=fleet.zenoh.settings,
        send_timeout=SEND_TIMEOUT if wall else fleet.zenoh.receive_timeout,
        lease=LEASE if wall else Address.lease,
        lossy=wall,
    )


def restart_of(fleet: FleetSpec, folder: Path, agent: int) -> Restart:
    """Return how an agent restarts, from its log.

    Raises:
        RecordingError: There is no log, or no state in it; or it is damaged, so that further records could not be read.
    """
    log = read_log(fleet, folder, agent)
    if log.damage:
        raise RecordingError(f"--rejoin: {log.damage}; it cannot be continued")
    if not len(log.state):
        raise RecordingError(f"{folder / log_name(agent)}: --rejoin: agent {agent} has not recorded a single step")
    half = log.state.shape[1] // 2
    return Restart(log.lives, State(read_only(log.state[-1, :half]), read_only(log.state[-1, half:])))


def read_log(fleet: FleetSpec, folder: Path, agent: int) -> AgentLog:
    """Read the log of an agent's earlier incarnations.

    Raises:
        RecordingError: There is no log, it cannot be read, or it belongs to another agent or fleet.
    """
    try:
        return AgentLog.load(folder, agent, fleet)
    except RecordingError as error:
        raise RecordingError(f"--rejoin: {error}") from error


class Status:
    """Status lines to the launcher: one JSON object per line.

    Args:
        agent: Id of the agent.
        pipe: Pipe that the launcher reads; None: there is no launcher.
    """

    def __init__(self, agent: int, pipe: StatusPipe | None) -> None:
        self._agent = agent
        self._pipe = pipe
        self._late = 0
        self._phase = ""

    @property
    def dropped(self) -> int:
        """Number of lines that the launcher did not read in time."""
        return self._pipe.dropped if self._pipe else 0

    def observe(self, record: StepRecord) -> None:
        """Report a finished step."""
        self._late += record.late
        half = len(record.state) // 2
        self._write(
            step=record.step,
            rounds=record.rounds,
            late=self._late,
            position=record.state[:half],
            remark=record.remark,
        )

    def report(self, phase: Report) -> None:
        """Report that a phase of the flight begins, and the results of the inspection."""
        self._phase = phase.phase
        self._write(checks=phase.checks)

    def _write(self, **entries: Any) -> None:
        """Write a line, with the phase: the line that reported it may have been dropped."""
        if self._pipe is None:
            return
        try:
            self._pipe.write(json.dumps({"agent": self._agent, "phase": self._phase, **entries}))
        except OSError:
            self._pipe = None  # the launcher has ended; the log has everything


def _run(
    fleet: LoadedFleet,
    parts: AgentParts,
    network: Network,
    offsets: Mapping[int, ClockOffset],
    control: Control,
    status: Status,
) -> Ending:
    """Drive the loop to its end; after a planned end, stay until the neighbours have ended too."""

    def report(phase: Report) -> None:
        status.report(phase)
        if phase.phase == "start":
            spare_collector()

    zenoh = fleet.spec.zenoh
    runner: Runner
    if fleet.spec.time.clock == "wall":
        runner = WallRunner(parts, network, offsets, control.handle, report)
    else:
        runner = VirtualRunner(parts, network, zenoh.receive_timeout, zenoh.ready_timeout, report)
    ending = drive(parts.loop, runner)
    if ending.cause is None:
        await_goodbyes(parts, network, GOODBYE_TIMEOUT)
    return ending


def _check_offsets(agent: int, offsets: dict[int, ClockOffset], *, wall: bool) -> None:
    """Refuse a flight on the wall clock if the clocks of two machines disagree.

    Raises:
        NetworkError: A neighbour's clock is too far off for a common start.
    """
    for j, offset in offsets.items():
        off = abs(offset.ahead) - offset.error
        log.info("agent %d: clock of agent %d is %+.3f ms ahead", agent, j, offset.ahead * 1e-6)
        if wall and off > CLOCK_OFFSET_MAX * 1e9:
            raise NetworkError(
                f"agent {agent}: the clock of agent {j} is off by {offset.ahead * 1e-9:+.3f} s; at most"
                f" {CLOCK_OFFSET_MAX:g} s is allowed on the wall clock: synchronise the machines (NTP, chrony)"
            )
