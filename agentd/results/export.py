"""Export of a run as a file for other programs."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from dcf_zenoh.diagnostics import listed, nearest
from dcf_zenoh.errors import ConfigurationError, RecordingError
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import Run
from dcf_zenoh.rounds.dialogue import RoundRecord

_MESSAGES = ("messages_received", "messages_missing", "messages_late", "messages_lost")
_AXES = "xyz"
DECIMALS = 12  # of s, m and m/s in a csv


def export(run: Run, fmt: str, out: Path | None = None) -> Path:
    """Write a run into a new file; of a run with ``log.rounds`` the rounds, too.

    ========  ==========================================================================================
    ``csv``   One row per agent and step, columns named with their units where these are not SI; empty where an
              agent does not have the quantity, ``nan`` for NaN. Times, positions and velocities have 12 decimals.
              Rounds are in a second file, ``<out>_rounds.csv``, one row per agent, step and round.
    ``npz``   Arrays ``agent_<id>_<quantity>`` and ``agents``, ``sample_time``; loads without pickle.
    ``mat``   For MATLAB: a struct ``agent_<id>`` per agent, and ``agents``, ``sample_time``, ``fleet``, ``run``.
    ========  ==========================================================================================

    The quantities are those of `AgentLog`; ``links_<id>`` holds received, missing and late messages. Arrays of rounds
    have one row per round of any step: ``round_step``, ``round_number``, ``round_residual``, and
    ``round_payload_<name>`` with the entries of payloads that are numbers, flattened; NaN where a payload has no such
    entry, or a shorter one.

    Args:
        run: The run.
        fmt: ``csv``, ``npz`` or ``mat``.
        out: New file. None: the run's name, in the working directory.

    Returns:
        The file written.

    Raises:
        ConfigurationError: There is no such format.
        RecordingError: `out` exists, or cannot be written.
    """
    writers = {"csv": _csv, "npz": _npz, "mat": _mat}
    has_rounds = any(any(log.rounds_log) for log in run.agents.values())
    if fmt not in writers:
        raise ConfigurationError(f"unknown format {fmt!r}{nearest(fmt, writers)} known: {listed(writers)}")
    first = Path(f"{run.name}.{fmt}") if out is None else out
    try:
        with first.open("xb") as stream:
            writers[fmt](run, stream)
        if fmt == "csv" and has_rounds:
            second = first.with_name(f"{first.stem}_rounds.csv")
            with second.open("xb") as stream:
                _csv_of_rounds(run, stream)
    except FileExistsError as error:
        raise RecordingError(f"{error.filename}: is there already; choose another file with --out") from None
    except OSError as error:
        raise RecordingError(f"{error.filename or first}: cannot be written: {error.strerror}") from error
    return first


def _csv(run: Run, stream: BinaryIO) -> None:
    _write_rows([row for log in run.agents.values() for row in _steps(log)], stream)


def _csv_of_rounds(run: Run, stream: BinaryIO) -> None:
    rows = []
    for log in run.agents.values():
        arrays = _rounds(log)
        names = {"round_step": "step", "round_number": "round", "round_residual": "residual"}
        columns: dict[str, Sequence[object]] = {}
        for name, array in arrays.items():
            if name in names:
                columns[names[name]] = array.tolist()
            else:
                entry = name.removeprefix("round_payload_")
                columns.update({f"{entry}_{n}": array[:, n].tolist() for n in range(array.shape[1])})
        for values in zip(*columns.values(), strict=True):
            rows.append({"agent": log.agent, **dict(zip(columns, values, strict=True))})
    _write_rows(rows, stream)


def _rounds(log: AgentLog) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of the rounds of one agent; none without ``log.rounds``."""
    records = [
        (int(step), number, RoundRecord(*record))
        for step, rounds in zip(log.step, log.rounds_log, strict=True)
        for number, record in enumerate(rounds)
    ]
    if not records:
        return {}
    arrays: dict[str, npt.NDArray[Any]] = {
        "round_step": np.array([step for step, _, _ in records], dtype=np.int64),
        "round_number": np.array([number for _, number, _ in records], dtype=np.int64),
        "round_residual": np.array([record.residual for _, _, record in records]),
    }
    payloads = [{str(name): _numbers(value) for name, value in record.payload.items()} for _, _, record in records]
    for name in dict.fromkeys(name for payload in payloads for name in payload):
        width = max(payload[name].size for payload in payloads if name in payload)
        table = np.full((len(records), width), np.nan)
        for row, payload in zip(table, payloads, strict=True):
            values = payload.get(name, np.empty(0))
            row[: values.size] = values
        if width:
            arrays[f"round_payload_{name}"] = table
    return arrays


