"""Paths of the agents in the plane, the paper's first figure."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle

from agentd.figures.style import GREY, INK, RED, agent_style, flies, heading
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import ClosestApproach, Run

_COLUMNS = 3
_OBSTACLE: Any = {"facecolor": "#dddddd", "edgecolor": GREY, "hatch": "///", "linewidth": 0.9}
_ARENA: Any = {"fill": False, "edgecolor": RED, "linestyle": (0, (6, 3)), "linewidth": 1.4}


def trajectories(runs: Sequence[Run]) -> Figure | None:
    """Draw paths, starts, ends and targets, and the safety regions at the instant of the closest approach."""
    flown = [run for run in runs if any(map(flies, run.agents.values()))]
    if not flown:
        return None
    columns = min(len(flown), _COLUMNS)
    rows = -(-len(flown) // columns)
    corners = [limits(run) for run in flown]
    low, high = np.min([each[0] for each in corners], axis=0), np.max([each[1] for each in corners], axis=0)
    height = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.4, 1.6)) * 4.6
    figure = Figure(figsize=(4.6 * columns + 0.8, (height + 1.3) * rows + 0.5), layout="compressed")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    panels[0, 0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for axes, run in zip(panels.flat, flown, strict=False):
        draw_paths(axes, run, heading(run))
    for axes in panels.flat[len(flown) :]:
        axes.remove()
    for axes in panels[:, 0]:
        axes.set_ylabel("y in m")
    figure.legend(handles=paths_key(flown), loc="outside lower center", ncols=4 if columns > 1 else 2)
    return figure


def limits(run: Run) -> tuple[Array, Array]:
    """Return the lower left and upper right corner of the drawing of a run, m."""
    points = [log.path[:, :2] for log in run.agents.values() if flies(log)]
    points += [target[None, :2] for target in run.targets.values()]
    points += run.geometry.obstacles
    every = np.vstack(points)
    low, high = every.min(axis=0), every.max(axis=0)
    margin = max(0.08 * float(max(high - low)), 0.1)  # room for names and markers
    return low - margin, high + margin


def draw_paths(axes: Axes, run: Run, title: str) -> None:
    """Draw one run: the paths, and the safety regions at the closest approach, which is added to `title`."""
    closest, regions = run.closest(), _regions(run)
    for corners in run.geometry.obstacles:
        axes.add_patch(Polygon(corners, **_OBSTACLE, zorder=1))
    if run.fleet.arena is not None and len(run.fleet.arena.min) > 1:
        (left, bottom), (right, top) = run.fleet.arena.min[:2], run.fleet.arena.max[:2]
        axes.add_patch(Rectangle((left, bottom), right - left, top - bottom, **_ARENA, zorder=1))
    for place, (agent, log) in enumerate(run.agents.items()):
        if agent in run.targets:
            axes.plot(*run.targets[agent][:2], "x", color=INK, markersize=7, markeredgewidth=1.3, zorder=7)
        if not flies(log):
            continue
        style, path = agent_style(place), log.path
        axes.plot(path[:, 0], path[:, 1], linewidth=1.8, zorder=3, **style)
        axes.plot(*path[0, :2], "s", color=style["color"], markersize=7, zorder=4)
        axes.plot(*path[-1, :2], "o", markersize=13, markerfacecolor="none", markeredgewidth=1.6,
                  markeredgecolor=style["color"], zorder=4)  # fmt: skip
        _name(axes, agent, path, style["color"])
        if closest is not None:
            axes.plot(*_place(run, agent, closest)[:2], "o", color=style["color"], markersize=4.5, zorder=5)
        if agent in regions:
            corners = regions[agent]
            axes.add_patch(Polygon(corners, closed=True, facecolor=style["color"], alpha=0.08, zorder=1))
            axes.add_patch(
                Polygon(corners, closed=True, fill=False, edgecolor=style["color"], linewidth=0.9, alpha=0.8, zorder=2)
            )
    axes.set_aspect("equal")
    axes.tick_params(labelbottom=True)  # also above an empty panel of the last row
    axes.set_xlabel("x in m")
    if closest is not None:
        what, unit = ("least barrier h =", "") if closest.quantity == "barrier" else ("least distance", " m")
        title += f"\nclosest at {closest.time:.1f} s: {what} {closest.value:.3f}{unit}"
        title += "" if closest.between else ", at the samples"
    axes.set_title(title)


def _place(run: Run, agent: int, closest: ClosestApproach) -> Array:
    """Return the position of an agent at the closest approach, shape (d,), m."""
    place: Array = run.motions[agent].at(np.array([closest.time]))[0]
    return place


def _regions(run: Run) -> dict[int, Array]:
    """Return agent -> corners of its safety region at the closest approach, shape (corners, 2), m, if known."""
    closest = run.closest()
    if closest is None:
        return {}
    found = {i: run.geometry.outline(i, _place(run, i, closest)) for i, log in run.agents.items() if flies(log)}
    return {i: corners for i, corners in found.items() if corners is not None}


def _name(axes: Axes, agent: int, path: Array, colour: str) -> None:
    """Write the id next to the start, on the side opposite to the path."""
    away = path[0, :2] - path[min(len(path) - 1, 5), :2]
    away = away / np.hypot(*away) if np.hypot(*away) > 1e-6 else np.array([0.0, 1.0])
    away = away + 0.8 * np.array(
        [away[1], -away[0]]
    )  # aside, because the target of another agent may be behind the start
    axes.annotate(
        str(agent), (path[0, 0], path[0, 1]), xytext=(12 * away[0], 12 * away[1]), textcoords="offset points",
        ha="center", va="center", color=colour, fontweight="bold", fontsize=11, zorder=6,
    )  # fmt: skip


def paths_key(runs: Sequence[Run]) -> list[Line2D | Patch]:
    """Return the legend of paths in a neutral colour, because the picture names the agents."""
    key: list[Line2D | Patch] = [
        Line2D([], [], color=GREY, marker="s", markersize=7, linewidth=1.8, label="start and path"),
        Line2D([], [], color=GREY, marker="o", markersize=11, markerfacecolor="none", linestyle="", label="end"),
        Line2D([], [], color=INK, marker="x", markersize=7, linestyle="", label="target"),
    ]
    if any(map(_regions, runs)):
        key.append(Patch(facecolor="#eeeeee", edgecolor=GREY, label="safety region, closest instant"))
    if any(run.geometry.obstacles for run in runs):
        key.append(Patch(**_OBSTACLE, label="obstacle"))
    if any(run.fleet.arena is not None for run in runs):
        key.append(Patch(**_ARENA, label="arena"))
    return key
