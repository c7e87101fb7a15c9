"""Distances and barrier values of the agents, and rounds per step."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agentd.figures.style import BLUE, GREEN, GREY, INK, ORANGE, RED, flies, heading, named, side_of
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import ClosestApproach, Run

_FEW = 15  # pairs up to which each is drawn


def separation(runs: Sequence[Run]) -> Figure | None:
    """Draw distance and barrier value over time, least and per pair, and rounds per step; a column per run."""
    flown = [run for run in runs if any(map(flies, run.agents.values()))]
    if not flown:
        return None
    drawers = [_distances] if any(run.distances.size for run in flown) else []
    drawers += [_barriers] if any(run.barriers.size for run in flown) else []
    drawers.append(_rounds)
    size = (5.2 * len(flown) + 1.6, 2.3 * len(drawers) + 0.9)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(drawers), len(flown), sharex="col", sharey="row", squeeze=False)
    for column, run in zip(panels.T, flown, strict=True):
        for axes, draw in zip(column, drawers, strict=True):
            draw(axes, run)
            if run.arrival_time is not None:
                axes.axvline(run.arrival_time, color=GREEN, linestyle="-.", linewidth=1.2, label="arrived")
        column[0].set_title(heading(run))
        column[-1].set_xlabel("time in s")
    for row, draw in zip(panels, drawers, strict=True):
        row[0].set_ylabel({_distances: "distance in m", _barriers: "barrier h", _rounds: "rounds per step"}[draw])
        entries = {text: handle for axes in row for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
        least = [1.2 * low.value for run in flown for low in map(run.closest, ("barrier", "clearance")) if low]
        bottom = min([-0.07 * row[0].get_ylim()[1], *least]) if draw is _barriers else 0.0
        row[0].set_ylim(bottom=bottom)
        row[-1].legend(entries.values(), entries.keys(), loc="upper left", bbox_to_anchor=(1.01, 1), borderaxespad=0)
    return figure


def _distances(axes: Axes, run: Run) -> None:
    _pairs(axes, run, run.distances, run.closest("distance"), " m")
    reach = _reach(run)
    if reach is not None and run.distances.size:
        axes.axhspan(0, reach, color=RED, alpha=0.2, linewidth=0, label="in the safety region\nfrom any direction")


def _barriers(axes: Axes, run: Run) -> None:
    if not run.barriers.size:
        why = "no recorded step" if run.geometry.has_regions else "no safety region"
        why = why if run.geometry.unknown is None else "safety region not known"
        axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", color=GREY)
        return
    _pairs(axes, run, run.barriers, run.closest("barrier"), "")
    if run.clearances.size:
        axes.plot(run.time, run.clearances.min(axis=1), color=INK, linewidth=1.2, linestyle="--",
                  label="least with obstacles")  # fmt: skip
    axes.axhspan(-1, 0, color=RED, alpha=0.2, linewidth=0, label="in the safety region,\nh < 0")
    axes.axhline(0, color=RED, linewidth=1.2)


def _reach(run: Run) -> float | None:
    """Return the radius of the largest circle in the safety regions of all agents, m; None if none can be drawn."""
    centre = np.zeros(2)
    outlines = [run.geometry.outline(agent, centre) for agent in run.agents]
    circles = [_inner_radius(each) for each in outlines if each is not None]
    return min(circles, default=None)


def _inner_radius(corners: Array) -> float:
    """Return the distance from the origin to the boundary of a polygon with these corners, shape (corners, 2)."""
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.maximum((edges**2).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(-(corners * edges).sum(axis=1) / lengths, 0.0, 1.0)
    return float(np.linalg.norm(corners + share[:, np.newaxis] * edges, axis=1).min())


def _pairs(axes: Axes, run: Run, values: Array, closest: ClosestApproach | None, unit: str) -> None:
    """Draw the samples of every pair if they are few, their range if they are many; the least and the closest."""
    if not values.size or closest is None:
        return
    least = values.min(axis=1)
    if values.shape[1] <= _FEW:
        lines = axes.plot(run.time, values, color=GREY, linewidth=0.7, alpha=0.8)
        lines[0].set_label("each pair")
    else:
        axes.fill_between(run.time, least, values.max(axis=1), color=GREY, alpha=0.2, linewidth=0, label="all pairs")
    axes.plot(run.time, least, color=BLUE, linewidth=2, label="least of all pairs")
    place, side = (closest.time, closest.value), side_of(closest, run)
    axes.plot(*place, "o", color=BLUE, markersize=5)
    axes.annotate(
        named(closest, unit), place, xytext=(0, 26), textcoords="offset points", ha=side,
        color=BLUE, arrowprops={"arrowstyle": "-", "color": BLUE, "lw": 0.8},
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
    )  # fmt: skip


def _rounds(axes: Axes, run: Run) -> None:
    """Draw the most and fewest rounds of any agent, and mark the steps that did not end by agreement."""
    logs = [log for log in run.agents.values() if len(log.step)]
    table = np.full((len(logs), 1 + max(log.step[-1] for log in logs)), np.nan)
    for row, log in zip(table, logs, strict=True):
        row[log.step] = log.rounds
    time = np.arange(table.shape[1]) * run.fleet.time.sample_time
    most, fewest = np.fmax.reduce(table), np.fmin.reduce(table)
    uneven = bool((fewest < most).any())
    if uneven:
        axes.fill_between(time, fewest, most, step="mid", color=BLUE, alpha=0.3, linewidth=0, label="fewest to most")
    axes.step(time, most, where="mid", color=BLUE, linewidth=1.2, label="most of any agent" if uneven else "all agents")
    for word, marker, colour in (("budget", "v", ORANGE), ("rounds", "^", INK), ("abstained", "s", GREY)):
        steps = sorted(
            {int(step) for log in logs for step, how in zip(log.step, log.stopped_by, strict=True) if how == word}
        )
        if steps:
            label = {"budget": "out of time", "rounds": "out of rounds", "abstained": "abstained"}[word]
            axes.plot(time[steps], most[steps], marker, color=colour, markersize=6, linestyle="", label=label)
    late = sorted({int(step) for log in logs for step in log.step[log.late]})
    if late:
        axes.plot(time[late], most[late], "x", color=RED, markersize=6, linestyle="", label="deadline missed")