def _numbers(value: Any) -> npt.NDArray[np.float64]:
    """Return an entry of a payload as numbers; none if it has others."""
    try:
        return np.asarray(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return np.empty(0)


def _write_rows(rows: Sequence[Mapping[str, object]], stream: BinaryIO) -> None:
    """Write rows as CSV; columns that a row does not have are empty in it."""
    widest: Mapping[str, object] = max(rows, key=len, default={})  # first the columns of the widest row, in its order
    names = dict.fromkeys([*widest, *(name for row in rows for name in row)])
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
    table = csv.DictWriter(text, list(names))
    table.writeheader()
    table.writerows(rows)
    text.detach()


def _steps(log: AgentLog) -> Iterator[dict[str, object]]:
    """Yield the rows of one agent."""
    d = log.state.shape[1] // 2
    state = _names(("p", "v"), d, log.state.shape[1], "state")
    setpoint = _names(("p_set_", "v_set_", "a"), d, log.setpoint.shape[1], "setpoint")
    decision = [f"decision_{n}" for n in range(log.decision.shape[1])]
    links = sum(log.links.values(), np.zeros((len(log.step), 4), dtype=np.int64))
    for k, step in enumerate(log.step.tolist()):
        yield {
            "agent": log.agent,
            "step": step,
            "sensed_s": _rounded(log.sensed[k].item()),
            **dict(zip(state, map(_rounded, log.state[k].tolist()), strict=True)),
            "acted_s": _rounded(log.acted[k].item()),
            **dict(zip(setpoint, map(_rounded, log.setpoint[k].tolist()), strict=True)),
            **dict(zip(decision, log.decision[k].tolist(), strict=True)),
            "rounds": log.rounds[k].item(),
            "residual": log.residual[k].item(),
            "stopped_by": log.stopped_by[k],
            "late": int(log.late[k]),
            "compute_s": _rounded(log.compute[k].item()),
            "negotiation_s": _rounded(log.negotiation[k].item()),
            **dict(zip(_MESSAGES, links[k].tolist(), strict=True)),
            "remark": log.remarks[k],
        }


def _rounded(value: float) -> float:
    """Return a time, length or velocity without what binary fractions leave: 15.2 for 15.200000000000001."""
    return round(value, DECIMALS) + 0.0  # no negative zero


def _names(stems: tuple[str, ...], dimensions: int, width: int, otherwise: str) -> list[str]:
    """Return names such as ``px, py, vx, vy``; numbered ones if the width is not that of positions in space."""
    if width == len(stems) * dimensions <= len(stems) * len(_AXES):
        return [stem + axis for stem in stems for axis in _AXES[:dimensions]]
    return [f"{otherwise}_{n}" for n in range(width)]


def _quantities(log: AgentLog) -> dict[str, npt.NDArray[Any]]:
    """Return all arrays of one agent, by name."""
    names = ("step", "sensed", "state", "acted", "setpoint", "decision", "rounds", "residual", "late", "compute",
             "negotiation", "path")  # fmt: skip
    arrays: dict[str, npt.NDArray[Any]] = {name: getattr(log, name) for name in names}
    words = {"stopped_by": np.array(log.stopped_by, dtype=np.str_), "remarks": np.array(log.remarks, dtype=np.str_)}
    return {**arrays, **words, **{f"links_{j}": counts for j, counts in log.links.items()}, **_rounds(log)}


def _common(run: Run) -> dict[str, Any]:
    return {"agents": np.array(list(run.agents), dtype=np.int64), "sample_time": run.fleet.time.sample_time}


def _npz(run: Run, stream: BinaryIO) -> None:
    arrays: dict[str, Any] = {
        f"agent_{agent}_{name}": array for agent, log in run.agents.items() for name, array in _quantities(log).items()
    }
    np.savez_compressed(stream, **_common(run), **arrays)


def _mat(run: Run, stream: BinaryIO) -> None:
    from scipy.io import savemat  # noqa: PLC0415  # slow to import, and only needed here

    structs = {
        f"agent_{agent}": {
            name: array.astype(object) if array.dtype.kind == "U" else array  # words: a cell array
            for name, array in _quantities(log).items()
        }
        for agent, log in run.agents.items()
    }
    content = {**_common(run), "fleet": run.fleet.name, "run": run.name, **structs}
    savemat(stream, content, oned_as="column", do_compression=True)
