"""Loss and latency of the links, over time next to the separation of the agents."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from agentd.figures.style import BLUE, GREEN, GREY, INK, ORANGE, PINK, RED, SKY, heading, named, side_of
from dcf_zenoh.analysis.link_health import LinkHealth, absences, link_health, total_per_step
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run

_MANY = 12  # agents beyond which the cells have no numbers
_LEVELS = 4  # heights of names, so that none hides another
_PALE = {RED: "#fff5ee", BLUE: "#f0f6fb"}


@dataclass(frozen=True)
class _Window:
    """Interval with a disturbance: begin and end in s, text and colour."""

    begin: float
    end: float
    what: str
    colour: str


def links(runs: Sequence[Run]) -> Figure | None:
    """Draw loss and latency of every link; over time lost and late messages, and below them the least barrier value.

    Only runs whose logs record single messages are drawn: with faults on links, or on the wall clock.
    """
    measured = [(run, link_health(run)) for run in runs]
    shown = [(run, health) for run, health in measured if any(each.recorded for each in health)]
    if not shown:
        return None
    delays = any(each.latencies.any() for _, health in shown for each in health)
    moves = any(run.barriers.size or run.distances.size for run, _ in shown)
    figure = Figure(figsize=(7.6 * len(shown), 8.8 if moves else 6.6), layout="constrained")
    parts = figure.subfigures(1, len(shown), squeeze=False)[0]
    most = max(each.loss for _, health in shown for each in health)
    slowest = max((each.latency(0.95) or 0.0 for _, health in shown for each in health), default=0.0)
    panels = [_layout(part, run, delays=delays, moves=moves) for part, (run, _) in zip(parts, shown, strict=True)]
    for axes, (run, health) in zip(panels, shown, strict=True):
        _losses(axes["loss"], run, health, most)
        if delays:
            _latencies(axes["latency"], run, health, slowest)
        windows = list(_windows(run))
        _shares(axes["share"], run, health, windows)
        if moves:
            _closeness(axes["least"], run, windows)
        axes["least" if moves else "share"].set_xlabel("time in s")
    for name in ("share", "least") if moves else ("share",):
        highest = max(axes[name].get_ylim()[1] for axes in panels)
        lowest = min(axes[name].get_ylim()[0] for axes in panels)
        for axes in panels:
            axes[name].set_ylim(lowest, highest)
    return figure


def _layout(part: SubFigure, run: Run, *, delays: bool, moves: bool) -> dict[str, Axes]:
    part.suptitle(heading(run), fontsize=11)
    rows: list[Any] = [["loss", "latency" if delays else "loss"], ["share"] * 2, *([["least"] * 2] if moves else [])]
    axes: dict[str, Axes] = part.subplot_mosaic(rows, gridspec_kw={"height_ratios": [1.9, 1.0, 1.0][: len(rows)]})
    if moves:
        axes["share"].sharex(axes["least"])
        axes["share"].tick_params(labelbottom=False)
    return axes


def _losses(axes: Axes, run: Run, health: Sequence[LinkHealth], most: float) -> None:
    values = {(each.sender, each.receiver): 100 * each.loss for each in health}
    texts = {link: f"{value:.1f}" if value else "0" for link, value in values.items()}
    _matrix(axes, run, values, texts, 100 * most, RED)
    axes.set_title("messages lost, %")


def _latencies(axes: Axes, run: Run, health: Sequence[LinkHealth], slowest: float) -> None:
    values, texts = {}, {}
    for each in health:
        median, high = each.latency(0.5), each.latency(0.95)
        if median is None or high is None:
            continue
        values[each.sender, each.receiver] = high * 1e3
        texts[each.sender, each.receiver] = f"{_short(median * 1e3)}\n{_short(high * 1e3)}"
    _matrix(axes, run, values, texts, slowest * 1e3, BLUE)
    axes.set_title("latency in ms: median, 95 % (colour)")


def _short(value: float) -> str:
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def _matrix(
    axes: Axes,
    run: Run,
    values: dict[tuple[int, int], float],
    texts: dict[tuple[int, int], str],
    most: float,
    colour: str,
) -> None:
    """Draw a table with a row per sender and a column per receiver; a cell without a value is grey."""
    ids = run.fleet.ids
    place = {agent: index for index, agent in enumerate(ids)}
    table = np.full((len(ids), len(ids)), np.nan)
    for (sender, receiver), value in values.items():
        table[place[sender], place[receiver]] = value
    shades = LinearSegmentedColormap.from_list("shades", [_PALE[colour], colour]).with_extremes(bad="#e4e4e4")
    axes.imshow(table, cmap=shades, vmin=0.0, vmax=most or 1.0, aspect="auto")
    for (sender, receiver), text in texts.items() if len(ids) <= _MANY else ():
        dark = most and values[sender, receiver] > 0.6 * most
        axes.text(
            place[receiver], place[sender], text, ha="center", va="center", color="white" if dark else INK,
            fontsize=9 if len(ids) <= 6 else 6.5, linespacing=1.1,
        )  # fmt: skip
    axes.set_xticks(range(len(ids)), list(map(str, ids)))
    axes.set_yticks(range(len(ids)), list(map(str, ids)))
    axes.set_xlabel("receiver")
    axes.set_ylabel("sender")
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def _shares(axes: Axes, run: Run, health: Sequence[LinkHealth], windows: Sequence[_Window]) -> None:
    """Draw the messages lost and late per step, of all links together and of the worst link."""
    table = total_per_step(tuple(health))
    time = np.arange(table.shape[1]) * run.fleet.time.sample_time
    sent = table[..., 0].sum(axis=0)
    lost = _percent(table[..., 1].sum(axis=0), sent)
    late = np.minimum(_percent(table[..., 2].sum(axis=0), sent), 100 - lost)
    worst = np.minimum(_percent(table[..., 1] + table[..., 2], table[..., 0]), 100).max(axis=0)
    axes.plot(time, worst, color=INK, linewidth=1.0, drawstyle="steps-post", label="worst link")
    axes.fill_between(time, lost, step="post", color=RED, alpha=0.75, linewidth=0, label="lost, all links")
    if late.any():
        axes.fill_between(
            time, lost, lost + late, step="post", color=SKY, alpha=0.75, linewidth=0, label="late, all links"
        )
    axes.set_ylabel("messages per step, %")
    room = 1.1 + 0.13 * min(len(windows), _LEVELS)  # for the names of the windows
    axes.set_ylim(0, room * max(1.0, float(worst.max(initial=0.0))))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2.5, 5, 10]))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}" if value <= 100 else "")
    _shade(axes, windows)
    _legend(axes)


def _percent(part: Any, whole: Any) -> Array:
    share: Array = 100 * part / np.maximum(whole, 1)
    return share


def _closeness(axes: Axes, run: Run, windows: Sequence[_Window]) -> None:
    """Draw the least barrier value of all pairs, or the least distance where there is no safety region."""
    values = run.barriers if run.barriers.size else run.distances
    axes.set_ylabel("least barrier h" if run.barriers.size else "least distance in m")
    if not values.size:
        axes.text(0.5, 0.5, "nothing moves", transform=axes.transAxes, ha="center", color=GREY)
        return
    least = values.min(axis=1)
    axes.plot(run.time, least, color=BLUE, linewidth=1.6)
    closest = run.closest()
    assert closest is not None  # there are values
    place, side = (closest.time, closest.value), side_of(closest, run)
    axes.plot(*place, "o", color=BLUE, markersize=5)
    axes.annotate(
        named(closest, "" if run.barriers.size else " m"), place, xytext=(0, 22),
        textcoords="offset points", ha=side, color=BLUE, arrowprops={"arrowstyle": "-", "color": BLUE, "lw": 0.8},
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}, zorder=5,
    )  # fmt: skip
    top = 1.1 * max(float(least.max()), 0.2)
    axes.set_ylim(min(-0.07 * top, 1.2 * closest.value), top)
    if run.barriers.size:
        axes.axhspan(-10, 0, color=RED, alpha=0.15, linewidth=0)
        axes.axhline(0, color=RED, linewidth=1.2, label="safety region, h < 0")
    if run.arrival_time is not None:
        axes.axvline(run.arrival_time, color=GREEN, linestyle="-.", linewidth=1.2, label="arrived")
    _shade(axes, windows, named=False)
    _legend(axes)


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=4,
            borderaxespad=0.1,
            columnspacing=1.2,
            handlelength=1.4,
        )


def _shade(axes: Axes, windows: Sequence[_Window], *, named: bool = True) -> None:
    for window in windows:
        if window.end > window.begin:
            axes.axvspan(window.begin, window.end, color=window.colour, alpha=0.22, linewidth=0, zorder=0)
        axes.axvline(window.begin, color=window.colour, linewidth=1.0, linestyle=":", zorder=1)
    for height, window in enumerate(windows if named else ()):
        axes.annotate(
            window.what, (window.begin, 1), xycoords=("data", "axes fraction"),
            xytext=(3, -2 - 11 * (height % _LEVELS)), textcoords="offset points", ha="left", va="top", fontsize=8.5,
            color=INK, annotation_clip=True, zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
        )  # fmt: skip


def _windows(run: Run) -> Iterator[_Window]:
    """Yield the intervals of temporary faults and of absences, and the instants of alarms and of operators' changes."""
    t = run.fleet.time.sample_time
    end = max((float(log.acted[-1]) for log in run.agents.values() if len(log.step)), default=0.0)
    for rule in run.fleet.faults.rules:
        if rule.during and rule.during[0] < end:
            yield _Window(rule.during[0], min(rule.during[1], end), ", ".join(rule.faults), ORANGE)
    for agent, own in run.fleet.agents.items():
        if own.faults.pause and own.faults.pause[0] < end:
            yield _Window(own.faults.pause[0], min(own.faults.pause[1], end), f"agent {agent} pauses", PINK)
        if own.faults.slow and own.faults.slow.during and own.faults.slow.during[0] < end:
            begin, until = own.faults.slow.during
            yield _Window(begin, min(until, end), f"agent {agent} slow", PINK)
    for agent, log in run.agents.items():
        missed = absences(log)
        for step in missed:
            if step - 1 not in missed:
                last = next(each for each in missed if each >= step and each + 1 not in missed)
                yield _Window(step * t, (last + 1) * t, f"agent {agent} absent", GREY)
        if len(log.step) and (log.step[-1] + 1) * t < end - t:
            yield _Window((int(log.step[-1]) + 1) * t, end, f"agent {agent} absent", GREY)
    for instant, label in sorted(set(_instants(run))):
        yield _Window(instant, instant, label, RED if label.startswith("alarm") else ORANGE)


def _instants(run: Run) -> Iterator[tuple[float, str]]:
    """Yield instants, s, to the nearest step, at which faults were changed or an alarm began, and what it was."""
    t = run.fleet.time.sample_time
    for log in run.agents.values():
        for event in log.events:
            label = {"fault": "faults changed", "alarm": f"alarm: {event.get('rule')}"}.get(event["event"])
            if label:
                yield round(event["time"] * 1e-9 / t) * t, label
