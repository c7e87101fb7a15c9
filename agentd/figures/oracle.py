"""Distance of the decisions from those of a central solver, and the residual at which they stopped."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agentd.figures.style import GREY, INK, RED, agent_style, heading
from dcf_zenoh.analysis.oracle import Oracle
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run

_FEW = 12  # agents up to which there is a legend
_LEAST = 1e-9  # smaller values are drawn here: the accuracy of the central solver


def oracle(runs: Sequence[Run], found: Sequence[Oracle]) -> Figure | None:
    """Draw gap, constraint violation and last residual over time, a column per run; None without steps to compare."""
    pairs = zip(runs, found, strict=True)
    shown = [(run, each) for run, each in pairs if len(each.step) > 1 and np.isfinite(each.gap).any()]
    if not shown:
        return None
    figure = Figure(figsize=(5.2 * len(shown) + 1.8, 7.2), layout="constrained")
    panels = figure.subplots(3, len(shown), sharex="col", sharey="row", squeeze=False)
    for (gap, violation, residual), (run, each) in zip(panels.T, shown, strict=True):
        time: Array = each.step * np.float64(run.fleet.time.sample_time)
        _agents(gap, time, np.maximum(_distances(each), _LEAST), each.agents)
        _mark_unsolved(gap, run, each)
        violation.plot(time, np.maximum(each.violation, _LEAST), ".-", color=INK, linewidth=1, markersize=4)
        _agents(residual, time, each.residual, each.agents)
        if run.fleet.exchange.threshold > 0:
            residual.axhline(run.fleet.exchange.threshold, color=RED, linestyle="--", linewidth=1.4, label="threshold")
        gap.set_title(heading(run))
        residual.set_xlabel("time in s")
    flown = any(np.isfinite(each.plan_gap).any() for _, each in shown)
    texts = (
        "plan to central plan,\nlargest distance in m" if flown else "decision to central one",
        "constraint violation",
    )
    for row, text in zip(panels, (*texts, "residual at the stop"), strict=True):
        row[0].set_yscale("log")
        row[0].set_ylabel(text)
    for row in (panels[0], panels[2]):
        entries = {text: line for axes in row for line, text in zip(*axes.get_legend_handles_labels(), strict=True)}
        row[-1].legend(entries.values(), entries.keys(), loc="upper left", bbox_to_anchor=(1.01, 1), borderaxespad=0)
    return figure


def _distances(found: Oracle) -> Array:
    """Return the distances between plans, m, or between decisions if they plan no motion, shape (K, N)."""
    return found.plan_gap if np.isfinite(found.plan_gap).any() else found.gap


def _agents(axes: Axes, time: Array, values: Array, agents: Sequence[int]) -> None:
    """Draw one line per agent; median and range if there are many."""
    drawn = np.where(np.isfinite(values) & (values > 0), values, np.nan)
    if len(agents) <= _FEW:
        for place, agent in enumerate(agents):
            axes.plot(time, drawn[:, place], marker=".", markersize=4, linewidth=1, label=f"agent {agent}",
                      **agent_style(place))  # fmt: skip
        return
    known = np.isfinite(drawn).any(axis=1)
    low, middle, high = np.nanpercentile(drawn[known], (0, 50, 100), axis=1)
    axes.fill_between(time[known], low, high, color=GREY, alpha=0.3, linewidth=0, label="all agents")
    axes.plot(time[known], middle, color=INK, linewidth=1.4, label="median")


def _mark_unsolved(axes: Axes, run: Run, found: Oracle) -> None:
    for number, step in enumerate(found.unsolved):
        instant = step * run.fleet.time.sample_time
        axes.axvline(
            instant, color=GREY, linestyle=":", linewidth=1, label="no central solution" if not number else None
        )
