"""The rows of a sweep, put together variant by variant."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

Rows = Sequence[Mapping[str, Any]]


def by_variant(rows: Rows) -> dict[str, Rows]:
    """Variant -> its rows, in the order in which variants come first."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(row["variant"], []).append(row)
    return {variant: tuple(each) for variant, each in found.items()}


def known(rows: Rows, name: str) -> list[float]:
    """The values of a column that there are."""
    return [float(row[name]) for row in rows if row[name] is not None]


def sweep_table(title: str, rows: Rows) -> Table:
    """A row for every variant: medians over its seeds."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    heads = (
        "variant", "runs", "failed", "arrived", "at, s\nmedian", "least h\nmedian", "\nleast", "rounds\nmedian",
        "gap\nmedian", "\nmost", "plan gap, mm\nmedian", "\nmost",
    )  # fmt: skip
    for head in heads:
        table.add_column(Text(head), justify="left" if head == "variant" else "right", no_wrap=head != "variant")
    for variant, each in by_variant(rows).items():
        finished = [row for row in each if not row["failed"]]
        at = known(finished, "arrival_time")
        millimetres = {
            name: [1e3 * value for value in known(each, name)] for name in ("plan_gap_median", "plan_gap_max")
        }
        table.add_row(
            variant,
            str(len(each)),
            str(len(each) - len(finished)),
            f"{len(at)} of {len(finished)}",
            _number(at, ".1f"),
            _number(known(each, "min_barrier"), ".3f"),
            _number(known(each, "min_barrier"), ".3f", np.min),
            _number(known(each, "rounds_median"), "g"),
            _number(known(each, "gap_median"), ".2g"),
            _number(known(each, "gap_max"), ".2g", np.max),
            _number(millimetres["plan_gap_median"], ".2g"),
            _number(millimetres["plan_gap_max"], ".2g", np.max),
        )
    return table


def _number(values: Sequence[float], form: str, of: Any = np.median) -> str:
    return format(float(of(values)), form) if values else ""
