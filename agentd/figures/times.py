"""The paper's second figure: box plots of negotiation and computation times."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agentd.figures.style import BLUE, INK, ORANGE, RED
from dcf_zenoh.plant import Array
from dcf_zenoh.run import Run

_WIDE = 25.0  # ratio of the largest value to the least median beyond which the axis is logarithmic


def times(runs: Sequence[Run]) -> Figure | None:
    """Time per step and agent in negotiation and in the algorithm, a box per run, against the budget."""
    shown = [run for run in runs if any(took_part(run))]
    if not shown:
        return None
    figure = Figure(figsize=(max(8.0, 3.1 * len(shown) + 1.6), 5.0), layout="constrained")
    negotiation, compute = figure.subplots(1, 2)
    clocks = {run.fleet.time.clock for run in shown}
    model = {"virtual": ", model time", "wall": ""}[clocks.pop()] if len(clocks) == 1 else ""
    _boxes(negotiation, shown, [_values(run, "negotiation") for run in shown], BLUE)
    negotiation.set_title("Negotiation: all of steps 1 and 2")
    negotiation.set_ylabel(f"time per step in ms{model}")
    _boxes(compute, shown, [_values(run, "compute") for run in shown], ORANGE)
    compute.set_title("Computation: the algorithm alone")
    compute.set_ylabel("time per step in ms, real time")
    figure.suptitle("Fleet " + ", ".join(dict.fromkeys(run.fleet.name for run in shown)), fontsize=12)
    figure.legend(handles=_key(), loc="outside lower center", ncols=3)
    return figure


def took_part(run: Run) -> list[bool]:
    """Which agent-steps were negotiated, all agents' steps in a row; in the others there was nothing to time."""
    return [word != "abstained" for log in run.agents.values() for word in log.stopped_by]


def _values(run: Run, quantity: str) -> Array:
    """Times of all negotiated agent-steps, ms."""
    every: Array = np.concatenate([getattr(log, quantity) for log in run.agents.values()])
    return every[took_part(run)] * 1e3


def _boxes(axes: Axes, runs: Sequence[Run], values: Sequence[Array], colour: str) -> None:
    axes.boxplot(
        list(values),
        tick_labels=[_label(run) for run in runs],
        widths=0.45,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.45, "edgecolor": INK},
        medianprops={"color": INK, "linewidth": 1.8},
        flierprops={"marker": "o", "markersize": 3, "markerfacecolor": colour, "markeredgecolor": "none", "alpha": 0.7},
    )
    budgets = [run.fleet.exchange.step_budget(run.fleet.time.sample_time) * 1e3 for run in runs]
    for place, (budget, found) in enumerate(zip(budgets, values, strict=True), start=1):
        axes.hlines(budget, place - 0.42, place + 0.42, color=RED, linewidth=1.6, linestyle="--")
        axes.annotate(
            f"median {np.median(found):.3g} ms\nmax {found.max():.3g} ms", (place, 1), xytext=(0, -4),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="center", va="top", fontsize=9,
        )  # fmt: skip
    axes.grid(visible=False, axis="x")
    low, high = min(found.min() for found in values), max(*budgets, *(found.max() for found in values))
    if low > 0 and high > _WIDE * min(np.median(found) for found in values):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(low / 1.5, high * (high / low) ** 0.3)  # room for the numbers on top
    else:
        axes.set_ylim(-0.03 * high, 1.3 * high)


def _label(run: Run) -> str:
    """Which run, of how many steps, and what is not in its boxes."""
    taken = took_part(run)
    late = sum(int(log.late.sum()) for log in run.agents.values())
    lines = [textwrap.fill(run.name, 20), f"{run.fleet.topology.kind}, {run.fleet.time.clock} clock"]
    lines += [f"{sum(taken)} agent-steps", f"{late} late"]
    if out := len(taken) - sum(taken):
        lines.append(f"left out: {out} abstained")
    return "\n".join(lines)


def _key() -> list[Line2D]:
    return [
        Line2D([], [], color=RED, linestyle="--", linewidth=1.6, label="budget of a step"),
        Line2D([], [], color=INK, linewidth=1.8, label="median; box: quartiles; whiskers: up to 1.5 box lengths"),
        Line2D([], [], color=INK, marker="o", markersize=3, linestyle="", label="outlier"),
    ]
