"""Measures of a run as one row of numbers, and rows as a table and as CSV."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from dcf_zenoh.analysis.metrics import intrusions, overshoot, tracking_error
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.records.run import Run

MEASURED = (
    "clock", "arrival_time", "overshoot", "min_distance", "min_barrier", "min_clearance", "between_samples",
    "intrusions", "intrusion_time", "tracking_error", "rounds_median", "rounds_max", "negotiation_median_ms",
    "negotiation_max_ms", "deadline_misses", "agent_steps", "digest",
)  # fmt: skip


_CLOSEST = ("min_distance", "min_barrier")


def scores(run: Run | None) -> dict[str, Any]:
    """Return the `MEASURED` values of a run, in SI units unless the name says otherwise; None without a value."""
    if run is None:
        return dict.fromkeys(MEASURED)
    summary, inside = run.summary(), intrusions(run)
    values = (
        summary["clock"],
        summary["arrival_time"],
        overshoot(run),
        summary["min_distance"],
        summary["min_barrier"],
        summary["min_clearance"],
        summary["between_samples"],
        None if inside is None else inside.number,
        None if inside is None else inside.time,
        tracking_error(run),
        summary["rounds_per_step"]["median"],
        summary["rounds_per_step"]["max"],
        summary["negotiation_ms"]["median"],
        summary["negotiation_ms"]["max"],
        summary["deadline_misses"],
        sum(summary["ended_by"].values()),
        summary["digest"],
    )
    return dict(zip(MEASURED, values, strict=True))


def scores_table(title: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of `scores`, whose rows also have 'variant' and 'failed' (the reason, or None)."""
    if any(row["between_samples"] is False and row["min_distance"] is not None for row in rows):
        title += " (*: at the samples)"
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    heads = (
        "variant", "arrived\nat, s", "over-\nshoot, m", "closest\nm", "least\nh", "h < 0\ntimes", "\ns",
        "tracking\nerror, m", "rounds\nmedian", "\nmost", "negotiation\nmedian, ms", "\nmost", "deadlines\nmissed",
    )  # fmt: skip
    for head in heads:
        table.add_column(Text(head), justify="left" if head == "variant" else "right", no_wrap=head != "variant")
    for row in rows:
        table.add_row(*_cells(row))
    return table


def _cells(row: Mapping[str, Any]) -> list[str]:
    if row["failed"]:
        return [row["variant"], "failed"]
    forms = {
        "overshoot": ".3f",
        "min_distance": ".3f",
        "min_barrier": ".3f",
        "intrusions": "d",
        "intrusion_time": ".1f",
        "tracking_error": ".2g",
        "rounds_median": "g",
        "rounds_max": "g",
        "negotiation_median_ms": ".3g",
        "negotiation_max_ms": ".3g",
    }
    arrived = "not all" if row["arrival_time"] is None else f"{row['arrival_time']:.1f}"
    numbers = ["" if row[name] is None else format(row[name], form) for name, form in forms.items()]
    if row["between_samples"] is False and row["min_distance"] is not None:
        numbers = [f"{text}*" if name in _CLOSEST and text else text for name, text in zip(forms, numbers, strict=True)]
    return [row["variant"], arrived, *numbers, f"{row['deadline_misses']} of {row['agent_steps']}"]


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with the same keys; cells without a value are empty.

    Raises:
        RecordingError: The file cannot be written.
    """
    try:
        with path.open("w", encoding="utf-8", newline="") as stream:
            table = csv.DictWriter(stream, list(rows[0]))
            table.writeheader()
            table.writerows(rows)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
