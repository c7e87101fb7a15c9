"""Log of one agent, as arrays."""

import gc
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.records.log_schema import Records, owner_of
from dcf_zenoh.records.log_writer import log_name
from dcf_zenoh.rounds.receiver import Passed
from dcf_zenoh.spec import FleetSpec

Integers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class AgentLog:
    """Log of one agent: K complete steps. Times are fleet time in s; arrays are read-only.

    Attributes:
        agent: Id.
        header: First object of the log: versions, processor, schema.
        lives: Number of times that the agent was started in this run.
        step: Step numbers, shape (K,).
        sensed: Instants of the measurements, shape (K,).
        state: Position and velocity, shape (K, 2 d), m and m/s.
        acted: Instants at which the setpoints went to the plant, shape (K,).
        setpoint: Position, velocity, acceleration, shape (K, 3 d); NaN for no acceleration (the body comes to rest),
            and for the third components of a setpoint in the plane.
        decision: The algorithm's decision, shape (K, n); NaN in steps without one.
        rounds: Rounds per step, shape (K,).
        residual: The agent's residual of the last round, shape (K,).
        stopped_by: Reasons for the end of the rounds, K words; see `Outcome`.
        late: Whether the step overran, shape (K,).
        compute: Real time spent in the algorithm, s, shape (K,).
        links: Neighbour -> messages received, missing, late, lost by faults per step, shape (K, 4).
        passed: Effects of links on messages, in the order in which the agent consumed them.
        notes: Counts of the controller per step.
        rounds_log: Records of the rounds of each step (`RoundRecord` as a tuple); empty without ``log.rounds``.
        remarks: K remarks.
        events: Events between the steps: 'event', 'time' (ns), and more.
        end: End of the log: 'end' (reason), 'time' (ns), 'state', 'counts', 'remark', and 'unmet', the parts of
            payloads on which faults of the links to this agent should have acted and that no message had; None if the
            log was cut off in its last life, or is damaged.
        earlier: Last step and end of each earlier life; no end of a life that broke off.
        damage: Source, place and kind of the damage, in one line; empty if there is none. What follows is left out.
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
    earlier: tuple[tuple[int, Mapping[str, Any] | None], ...] = ()
    damage: str = ""

    def rows(self, steps: int) -> Integers:
        """Return the row of the newest record at each of the first `steps` steps, shape (steps,).

        That is the record of the step, or of the last one before where the agent was down.
        """
        found: Integers = np.searchsorted(self.step, np.arange(steps), side="right") - 1
        return found.clip(0)

    @property
    def negotiation(self) -> Array:
        """Fleet time from sensing to acting, s, shape (K,): all computation and waiting in a step."""
        return self.acted - self.sensed

    @property
    def counts(self) -> Mapping[str, int]:
        """Counts of all lives together, as far as they have an end."""
        ends = [end for _, end in self.earlier] + [self.end]
        total: Counter[str] = Counter()
        for end in ends:
            total.update(end["counts"] if end else {})
        return total

    @property
    def landed(self) -> str:
        """Reason for which the agent landed before the end of the run; empty if it did not."""
        return str(self.end["remark"]) if self.end and self.end["end"] == "landed" else ""

    @property
    def path(self) -> Array:
        """Positions, including that of the end if the log has one, shape (K or K+1, d), m."""
        last = [] if self.end is None else self.end["state"]  # empty too after a failure
        states = np.vstack((self.state, last)) if last and len(last) == self.state.shape[1] else self.state
        return states[:, : states.shape[1] // 2]

    @classmethod
    def load(cls, folder: Path, agent: int, fleet: FleetSpec) -> "AgentLog":
        """Read the log of `agent` in a run directory of `fleet`.

        Raises:
            RecordingError: It cannot be read, is no log, or is the log of another agent, fleet or seed.
        """
        path = folder / log_name(agent)
        try:
            data = path.read_bytes()
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
        return cls.read(data, str(path), (agent, fleet))

    @classmethod
    def read(cls, data: bytes, source: str, owner: tuple[int, FleetSpec] | None = None) -> "AgentLog":
        """Read a stream up to its last complete record, or to its first damage.

        Args:
            data: The stream.
            source: Name of the stream in errors.
            owner: Agent and fleet that the log must belong to; None: any.

        Raises:
            RecordingError: It is no log, has another schema, or belongs to another owner.
        """
        with _garbage_collection_paused():
            try:
                found = Records.read(data, owner and owner[1])
            except RecordingError as error:
                raise RecordingError(f"{source}: {error}") from error
            if owner is not None:
                _check_owner(found.header, *owner, source)
            return cls._of(found, source)

    @classmethod
    def _of(cls, found: Records, source: str) -> "AgentLog":
        """Return the log as arrays."""
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
            earlier=tuple(found.earlier),
            damage=found.damage and f"{source}: {found.damage}",
        )


@contextmanager
def _garbage_collection_paused() -> Iterator[None]:
    """Pause the garbage collector, which finds nothing in a log: reading ten agents takes 2.9 s instead of 4.7 s."""
    active = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if active:
            gc.enable()


def has_log(folder: Path, agent: int) -> bool:
    """Return whether a run directory has a log of `agent` that is not empty."""
    path = folder / log_name(agent)
    return path.is_file() and path.stat().st_size > 0


def _check_owner(header: Mapping[str, Any], agent: int, fleet: FleetSpec, source: str) -> None:
    """Check that a header belongs to the agent, the fleet and its seed.

    Raises:
        RecordingError: It does not.
    """
    expected = {"agent": agent, "fleet": fleet.name, "seed": fleet.seed}
    if any(header.get(name) != value for name, value in expected.items()):
        raise RecordingError(f"{source}: the log of {owner_of(header)}; expected {owner_of(expected)}")


def _table(rows: list[list[float]]) -> Array:
    """Return rows as one array; empty rows, and missing ends of shorter ones, are NaN."""
    width = max(map(len, rows), default=0)
    table = np.full((len(rows), width), np.nan)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    table.setflags(write=False)
    return table


def _setpoints(rows: list[list[float]]) -> Array:
    """Return rows of position, velocity and acceleration, some in the plane and some in space, as one array."""
    if not {6, 9} <= {len(row) for row in rows} <= {0, 6, 9}:
        return _table(rows)
    table = np.full((len(rows), 3, 3), np.nan)
    for parts, row in zip(table, rows, strict=True):
        parts[:, : len(row) // 3] = np.reshape(row, (3, len(row) // 3))
    return read_only(table.reshape(len(rows), 9))
