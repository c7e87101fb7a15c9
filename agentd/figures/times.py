"""The paper's second figure: box plots of negotiation and computation times."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from agentd.figures.style import BLUE, INK, ORANGE, RED
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run

_WIDE = 25.0  # ratio of the largest value to the least median beyond which the axis is logarithmic


def times(runs: Sequence[Run]) -> Figure | None:
    """Draw the time per step and agent in negotiation and in the algorithm, a box per run, with the budget."""
    shown = [run for run in runs if any(took_part(run))]
    if not shown:
        return None
    figure = Figure(figsize=(max(8.0, 3.1 * len(shown) + 1.6), 5.0), layout="constrained")
    negotiation, compute = figure.subplots(1, 2)
    labels = [_label(run) for run in shown]
    boxes(negotiation, [milliseconds(run, "negotiation") for run in shown], labels, BLUE, allowed=budgets(shown))
    negotiation.set_title("Negotiation: states and rounds")
    negotiation.set_ylabel(f"time per step in ms{kind_of_time(shown)}")
    boxes(compute, [milliseconds(run, "compute") for run in shown], labels, ORANGE, allowed=budgets(shown))
    compute.set_title("Computation: the algorithm alone")
    compute.set_ylabel("time per step in ms, real time")
    figure.suptitle("Fleet " + ", ".join(dict.fromkeys(run.fleet.name for run in shown)), fontsize=12)
    figure.legend(handles=boxes_key(), loc="outside lower center", ncols=3)
    return figure


def took_part(run: Run) -> list[bool]:
    """Return for each step of each agent, in one list, whether it was negotiated; the other steps have no times."""
    return [word != "abstained" for log in run.agents.values() for word in log.stopped_by]


def kind_of_time(runs: Sequence[Run]) -> str:
    """Return ``, model time`` if all `runs` are in virtual time, else an empty text."""
    return ", model time" if {run.fleet.time.clock for run in runs} == {"virtual"} else ""


def budgets(runs: Sequence[Run]) -> list[float]:
    """Return the budget of each run for the rounds of a step, ms."""
    return [run.fleet.exchange.step_budget(run.fleet.time.sample_time) * 1e3 for run in runs]


def milliseconds(run: Run, quantity: str) -> Array:
    """Return the times of all negotiated agent-steps, ms."""
    every: Array = np.concatenate([getattr(log, quantity) for log in run.agents.values()])
    return every[took_part(run)] * 1e3


def boxes(
    axes: Axes,
    values: Sequence[Array],
    labels: Sequence[str],
    colour: str,
    *,
    unit: str = " ms",
    allowed: Sequence[float] = (),
    words: bool = True,
) -> None:
    """Draw a box for each of `values`, with its median and maximum as text, and the `allowed` value as a line."""
    axes.boxplot(
        list(values),
        tick_labels=list(labels),
        widths=0.45,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.45, "edgecolor": INK},
        medianprops={"color": INK, "linewidth": 1.8},
        flierprops={"marker": "o", "markersize": 3, "markerfacecolor": colour, "markeredgecolor": "none", "alpha": 0.7},
    )
    for place, budget in enumerate(allowed, start=1):
        axes.hlines(budget, place - 0.42, place + 0.42, color=RED, linewidth=1.6, linestyle="--")
    for place, found in enumerate(values if words else (), start=1):
        axes.annotate(
            f"median {np.median(found):.3g}{unit}\nmax {found.max():.3g}{unit}", (place, 1), xytext=(0, -4),
            xycoords=("data", "axes fraction"), textcoords="offset points", ha="center", va="top", fontsize=9,
        )  # fmt: skip
    axes.grid(visible=False, axis="x")
    low, high = min(found.min() for found in values), max([*allowed, *(found.max() for found in values)])
    if low > 0 and high > _WIDE * min(np.median(found) for found in values):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(low / 1.5, high * (high / low) ** 0.3)  # room for the numbers on top
    else:
        axes.set_ylim(-0.03 * high, 1.3 * high)


def _label(run: Run) -> str:
    """Return a label: the run, the number of its steps, and the steps left out."""
    taken = took_part(run)
    late = sum(int(log.late.sum()) for log in run.agents.values())
    lines = [textwrap.fill(run.name, 20), f"{run.fleet.topology.kind}, {run.fleet.time.clock} clock"]
    lines += [f"{sum(taken)} agent-steps", f"{late} late"]
    if out := len(taken) - sum(taken):
        lines.append(f"left out: {out} abstained")
    return "\n".join(lines)


def boxes_key() -> list[Line2D]:
    """Return the legend of boxes."""
    return [
        Line2D([], [], color=RED, linestyle="--", linewidth=1.6, label="budget of a step"),
        Line2D([], [], color=INK, linewidth=1.8, label="median; box: quartiles; whiskers: up to 1.5 box lengths"),
        Line2D([], [], color=INK, marker="o", markersize=3, linestyle="", label="outlier"),
    ]
