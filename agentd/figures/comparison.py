"""Variants of one fleet side by side: their paths, and the times and rounds of their steps."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from agentd.figures.style import BLUE, GREEN, INK, ORANGE, flies
from agentd.figures.times import boxes, boxes_key, budgets, kind_of_time, milliseconds, took_part
from agentd.figures.trajectories import draw_paths, limits, paths_key
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run

_COLUMNS = 4
_NAMED = 4  # variants up to which boxes have names, if these are short enough; otherwise numbers
_SHORT = 20  # characters
_BELOW = 4.4  # inches, height of the lower part


def comparison(variants: Mapping[str, Run | str]) -> Figure | None:
    """Draw the paths of each variant, on the same axes; below them times of negotiation and computation, and rounds.

    Args:
        variants: Name -> run, or the reason why there is none.
    """
    titles = {name: f"{number}: {textwrap.fill(name, 36)}" for number, name in enumerate(variants, start=1)}
    timed = {name: found for name, found in variants.items() if isinstance(found, Run) and any(took_part(found))}
    flown = [run for run in timed.values() if any(map(flies, run.agents.values()))]
    if not timed:
        return None
    columns = min(len(variants), _COLUMNS)
    rows = -(-len(variants) // columns) if flown else 0
    low, high = _corners(flown)
    tall = rows * (float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.4, 1.6)) * 4.0 + 2.0)
    figure = Figure(
        figsize=(max(4.3 * columns + 0.6, 10.0), tall + _BELOW), layout=ConstrainedLayoutEngine(hspace=0.06)
    )
    if not flown:
        _times(figure, timed, titles)
        return figure
    grid = figure.add_gridspec(2, 1, height_ratios=(tall, _BELOW))
    above, below = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    panels = above.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    panels[0, 0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for axes, (name, found) in zip(panels.flat, variants.items(), strict=False):
        _paths(axes, titles[name], found)
    for axes in panels.flat[len(variants) :]:
        axes.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("y in m")
    above.legend(handles=paths_key(flown), loc="outside lower center", ncols=4)
    _times(below, timed, titles)
    return figure


def _corners(runs: Sequence[Run]) -> tuple[Array, Array]:
    """Return the lower left and upper right corner of the drawings of all runs, m."""
    corners = [limits(run) for run in runs] or [(np.zeros(2), np.ones(2))]
    return np.min([each[0] for each in corners], axis=0), np.max([each[1] for each in corners], axis=0)


def _paths(axes: Axes, title: str, found: Run | str) -> None:
    if isinstance(found, str):
        axes.set_title(title)
        axes.set_xlabel("x in m")
        why = textwrap.fill(f"failed: {found}", 36, max_lines=8)
        axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center", color=INK, fontsize=9)
        return
    arrival = "did not arrive" if found.arrival_time is None else f"arrived at {found.arrival_time:.1f} s"
    draw_paths(axes, found, f"{title}\n{arrival}, {found.fleet.time.clock} clock")


def _times(figure: Figure | SubFigure, runs: Mapping[str, Run], titles: Mapping[str, str]) -> None:
    """Draw negotiation, computation and rounds of all agent-steps, a box for each variant."""
    shown = list(runs.values())
    few = len(titles) <= _NAMED
    named = few and max(map(len, titles)) <= _SHORT
    labels = [name if named else titles[name].partition(":")[0] for name in runs]
    negotiation, compute, rounds = figure.subplots(1, 3)
    waits = [milliseconds(run, "negotiation") for run in shown]
    boxes(negotiation, waits, labels, BLUE, allowed=budgets(shown), words=few)
    boxes(compute, [milliseconds(run, "compute") for run in shown], labels, ORANGE, words=few)
    counts = [np.concatenate([log.rounds for log in run.agents.values()])[took_part(run)] for run in shown]
    boxes(rounds, counts, labels, GREEN, unit="", words=few)
    negotiation.set_ylabel(f"time per step in ms{kind_of_time(shown)}")
    negotiation.set_title("Negotiation: states and rounds")
    compute.set_ylabel("time per step in ms, real time")
    compute.set_title("Computation: the algorithm alone")
    rounds.set_ylabel("rounds per step")
    rounds.set_title("Rounds")
    figure.legend(handles=boxes_key(), loc="outside lower center", ncols=3)
