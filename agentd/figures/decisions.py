"""Decisions of agents without plants."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agentd.figures.style import GREY, INK, agent_style, flies, heading
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run

_FEW = 8  # components up to which each has its points and a place in the legend
_LINES = 30  # agents up to which each has a line
_POINTS = 2000  # components that are drawn of a longer decision


def decisions(runs: Sequence[Run]) -> Figure | None:
    """Draw the last decision of every agent, component by component, of runs without plants."""
    shown = [run for run in runs if run.agents and not any(map(flies, run.agents.values()))]
    shown = [run for run in shown if any(log.decision.size for log in run.agents.values())]
    if not shown:
        return None
    figure = Figure(figsize=(5.6 * len(shown), 4.2), layout="constrained")
    for axes, run in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        _panel(axes, run)
    return figure


def _panel(axes: Axes, run: Run) -> None:
    made = {agent: log.decision[-1] for agent, log in run.agents.items() if log.decision.size}
    width = max(map(len, made.values()))
    table = np.full((len(made), width), np.nan)
    for row, decision in zip(table, made.values(), strict=True):
        row[: len(decision)] = decision
    if width > _FEW:
        _long(axes, list(made), table)
    else:
        _short(axes, made, width)
    axes.margins(y=0.25)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_ylabel("decision")
    most = max(int(log.rounds.max(initial=0)) for log in run.agents.values())
    finite = table[:, ~np.isnan(table).all(axis=0)]
    spread = float((np.nanmax(finite, axis=0) - np.nanmin(finite, axis=0)).max(initial=0.0))
    axes.set_title(f"{heading(run)}\nafter {most} rounds; largest difference {spread:.2g}")


def _long(axes: Axes, agents: Sequence[int], table: Array) -> None:
    """Draw decisions over their components: a line for each agent, or the distribution over many agents."""
    every = -(-table.shape[1] // _POINTS)
    components, shown = np.arange(table.shape[1])[::every], table[:, ::every]
    if len(agents) <= _LINES:
        for agent, line in zip(agents, shown, strict=True):
            axes.plot(components, line, color=agent_style(agent)["color"], linewidth=0.9, label=f"agent {agent}")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1), ncols=1 + len(agents) // 16)
    else:
        low, middle, high = np.nanpercentile(shown, (5, 50, 95), axis=0)
        axes.fill_between(components, low, high, color=GREY, alpha=0.3, linewidth=0, label="5 % to 95 % of the agents")
        axes.plot(components, middle, color=INK, linewidth=1.4, label="median")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1))
    axes.set_xlabel("component" if every == 1 else f"component, every {every}th")


def _short(axes: Axes, made: Mapping[int, Array], width: int) -> None:
    """Draw each component of decisions over the agents."""
    for component in range(width):
        agents = [agent for agent, decision in made.items() if len(decision) > component]
        values = [made[agent][component] for agent in agents]
        colour = agent_style(component)["color"]
        axes.plot(agents, values, "o", color=colour, markersize=7, label=f"component {component}")
    if 1 < width <= _FEW:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1))
    if len(made) <= _LINES:
        axes.set_xticks(list(made))
    axes.set_xlabel("agent")
