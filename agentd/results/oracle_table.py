"""Table of the comparison with the central solution."""

from collections import Counter
from typing import Any

from rich import box
from rich.table import Table

from dcf_zenoh.analysis.oracle import Oracle
from dcf_zenoh.records.run import Run


def oracle_table(run: Run, found: Oracle) -> Table:
    """Return a table of the numbers of a run, and the reasons for steps without numbers."""
    table = Table(title=f"{run.name}: beside the central solution", title_justify="left", show_header=False,
                  box=box.SIMPLE_HEAD)  # fmt: skip
    table.add_column(style="bold")
    table.add_column()
    summary = found.summary()
    compared = summary["steps"] - summary["unsolved"]
    table.add_row("steps compared", f"{compared} of {summary['steps']}")
    if compared:
        table.add_row("decision to central one", _spread(summary["gap"], 1.0, ""))
    if summary["plan_gap"]["max"] is not None:
        table.add_row("plan to central plan", _spread(summary["plan_gap"], 1e3, " mm"))
    if summary["violation"] is not None:
        table.add_row("constraint violation", f"at most {summary['violation']:.3g}")
    table.add_row("residual at the stop", _spread(summary["residual"], 1.0, ""))
    for why, count in Counter(found.unsolved.values()).most_common():
        table.add_row("no central solution", f"in {count} steps: {why}")
    return table


def _spread(values: dict[str, Any], factor: float, unit: str) -> str:
    if values["median"] is None:
        return "none"
    median, most, maximum = (f"{factor * values[key]:.3g}{unit}" for key in ("median", "p95", "max"))
    return f"median {median}, 95 % below {most}, at most {maximum}"
