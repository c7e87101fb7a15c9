"""The table that a sweep prints: one row per variant."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

Rows = Sequence[Mapping[str, Any]]


def _by_variant(rows: Rows) -> dict[str, Rows]:
    """Return variant -> its rows, in the order of the first row of each variant."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(row["variant"], []).append(row)
    return {variant: tuple(each) for variant, each in found.items()}


def sweep_table(title: str, rows: Rows) -> Table:
    """Return a table with statistics over the seeds of each variant.

    Args:
        title: Title of the table.
        rows: Rows of the sweep, one per run.
    """
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    heads = (
        "variant", "runs", "failed", "arrived", "at, s\nmedian", "least h\nmedian", "\nleast", "rounds\nmedian",
        "gap\nmedian", "\nmost", "plan gap, mm\nmedian", "\nmost",
    )  # fmt: skip
    for head in heads:
        table.add_column(Text(head), justify="left" if head == "variant" else "right", no_wrap=head != "variant")
    for variant, each in _by_variant(rows).items():
        finished = [row for row in each if not row["failed"]]
        at = _values(finished, "arrival_time")
        millimetres = {
            name: [1e3 * value for value in _values(each, name)] for name in ("plan_gap_median", "plan_gap_max")
        }
        table.add_row(
            variant,
            str(len(each)),
            str(len(each) - len(finished)),
            f"{len(at)} of {len(finished)}",
            _number(at, ".1f"),
            _number(_values(each, "min_barrier"), ".3f"),
            _number(_values(each, "min_barrier"), ".3f", np.min),
            _number(_values(each, "rounds_median"), "g"),
            _number(_values(each, "gap_median"), ".2g"),
            _number(_values(each, "gap_max"), ".2g", np.max),
            _number(millimetres["plan_gap_median"], ".2g"),
            _number(millimetres["plan_gap_max"], ".2g", np.max),
        )
    return table


def _values(rows: Rows, name: str) -> list[float]:
    """Return the values of a column, without rows that have none."""
    return [float(row[name]) for row in rows if row[name] is not None]


def _number(values: Sequence[float], form: str, reduce: Any = np.median) -> str:
    return format(float(reduce(values)), form) if values else ""
