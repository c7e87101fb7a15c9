"""One agent as a process of its own: the only place that joins plant, controller, network and clock."""

import hashlib
import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TextIO

from agentd.control import Control, changes_in
from agentd.runner import Stopped, await_goodbyes, run_virtual, run_wall, spare_collector
from dcf_zenoh.agent_log import AgentLog
from dcf_zenoh.assembly import AgentParts, Blueprint, LastLife
from dcf_zenoh.config import LoadedFleet, to_toml
from dcf_zenoh.errors import NetworkError, PlantError, RecordingError, blaming
from dcf_zenoh.messaging.hello import ClockOffset
from dcf_zenoh.messaging.message import VERSION, Last
from dcf_zenoh.messaging.network import Address, Network, Stop, endpoints_to_connect
from dcf_zenoh.plant import State, read_only
from dcf_zenoh.recording import StepRecord, log_name, open_log
from dcf_zenoh.requests import NEVER

log = logging.getLogger(__name__)
GOODBYE_TIMEOUT = 2.0  # s to wait for the neighbours' goodbyes
CLOCK_OFFSET_MAX = 0.02  # s between two machines on the wall clock


@dataclass(frozen=True)
class Assignment:
    """What a daemon has to know beside the fleet file.

    Attributes:
        agent: Which agent it is.
        run: Name of the run; part of all keys.
        folder: The run directory.
        endpoints: Where every agent listens.
        rejoin: The fleet is under way, and this agent was in it before.
        status: Where a launcher reads status lines, whose end closes standard input; None: nobody launched this one.
    """

    agent: int
    run: str
    folder: Path
    endpoints: dict[int, str]
    rejoin: bool = False
    status: TextIO | None = None


def fingerprint(fleet: LoadedFleet) -> str:
    """A short hash of all that must be the same at every agent: protocol, resolved fleet, plug-in files."""
    total = hashlib.sha256(f"{VERSION}\n{to_toml(fleet.spec)}".encode())
    plugins = fleet.folder / "plugins.json"
    if plugins.is_file():
        total.update(plugins.read_bytes())
    return total.hexdigest()[:16]


def run_agent(fleet: LoadedFleet, task: Assignment) -> Last:
    """Run one agent to its end.

    Raises:
        DcfError: Whatever ended it before its time.
    """
    blueprint = Blueprint.of(fleet)
    hood = blueprint.hood(task.agent)
    linked = sorted({*hood.receives_from, *hood.sends_to})
    address = Address(
        prefix=f"dcf/{fleet.spec.name}/{task.run}",
        listen=task.endpoints[task.agent],
        connect=endpoints_to_connect(task.agent, linked, task.endpoints),
        settings=fleet.spec.zenoh.settings,
    )
    life = last_life(task.folder, task.agent) if task.rejoin else None
    incarnation = life.incarnation if life else 0
    with (
        open_log(task.folder, task.agent, again=task.rejoin) as stream,
        Network(task.agent, hood, address) as network,
        _stop_events(network, supervised=task.status is not None),
    ):
        offsets = network.meet(fingerprint(fleet), fleet.spec.zenoh.ready_timeout, incarnation)
        if life and not network.start:
            raise NetworkError(f"agent {task.agent}: --rejoin: this fleet has not started yet")
        _check_offsets(task.agent, offsets, wall=fleet.spec.time.clock == "wall")
        about = {
            "run": task.run,
            "incarnation": incarnation,
            "clock_offsets": {j: (offset.ahead, offset.error) for j, offset in offsets.items()},
        }
        status = Status(task.agent, task.status) if task.status else None
        observe = status.observe if status else lambda _record: None
        parts = blueprint.build(task.agent, stream, about, observe, life)
        control = Control(task.agent, fleet, hood.receives_from, parts.links, parts.recorder)
        if life:
            control.restore(changes_in(read_log(task.folder, task.agent)))
        return _run(fleet, parts, network, hood.receives_from, offsets, control)


def last_life(folder: Path, agent: int) -> LastLife:
    """What an agent left behind in its log.

    Raises:
        RecordingError: There is no log, or no state in it.
    """
    log = read_log(folder, agent)
    if not len(log.state):
        raise RecordingError(f"{folder / log_name(agent)}: --rejoin: agent {agent} has not recorded a single step")
    half = log.state.shape[1] // 2
    return LastLife(log.lives, State(read_only(log.state[-1, :half]), read_only(log.state[-1, half:])))


def read_log(folder: Path, agent: int) -> AgentLog:
    """What an agent has recorded in its earlier lives.

    Raises:
        RecordingError: There is no log, or it cannot be read.
    """
    path = folder / log_name(agent)
    try:
        return AgentLog.read(path.read_bytes(), str(path))
    except OSError as error:
        raise RecordingError(f"{path}: --rejoin: cannot be read: {error.strerror}") from error


def _run(
    fleet: LoadedFleet,
    parts: AgentParts,
    network: Network,
    senders: tuple[int, ...],
    offsets: Mapping[int, ClockOffset],
    control: Control,
) -> Last:
    last = Last.FAILED
    try:
        with blaming(PlantError, f"agent {parts.id}: prepare"):
            parts.plant.prepare()
        spare_collector()
        if fleet.spec.time.clock == "wall":
            last = run_wall(parts, network, offsets, control.obey)
        else:
            last = run_virtual(parts, network, fleet.spec.zenoh.silence_timeout)
        await_goodbyes(parts, network, senders, GOODBYE_TIMEOUT)
        return last
    except BaseException as error:
        reason = "stopped" if isinstance(error, Stopped) else "failed"
        parts.recorder.end(reason, -1, State(), str(error), parts.exchange.counts)
        network.publish(parts.exchange.goodbye(NEVER, 0, Last.FAILED).message)
        raise
    finally:
        parts.plant.close()


def claim_stdout() -> TextIO:
    """Keep standard output for status lines; whatever else is printed, by plug-ins say, goes to standard error."""
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr  # which is not buffered: what is printed comes before the error that ends it all
    return stream


class Status:
    """Tells the launcher how the agent is doing: one JSON object per line.

    Args:
        agent: Id.
        stream: Read by the launcher.
    """

    def __init__(self, agent: int, stream: TextIO) -> None:
        self._agent = agent
        self._stream = stream
        self._late = 0

    def observe(self, record: StepRecord) -> None:
        """Report a finished step."""
        self._late += record.late
        half = len(record.state) // 2
        line = {
            "agent": self._agent,
            "step": record.step,
            "rounds": record.rounds,
            "late": self._late,
            "position": record.state[:half],
            "remark": record.remark,
        }
        try:
            print(json.dumps(line), file=self._stream, flush=True)
        except (BrokenPipeError, ValueError):
            self._stream = open(os.devnull, "w")  # noqa: SIM115, PTH123 - nobody reads; the log has it all


@contextmanager
def _stop_events(network: Network, *, supervised: bool) -> Iterator[None]:
    """Turn SIGINT, SIGTERM and the launcher's death into stop events while the body runs."""

    def on_signal(number: int, _frame: FrameType | None) -> None:
        network.notify(Stop(f"stopped by {signal.Signals(number).name}"))

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    if supervised:

        def watch() -> None:
            while os.read(0, 1024):  # the launcher writes nothing: this returns when it closes its end, or dies
                pass
            network.notify(Stop("stopped by the launcher's end"))

        threading.Thread(target=watch, name="launcher-watch", daemon=True).start()
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _check_offsets(agent: int, offsets: dict[int, ClockOffset], *, wall: bool) -> None:
    """Refuse to fly on clocks that disagree.

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
