"""Decisions of agents without plants."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agentd.figures.style import agent_style, flies, heading
from dcf_zenoh.records.run import Run

_FEW = 8  # components up to which there is a legend


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
    for component in range(width):
        agents = [agent for agent, decision in made.items() if len(decision) > component]
        values = [made[agent][component] for agent in agents]
        colour = agent_style(component)["color"]
        axes.plot(agents, values, "o", color=colour, markersize=7, label=f"component {component}")
    if 1 < width <= _FEW:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1))
    axes.set_xticks(list(made))
    axes.margins(y=0.25)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_xlabel("agent")
    axes.set_ylabel("decision")
    most = max(int(log.rounds.max(initial=0)) for log in run.agents.values())
    spread = max(float(np.ptp([made[a][c] for a in made if len(made[a]) > c])) for c in range(width))
    axes.set_title(f"{heading(run)}\nafter {most} rounds; largest difference {spread:.2g}")
