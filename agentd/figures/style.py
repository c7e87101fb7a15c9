"""Common style of all figures: fonts, colours, headings."""

import textwrap
from typing import Any

from dcf_zenoh.message import Last
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import ClosestApproach, Run

STYLE: Any = {  # typed as Any, because the type of matplotlib lists every possible key
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.labelsize": 11,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 11,
    "figure.dpi": 100,
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "grid.alpha": 0.5,
    "grid.color": "#d0d0d0",
    "grid.linewidth": 0.6,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
    "pdf.fonttype": 42,  # text stays text
    "savefig.dpi": 160,
}

# Colours of Okabe and Ito, distinct with any kind of colour vision; without yellow, which is faint on white.
BLUE, ORANGE, GREEN, RED, PINK, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, GREY = "#222222", "#8a8a8a"
_COLOURS = (BLUE, ORANGE, GREEN, RED, PINK, SKY)
_DASHES = ("-", "--", ":", "-.")
_NAMED = 3  # agents that a heading names if they did not reach their planned end
_PLANNED = tuple(last.name.lower() for last in (Last.DONE, Last.ARRIVED))


def agent_style(place: int) -> dict[str, Any]:
    """Return colour and dashes of the agent at `place`, different for the first 24."""
    return {
        "color": _COLOURS[place % len(_COLOURS)],
        "linestyle": _DASHES[place // len(_COLOURS) % len(_DASHES)],
    }


def flies(log: AgentLog) -> bool:
    """Return whether the agent has a body and a recorded step."""
    return bool(len(log.step)) and log.path.shape[1] >= 2


def heading(run: Run) -> str:
    """Return a heading: fleet, run, topology, clock, and the agents that did not reach their planned end."""
    lines = [run.fleet.name] if run.fleet.name == run.name else [f"{run.fleet.name}, {run.name}"]
    lines.append(f"{run.fleet.topology.kind} topology, {run.fleet.time.clock} clock")
    if early := _early(run):
        more = f" and {len(early) - _NAMED} more" if len(early) > _NAMED else ""
        lines.append(textwrap.fill(f"incomplete: {', '.join(early[:_NAMED])}{more}", 52))
    return "\n".join(lines)


def _early(run: Run) -> list[str]:
    """Return the agents that did not reach their planned end, with how and when they ended."""
    found = []
    for agent in run.fleet.ids:
        log = run.agents.get(agent)
        how = "cut off" if log is None or log.end is None else log.end["end"]
        when = "before step 0" if log is None or not len(log.step) else f"after step {log.step[-1]}"
        if how not in _PLANNED:
            found.append(f"agent {agent} {how} {when}")
    return found


def named(closest: ClosestApproach, unit: str) -> str:
    """Return value and instant of a closest approach, as text."""
    text = f"{closest.value:.3f}{unit} at {closest.time:.1f} s"
    return text if closest.between else f"{text}, at the samples"


def side_of(closest: ClosestApproach, run: Run) -> str:
    """Return on which side of its text the instant of a closest approach is: left, center or right."""
    share = closest.time / (run.steps * run.fleet.time.sample_time)
    return ("left", "center", "right")[min(int(3 * share), 2)]
