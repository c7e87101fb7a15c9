"""The log of an agent: an append-only msgpack stream, and its reader.

The first object of a stream is the header, a map; then one array per control step, in the order of `StepRecord`'s
fields; in between maps for events (an agent crashes, a fault is changed); last a map, the end. After a restart all of
this follows again. After every object comes its checksum, the CRC-32 of its bytes as an integer; streams of schema 3
have none. A stream that was cut off anywhere is read up to its last complete object. A run directory holds one stream
per agent, ``fleet.toml`` (the resolved fleet), ``run.json`` and copies of plug-in files.
"""

import platform
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

import msgpack
import numpy as np

from dcf_zenoh.controllers.controller import Decision
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.plant import Setpoint, State
from dcf_zenoh.rounds.exchange import Outcome
from dcf_zenoh.rounds.receiver import LinkCount, Note

SCHEMA = 4
SCHEMAS = (3, 4)  # that can be read
_NONE: Mapping[int, LinkCount] = MappingProxyType({})


def log_name(agent: int) -> str:
    """Return the file name of an agent's stream."""
    return f"agent-{agent}.msgpack"


class StepRecord(NamedTuple):
    """One control step of one agent. Times in ns; fleet time unless said otherwise.

    Attributes:
        step: Control step k.
        sensed: Instant of the measurement.
        state: Position and velocity, m and m/s.
        acted: Instant at which the setpoint went to the plant: the end of the negotiation, or a planned later one.
        setpoint: Position, velocity, acceleration as flown; NaN for no acceleration (the body comes to rest).
        decision: The algorithm's decision.
        rounds: Communication rounds.
        residual: The agent's own residual in the last round.
        stopped_by: Reason for the end of the rounds; see `Outcome`, or 'abstained'.
        late: Whether the step overran: then `exchange.late` of the fleet file decides the setpoint, not the decision.
        compute: Real time spent in the algorithm.
        links: Per neighbour: id, received, missing, late, lost.
        passed: Effects of links on messages: sender, sequence, step, round, entered, due (-1: lost), lost_by.
        notes: Counts of the controller.
        log: Per round, with ``log.rounds``: payload, residual, times of receipt, notes; see `RoundRecord`.
        remark: Further remark.
    """

    step: int
    sensed: int
    state: list[float]
    acted: int
    setpoint: list[float]
    decision: list[float]
    rounds: int
    residual: float
    stopped_by: str
    late: bool
    compute: int
    links: list[tuple[int, int, int, int, int]]
    passed: list[Note]
    notes: Mapping[str, float]
    log: list[Any]
    remark: str = ""

    @classmethod
    def of(
        cls,
        step: int,
        sensed: int,
        state: State,
        acted: int,
        setpoint: Setpoint,
        outcome: Outcome[Decision],
        *,
        late: bool,
        remark: str = "",
    ) -> "StepRecord":
        """Return the record of a step that was negotiated."""
        return cls(
            step=step,
            sensed=sensed,
            state=state.vector.tolist(),
            acted=acted,
            setpoint=setpoint.vector.tolist(),
            decision=outcome.result.value.ravel().tolist(),
            rounds=outcome.rounds,
            residual=outcome.residual,
            stopped_by=outcome.stopped_by,
            late=late,
            compute=outcome.compute,
            links=_counts(outcome.links),
            passed=outcome.passed,
            notes=outcome.result.notes,
            log=list(outcome.log),
            remark=remark,
        )

    @classmethod
    def abstained(
        cls,
        step: int,
        sensed: int,
        state: State,
        setpoint: Setpoint,
        remark: str,
        links: Mapping[int, LinkCount] = _NONE,
        passed: Sequence[Note] = (),
    ) -> "StepRecord":
        """Return the record of a step in which the agent took no part, or only at first, with the messages so far."""
        return cls(
            step, sensed, state.vector.tolist(), sensed, setpoint.vector.tolist(), [], 0, float("inf"), "abstained",
            False, 0, _counts(links), list(passed), {}, [], remark,
        )  # fmt: skip


def _counts(links: Mapping[int, LinkCount]) -> list[tuple[int, int, int, int, int]]:
    return [(j, link.received, link.missing, link.late, link.lost) for j, link in links.items()]


def packed(item: object) -> bytes:
    """Return an object of a stream and its checksum as bytes."""
    data: bytes = msgpack.packb(item, default=_plain)
    checksum: bytes = msgpack.packb(zlib.crc32(data))
    return data + checksum


