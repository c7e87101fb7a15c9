"""What one agent recorded, as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.reception import Passed
from dcf_zenoh.recording import SCHEMA, StepRecord, read_stream

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
        rounds_log: Per step the records of its rounds (`RoundRecord` as a list); empty without ``log.rounds``.
        remarks: K remarks.
        events: What happened at some instant: 'event', 'time' (ns), and more.
        end: How it ended: 'end' (reason), 'time' (ns), 'state', 'counts', 'remark', and 'unmet', what faults of the
            links to it were to act on and no message had; None if the log was cut off.
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
    def read(cls, data: bytes, source: str) -> "AgentLog":
        """Read a stream up to its last whole record.

        Raises:
            RecordingError: It is no log, or one of another schema.
        """
        items = list(read_stream(data))
        if not items or not isinstance(items[0], dict) or "schema" not in items[0]:
            raise RecordingError(f"{source}: not a log of an agent: it has no header")
        header = items[0]
        if header["schema"] != SCHEMA:
            raise RecordingError(f"{source}: log schema {header['schema']}; this version reads {SCHEMA}")
        steps = [StepRecord(*item) for item in items[1:] if isinstance(item, list)]
        others = [item for item in items[1:] if isinstance(item, dict)]
        ends = [item for item in others if "end" in item]
        neighbours = sorted({link[0] for record in steps for link in record.links})
        counts = {j: np.zeros((len(steps), 4), dtype=np.int64) for j in neighbours}
        for row, record in enumerate(steps):
            for j, *numbers in record.links:
                counts[j][row] = numbers
        return cls(
            agent=header["agent"],
            header=header,
            lives=sum("schema" in item for item in items if isinstance(item, dict)),
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
            passed=tuple(Passed(*each) for r in steps for each in r.passed),
            notes=tuple(r.notes for r in steps),
            rounds_log=tuple(r.log for r in steps),
            remarks=tuple(r.remark for r in steps),
            events=tuple(item for item in others if "event" in item),
            end=ends[-1] if ends else None,
        )


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
