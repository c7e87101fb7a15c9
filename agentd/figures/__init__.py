"""Figures of a report, one file each. Importing this imports matplotlib, which daemons must not do."""

from collections.abc import Callable, Mapping, Sequence

from matplotlib.figure import Figure

from agentd.figures.convergence import convergence
from agentd.figures.decisions import decisions
from agentd.figures.links import links
from agentd.figures.separation import separation
from agentd.figures.times import times
from agentd.figures.trajectories import trajectories
from dcf_zenoh.records.run import Run

FIGURES: Mapping[str, Callable[[Sequence[Run]], Figure | None]] = {
    "trajectories": trajectories,
    "times": times,
    "separation": separation,
    "convergence": convergence,
    "decisions": decisions,
    "links": links,
}  # name of the file -> function; it returns None if the runs have nothing to show