def _plain(value: object) -> object:
    """Return arrays and numpy numbers as lists and numbers, for msgpack."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"cannot record {type(value).__name__} {value!r:.60}")


class Recorder:
    """Writer of one agent's stream; every object goes to the operating system at once.

    Args:
        stream: Open for writing bytes, unbuffered.
        agent: Id.
        about: Further entries of the header: fleet, run, seed, clock.
        observe: Called with every record once it is written.
    """

    def __init__(
        self,
        stream: BinaryIO,
        agent: int,
        about: Mapping[str, Any],
        observe: Callable[[StepRecord], None] = lambda _record: None,
    ) -> None:
        self._stream = stream
        self._observe = observe
        packages = ("dcf-zenoh", "numpy", "eclipse-zenoh", "msgpack", "osqp", "scipy")
        self._write(
            {
                "schema": SCHEMA,
                "agent": agent,
                **about,
                "started": datetime.now(UTC).isoformat(),
                "python": platform.python_version(),
                "versions": {name: version(name) for name in packages},
                "processor": f"{platform.machine()} {platform.processor()}".strip(),
                "system": platform.platform(),
                "fields": StepRecord._fields,
            }
        )

    def step(self, record: StepRecord) -> None:
        """Append one control step."""
        self._write(record)
        self._observe(record)

    def event(self, what: str, now: int, **about: Any) -> None:
        """Append an event at `now`, fleet time in ns."""
        self._write({"event": what, "time": now, **about})

    def end(
        self,
        reason: str,
        now: int,
        state: State,
        remark: str = "",
        counts: Mapping[str, int] | None = None,
        unmet: Sequence[tuple[int, str, str]] = (),
    ) -> None:
        """Append the end: its reason, the fleet time in ns, the last state, and the counts of `Exchange`."""
        self._write(
            {
                "end": reason,
                "time": now,
                "state": state.vector.tolist(),
                "remark": remark,
                "counts": dict(counts or {}),
                "unmet": unmet,
            }
        )

    def _write(self, item: object) -> None:
        try:
            left = memoryview(packed(item))
            while left:  # an unbuffered stream may take less than all
                left = left[self._stream.write(left) :]
        except OSError as error:
            raise RecordingError(f"cannot write the log: {error}") from error


def read_stream(data: bytes) -> Iterator[tuple[Any, int]]:
    """Yield the complete objects of a stream, each with the position of its end, up to where the stream was cut off.

    Checksums are compared, and not yielded; the position is that of their end.

    Raises:
        ValueError: The stream is damaged: what follows is no object, or its checksum is another.
    """
    longest = max(len(data), 1 << 20)  # a length beyond that is refused before memory is taken for it
    unpacker = msgpack.Unpacker(max_buffer_size=longest, strict_map_key=False)
    unpacker.feed(data)
    begin, checked = 0, False
    while True:
        try:
            item = unpacker.unpack()
            if isinstance(item, dict) and "schema" in item:  # a header; a later life may be of a newer version
                checked = item["schema"] == SCHEMA
            if checked:
                checksum = zlib.crc32(memoryview(data)[begin : unpacker.tell()])
                if (found := unpacker.unpack()) != checksum or type(found) is not int:
                    raise ValueError("its checksum is wrong")
        except msgpack.OutOfData:
            return
        except (TypeError, OverflowError, msgpack.UnpackException) as error:  # keys that are lists; bad time stamps
            raise ValueError(f"not msgpack: {error}") from error
        begin = unpacker.tell()
        yield item, begin


def length_of_complete(data: bytes) -> int:
    """Return the number of bytes of a stream that its complete objects take."""
    end = 0
    try:
        for item, after in read_stream(data):
            if not isinstance(item, list | dict):  # zeros after a loss of power
                break
            end = after
    except ValueError:
        pass
    return end


def open_log(directory: Path, agent: int, *, again: bool = False) -> BinaryIO:
    """Open a new stream in a run directory; with `again` continue an existing one after its last complete object.

    A log without a control step is that of a start that failed. It does not block the next start: a new stream takes
    its place, and it is kept as ``agent-<id>.msgpack.not-started-<n>`` unless it is empty.

    Raises:
        RecordingError: It cannot be written, or it exists; with `again`: it does not exist.
    """
    path = directory / log_name(agent)
    try:
        if again:
            stream = path.open("r+b", buffering=0)
            stream.truncate(stream.seek(length_of_complete(path.read_bytes())))
            return stream
        directory.mkdir(parents=True, exist_ok=True)
        check_unused(directory, agent)
        if path.is_file() and path.stat().st_size:
            path.rename(next(free for n in count(1) if not (free := Path(f"{path}.not-started-{n}")).exists()))
        return path.open("wb" if path.is_file() else "xb", buffering=0)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


def check_unused(directory: Path, agent: int) -> None:
    """Raise an error if the agent has flown in this run directory before; a start that failed is no flight.

    Raises:
        RecordingError: The log of the agent has control steps, is damaged, or cannot be read.
    """
    path = directory / log_name(agent)
    try:
        data = path.read_bytes() if path.exists() else b""
        flown = any(isinstance(item, list) for item, _ in read_stream(data))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError:
        flown = True
    if flown:
        raise RecordingError(f"{path}: there is a log already; choose another directory with --out")
