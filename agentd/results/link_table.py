"""Measurements of the links of a run, as a table and as an object for programs."""

from collections.abc import Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from dcf_zenoh.analysis.link_health import LinkHealth
from dcf_zenoh.records.run import Run


def title(run: Run, health: Sequence[LinkHealth]) -> str:
    """Return the title of the table."""
    return f"{run.fleet.name}, {run.name}: {len(health)} links, {run.fleet.time.clock} clock"


def links_table(health: Sequence[LinkHealth]) -> Table:
    """Return a table of measurements, a row for each link; empty columns are left out."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns: list[tuple[str, list[str], bool]] = [
        ("link", [f"{each.sender} → {each.receiver}" for each in health], True),
        ("messages", [str(each.sent) for each in health], True),
        ("lost", [f"{100 * each.loss:.1f} %" for each in health], True),
        ("lost by", [_causes(each) for each in health], any(each.lost for each in health)),
        ("in a\nrow", [f"{each.mean_burst:.2f}" for each in health], any(each.lost for each in health)),
        ("late", [str(each.late) for each in health], any(each.late for each in health)),
        ("missing", [str(each.missing) for each in health], any(each.missing for each in health)),
        ("copies", [str(each.duplicates) for each in health], any(each.duplicates for each in health)),
        *(
            (f"{head}\nms", [_ms(each.latency(p)) for each in health], any(each.latencies.size for each in health))
            for head, p in (("latency\n50 %", 0.5), ("\n95 %", 0.95), ("\n99 %", 0.99), ("\nmost", 1.0))
        ),
        ("longest\ngap, s", [_seconds(each.longest_gap) for each in health], any(each.recorded for each in health)),
        ("clock of sender\nahead, ms", [_clock(each) for each in health], any(each.clock_error for each in health)),
    ]
    shown = [(head, cells) for head, cells, wanted in columns if wanted]
    for head, _ in shown:
        table.add_column(Text(head), justify="left" if head in ("link", "lost by") else "right", no_wrap=True)
    for row in zip(*(cells for _, cells in shown), strict=True):
        table.add_row(*row)
    return table


def remark(run: Run, health: Sequence[LinkHealth]) -> str:
    """Return a remark on how to read the numbers; empty if none is needed."""
    if run.fleet.time.clock == "wall":
        return (
            "A message is there when the receiver's loop has read it: latencies include waiting for the loop, and those"
            " of messages that it found when it woke up for a control step are left out. They are corrected for clocks"
            " that are further ahead than the error of that number."
        )
    if not any(each.recorded for each in health):
        return "Links without faults lose and delay nothing in virtual time: messages are only counted."
    if bare := [f"{each.sender} → {each.receiver}" for each in health if not each.recorded]:
        return f"Without faults, and therefore only counted: {', '.join(bare)}."
    return ""


def links_object(run: Run, health: Sequence[LinkHealth]) -> dict[str, Any]:
    """Return the measurements for programs. Times are in s; None where they are not known."""
    return {
        "fleet": run.fleet.name,
        "run": run.name,
        "clock": run.fleet.time.clock,
        "links": [
            {
                "from": each.sender,
                "to": each.receiver,
                "recorded": each.recorded,
                "messages": each.sent,
                "lost": sum(each.lost.values()),
                "loss": each.loss,
                "lost_by": dict(each.lost),
                "mean_burst": each.mean_burst,
                "late": each.late,
                "missing": each.missing,
                "duplicates": each.duplicates,
                "latency": {
                    name: each.latency(p) for name, p in (("median", 0.5), ("p95", 0.95), ("p99", 0.99), ("max", 1.0))
                },
                "longest_gap": each.longest_gap,
                "clock_ahead": each.clock_ahead,
                "clock_error": each.clock_error,
            }
            for each in health
        ],
    }


def _causes(health: LinkHealth) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in health.lost.items())


def _ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds * 1e3:.2f}"


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _clock(health: LinkHealth) -> str:
    if health.clock_ahead is None or health.clock_error is None:
        return ""
    return f"{health.clock_ahead * 1e3:+.2f} ± {health.clock_error * 1e3:.2f}"
