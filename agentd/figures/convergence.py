"""Residuals over the rounds of a step."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agentd.figures.style import GREY, INK, RED, heading
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run
from dcf_zenoh.rounds.dialogue import RoundRecord

_SELECTED = 5  # steps drawn one by one


def convergence(runs: Sequence[Run]) -> Figure | None:
    """Draw the residual over rounds: median and band of all agents and steps, and some steps. Needs ``log.rounds``."""
    tables = [(run, residuals(run)) for run in runs]
    shown = [(run, table) for run, table in tables if np.isfinite(table).any()]
    if not shown:
        return None
    figure = Figure(figsize=(5.6 * len(shown) + 0.4, 4.6), layout="constrained")
    panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, (run, table) in zip(panels, shown, strict=True):
        _panel(axes, run, table)
    panels[0].set_ylabel("residual")
    return figure


def residuals(run: Run) -> Array:
    """Return the residual of every agent, step and round, shape (N, K, P); NaN for none, 0 and infinity."""
    logs = [log.rounds_log for log in run.agents.values()]
    most = max((len(rounds) for log in logs for rounds in log), default=0)
    table = np.full((len(logs), max(map(len, logs)), most), np.nan)
    for agent, log in enumerate(logs):
        for step, rounds in enumerate(log):
            table[agent, step, : len(rounds)] = [RoundRecord(*record).residual for record in rounds]
    table[~np.isfinite(table) | (table <= 0)] = np.nan
    return table


def _panel(axes: Axes, run: Run, table: Array) -> None:
    rounds = [p for p in range(table.shape[2]) if np.isfinite(table[..., p]).any()]
    spread = np.array([np.nanpercentile(table[..., p], (0, 5, 50, 95, 100)) for p in rounds]).T
    axes.fill_between(rounds, spread[0], spread[4], color=GREY, alpha=0.15, linewidth=0, label="all agents and steps")
    axes.fill_between(rounds, spread[1], spread[3], color=GREY, alpha=0.3, linewidth=0, label="5 % to 95 %")
    steps = [k for k in range(table.shape[1]) if np.isfinite(table[:, k]).any()]
    chosen = sorted({steps[round(place)] for place in np.linspace(0, len(steps) - 1, _SELECTED)})
    colours = matplotlib.colormaps["viridis"](np.linspace(0, 0.9, len(chosen)))
    for step, colour in zip(chosen, colours, strict=True):
        label = f"step {step} ({step * run.fleet.time.sample_time:.1f} s), worst agent"
        axes.plot(np.fmax.reduce(table[:, step]), color=colour, linewidth=1.2, label=label)
    axes.plot(rounds, spread[2], color=INK, linewidth=2.2, label="median of steps still iterating")
    if run.fleet.exchange.threshold > 0:
        axes.axhline(run.fleet.exchange.threshold, color=RED, linestyle="--", linewidth=1.4, label="threshold")
    axes.set_yscale("log")
    axes.set_xlabel("round of the step")
    axes.set_title(heading(run))
    axes.legend(loc="upper right")
