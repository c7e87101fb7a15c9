"""What one agent recorded, as arrays."""

import gc
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.records.log_schema import Records, whose
from dcf_zenoh.records.writer import log_name
from dcf_zenoh.rounds.receiver import Passed
from dcf_zenoh.spec import FleetSpec

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class AgentLog:
    """What one agent recorded: K whole steps. Times in s of fleet time, arrays read-only.

    Attributes:
        agent: Id.
        header: First object of the log: versions, processor, schema.
        lives: How often the agent was started in this run.
        step: Step numbers, shape (K,).
        sensed: When the state was measured, shape (K,).
        state: Position and velocity, shape (K, 2 d), m and m/s.
        acted: When the setpoint went to the plant, shape (K,).
        setpoint: Position, velocity, acceleration, shape (K, 3 d); NaN for no acceleration (come to rest), and for a
            third component that a setpoint in the plane lacks.
        decision: The algorithm's decision, shape (K, n); NaN in steps without one.
        rounds: Rounds per step, shape (K,).
        residual: Own residual of the last round, shape (K,).
        stopped_by: What ended the rounds, K words; see `Outcome`.
        late: Whether the step overran, shape (K,).
        compute: Real time spent in the algorithm, s, shape (K,).
        links: Neighbour -> messages received, missing, late, lost by faults per step, shape (K, 4).
        passed: What links did to messages, in the order in which the agent took them in.
        notes: Per step what the controller counted.
        rounds_log: Per step the records of its rounds (`RoundRecord` as a tuple); empty without ``log.rounds``.
        remarks: K remarks.
        events: What happened at some instant: 'event', 'time' (ns), and more.
        end: How it ended: 'end' (reason), 'time' (ns), 'state', 'counts', 'remark', and 'unmet', what faults of the
            links to it were to act on and no message had; None if the log was cut off, or is damaged.
        damage: Where the log is damaged, in one line that names it; empty if it is not. Nothing after that is here.
    """

    agent: int
    header: Mapping[str, Any]
    lives: int
    step: Integers
    sensed: Array
    state: Array
    acted: Array
    setpoint: Array
    decision: Array
    rounds: Integers
    residual: Array
    stopped_by: tuple[str, ...]
    late: npt.NDArray[np.bool_]
    compute: Array
    links: Mapping[int, Integers]
    passed: tuple[Passed, ...]
    notes: tuple[Mapping[str, float], ...]
    rounds_log: tuple[list[Any], ...]
    remarks: tuple[str, ...]
    events: tuple[Mapping[str, Any], ...]
    end: Mapping[str, Any] | None
    damage: str = ""

    def rows(self, steps: int) -> Integers:
        """Row of the newest record at each of the first `steps` steps: that of the step, or where there is none (the
        agent was dead) of the last one before.
        """
        found: Integers = np.searchsorted(self.step, np.arange(steps), side="right") - 1
        return found.clip(0)

    @property
    def negotiation(self) -> Array:
        """Fleet time from sensing to acting, s, shape (K,): computation and waiting, the whole of steps 1 and 2."""
        return self.acted - self.sensed

    @property
    def landed(self) -> str:
        """Why the agent ended its flight before its time; empty if it did not."""
        return str(self.end["remark"]) if self.end and self.end["end"] == "landed" else ""

    @property
    def path(self) -> Array:
        """Positions, the last one included where the log ends with a state, shape (K or K+1, d), m."""
        last = [] if self.end is None else self.end["state"]  # empty too after a failure
        states = np.vstack((self.state, last)) if last and len(last) == self.state.shape[1] else self.state
        return states[:, : states.shape[1] // 2]

    @classmethod
    def load(cls, folder: Path, agent: int, fleet: FleetSpec) -> "AgentLog":
        """Read the log of `agent` in a run directory of `fleet`.

        Raises:
            RecordingError: It cannot be read, is no log, or is that of another agent, fleet or seed.
        """
        path = folder / log_name(agent)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
        return cls.read(data, str(path), (agent, fleet))

    @classmethod
    def read(cls, data: bytes, source: str, owner: tuple[int, FleetSpec] | None = None) -> "AgentLog":
        """Read a stream up to its last whole record, or to where it is damaged.

        Args:
            data: The stream.
            source: What errors call it.
            owner: The agent and the fleet that it must be of; None: any.

        Raises:
            RecordingError: It is no log, one of another schema, or not that of its owner.
        """
        with _collector_resting():
            try:
                found = Records.read(data, owner and owner[1])
            except RecordingError as error:
                raise RecordingError(f"{source}: {error}") from error
            if owner is not None:
                _check_owner(found.header, *owner, source)
            return cls._of(found, source)

    @classmethod
    def _of(cls, found: Records, source: str) -> "AgentLog":
        """The arrays of what was read."""
        steps = found.steps
        neighbours = sorted({link[0] for record in steps for link in record.links})
        counts = {j: np.zeros((len(steps), 4), dtype=np.int64) for j in neighbours}
        for row, record in enumerate(steps):
            for j, *numbers in record.links:
                counts[j][row] = numbers
        return cls(
            agent=found.header["agent"],
            header=found.header,
            lives=found.lives,
            step=np.array([r.step for r in steps], dtype=np.int64),
            sensed=read_only([r.sensed * 1e-9 for r in steps]),
            state=_table([r.state for r in steps]),
            acted=read_only([r.acted * 1e-9 for r in steps]),
            setpoint=_setpoints([r.setpoint for r in steps]),
            decision=_table([r.decision for r in steps]),
            rounds=np.array([r.rounds for r in steps], dtype=np.int64),
            residual=read_only([r.residual for r in steps]),
            stopped_by=tuple(r.stopped_by for r in steps),
            late=np.array([r.late for r in steps], dtype=np.bool_),
            compute=read_only([r.compute * 1e-9 for r in steps]),
            links=counts,
            passed=tuple(Passed._make(each) for r in steps for each in r.passed),
            notes=tuple(r.notes for r in steps),
            rounds_log=tuple(r.log for r in steps),
            remarks=tuple(r.remark for r in steps),
            events=tuple(found.events),
            end=found.end,
            damage=found.damage and f"{source}: {found.damage}",
        )


@contextmanager
def _collector_resting() -> Iterator[None]:
    """Without the garbage collector, which finds nothing in a log and takes longer than reading it."""
    active = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if active:
            gc.enable()


def has_log(folder: Path, agent: int) -> bool:
    """Whether a run directory has a log of `agent` with anything in it."""
    path = folder / log_name(agent)
    return path.is_file() and path.stat().st_size > 0


def _check_owner(header: Mapping[str, Any], agent: int, fleet: FleetSpec, source: str) -> None:
    """Refuse the log of another agent, fleet or seed.

    Raises:
        RecordingError: It is one.
    """
    expected = {"agent": agent, "fleet": fleet.name, "seed": fleet.seed}
    if any(header.get(name) != value for name, value in expected.items()):
        raise RecordingError(f"{source}: the log of {whose(header)}; expected {whose(expected)}")


def _table(rows: list[list[float]]) -> Array:
    """Rows of equal length as one array; empty ones, and missing ends, are NaN."""
    width = max(map(len, rows), default=0)
    table = np.full((len(rows), width), np.nan)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    table.setflags(write=False)
    return table


def _setpoints(rows: list[list[float]]) -> Array:
    """Rows of position, velocity and acceleration, some in the plane and some in space, as one array."""
    if not {6, 9} <= {len(row) for row in rows} <= {0, 6, 9}:
        return _table(rows)
    table = np.full((len(rows), 3, 3), np.nan)
    for parts, row in zip(table, rows, strict=True):
        parts[:, : len(row) // 3] = np.reshape(row, (3, len(row) // 3))
    return read_only(table.reshape(len(rows), 9))
