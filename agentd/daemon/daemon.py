"""One agent as a process: the composition root, where plant, controller, network and clock come together."""

import hashlib
import json
import logging
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from agentd.daemon.operator_protocol import HALT, Control, changes_in
from agentd.daemon.runner import VirtualRunner, WallRunner, await_goodbyes, spare_collector
from agentd.daemon.stop_requests import EmergencyStop, listening
from dcf_zenoh.assembly import AgentParts, Blueprint, Restart
from dcf_zenoh.config import LoadedFleet, to_toml
from dcf_zenoh.errors import NetworkError, RecordingError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.loop.agent import Ending
from dcf_zenoh.message import VERSION, Last
from dcf_zenoh.messaging.handshake import ClockOffset
from dcf_zenoh.messaging.network import Address, Agreed, Network, Stop, endpoints_to_connect
from dcf_zenoh.plant import State, read_only
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import StepRecord, log_name, open_log
from dcf_zenoh.requests import Report
from dcf_zenoh.runner import Runner, drive
from dcf_zenoh.spec import FleetSpec

log = logging.getLogger(__name__)
GOODBYE_TIMEOUT = 2.0  # s, longest wait for the neighbours' goodbyes
SEND_TIMEOUT = 0.5  # s, longest wait of a message for a neighbour that accepts none, on the wall clock
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
        status: Stream of status lines to the launcher, which holds the other end of standard input; None: there is no
            launcher.
        agreed: Whether a person has agreed to the take-off.
    """

    agent: int
    run: str
    folder: Path
    endpoints: dict[int, str]
    rejoin: bool = False
    status: TextIO | None = None
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

    Raises:
        DcfError: The error that ended it early.
    """
    blueprint = Blueprint.of(fleet)
    neighbourhood = blueprint.neighbourhood(task.agent)
    address = _address(fleet.spec, task, neighbourhood)
    restart = restart_of(fleet.spec, task.folder, task.agent) if task.rejoin else None
    incarnation = restart.incarnation if restart else 0
    emergency = EmergencyStop()
    with (
        open_log(task.folder, task.agent, again=task.rejoin) as stream,
        Network(
            task.agent, neighbourhood, address, lambda request: emergency.pull() if request == HALT else None
        ) as network,
        listening(network, emergency, supervised=task.status is not None),
    ):
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
        parts = blueprint.build(task.agent, stream, header, status.observe, restart)
        emergency.guard(parts.plant)
        control = Control(
            task.agent,
            fleet,
            neighbourhood.receives_from,
            parts.links,
            parts.recorder,
            lambda why: network.notify(Stop(why)),
        )
        if restart:
            control.restore(changes_in(read_log(fleet.spec, task.folder, task.agent)))
        try:
            ending = _run(fleet, parts, network, offsets, control, status)
        finally:
            parts.plant.close()
            for command in network.unanswered():
                if command.request == HALT:  # it has stopped the body, and the loop has ended without an answer
                    command.reply(control.handle(command.request, 0))
    if ending.cause:
        raise ending.cause
    return ending.last


def _address(fleet: FleetSpec, task: Assignment, neighbourhood: Neighbourhood) -> Address:
    linked = sorted({*neighbourhood.receives_from, *neighbourhood.sends_to})
    return Address(
        prefix=f"dcf/{fleet.name}/{task.run}",
        listen=task.endpoints[task.agent],
        connect=endpoints_to_connect(task.agent, linked, task.endpoints),
        settings=fleet.zenoh.settings,
        send_timeout=SEND_TIMEOUT if fleet.time.clock == "wall" else fleet.zenoh.receive_timeout,
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


def claim_stdout() -> TextIO:
    """Reserve standard output for status lines; other output, for example of plug-ins, goes to standard error."""
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr  # unbuffered: output comes before the error that ends the process
    return stream


class Status:
    """Status lines to the launcher: one JSON object per line.

    Args:
        agent: Id of the agent.
        stream: Stream that the launcher reads; None: there is no launcher.
    """

    def __init__(self, agent: int, stream: TextIO | None) -> None:
        self._agent = agent
        self._stream = stream
        self._late = 0

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
        self._write(phase=phase.phase, checks=phase.checks)

    def _write(self, **entries: Any) -> None:
        if self._stream is None:
            return
        try:
            print(json.dumps({"agent": self._agent, **entries}), file=self._stream, flush=True)
        except (BrokenPipeError, ValueError):
            self._stream = None  # the launcher has ended; the log has everything


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
