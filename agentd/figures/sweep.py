"""Measures of the runs of a sweep over the varied quantities, for many seeds."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from agentd.figures.style import GREY, RED, agent_style

Rows = Sequence[Mapping[str, Any]]
PANELS = {  # column -> label
    "arrived": "arrived, share of the seeds",
    "min_barrier": "least barrier value h",
    "rounds_median": "rounds per step, median",
    "gap_median": "gap to the central solution, median",
}


def sweep(rows: Rows, axes: Mapping[str, Sequence[str]]) -> Figure | None:
    """Draw a panel for each measure that has values, over the first quantity whose values are numbers.

    Lines are medians over the seeds; shades reach from the first to the third quartile. There is a line for each
    combination of the other quantities.

    Args:
        rows: Rows of the table; failed ones are left out.
        axes: Varied key -> values, in order.
    """
    finished = [row for row in rows if not row["failed"]]
    across = next((key for key, values in axes.items() if len(values) > 1 and all(map(_is_number, values))), None)
    if across is None or not finished:
        return None
    shown = [name for name in PANELS if any(_value(row, name) is not None for row in finished)]
    others = {key: values for key, values in axes.items() if key != across and len(values) > 1}
    figure = Figure(figsize=(4.6 * len(shown), 4.2), layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for panel, name in zip(panels, shown, strict=True):
        for place, chosen in enumerate(product(*others.values())):
            wanted = dict(zip(others, chosen, strict=True))
            of_line = [row for row in finished if wanted.items() <= row.items()]
            _line(panel, of_line, across, name, ", ".join(chosen) or "median", place)
        panel.set(xlabel=across, ylabel=PANELS[name])
        if name == "min_barrier":
            panel.axhline(0, color=RED, linewidth=1.2)
        elif name != "arrived":
            panel.set_ylim(bottom=0)
    handles, labels = panels[0].get_legend_handles_labels()
    if shown != ["arrived"]:
        handles.append(Patch(color=GREY, alpha=0.3, linewidth=0))
        labels.append("first to third quartile")
    title = f"{', '.join(others)}:" if others else None
    figure.legend(
        handles, labels, title=title, title_fontsize=9.5, loc="outside lower center", ncols=min(4, len(labels))
    )
    return figure


def _line(panel: Axes, rows: Rows, across: str, name: str, label: str, place: int) -> None:
    """Draw one line, with its interval."""
    points: dict[float, list[float]] = {}
    for row in rows:
        if (value := _value(row, name)) is not None:
            points.setdefault(float(row[across]), []).append(value)
    at = sorted(points)
    style = agent_style(place)
    if name == "arrived":
        panel.plot(at, [np.mean(points[x]) for x in at], marker="o", label=label, **style)
        panel.set_ylim(-0.03, 1.03)
        return
    low, middle, high = (np.array([np.percentile(points[x], share) for x in at]) for share in (25, 50, 75))
    panel.plot(at, middle, marker="o", label=label, **style)
    panel.fill_between(at, low, high, color=style["color"], alpha=0.15, linewidth=0)


def _value(row: Mapping[str, Any], name: str) -> float | None:
    if name == "arrived":
        return float(row["arrival_time"] is not None)
    return None if row[name] is None else float(row[name])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
