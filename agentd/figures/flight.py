"""Animation of a flight."""

from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from agentd.figures.style import INK, agent_style, flies, heading
from agentd.figures.trajectories import limits
from dcf_zenoh.records.run import Run

_FRAMES = 150  # most pictures of an animation
_RATE = 20  # most pictures per s
_DPI = 80
_LAST = 1.0  # s, duration of the last picture


def write_flight(run: Run, path: Path) -> bool:
    """Write a GIF of the flight, in real time if that takes few enough pictures; return False if nothing flies.

    Raises:
        OSError: The file cannot be written.
    """
    flown = {agent: log for agent, log in run.agents.items() if flies(log)}
    if not flown:
        return False
    figure = Figure(figsize=(5.4, 5.8), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    low, high = limits(run)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x in m", ylabel="y in m")
    bodies = []
    for place, (agent, log) in enumerate(run.agents.items()):
        if agent not in flown:
            continue
        style = agent_style(place)
        if agent in run.targets:
            axes.plot(*run.targets[agent][:2], "x", color=INK, markersize=8, zorder=2)
        (trail,) = axes.plot([], [], linewidth=1.5, **style)
        (body,) = axes.plot([], [], "o", color=style["color"], markersize=7)
        region = Polygon(np.zeros((1, 2)), closed=True, facecolor=style["color"], alpha=0.15, visible=False)
        axes.add_patch(region)
        bodies.append((agent, log.path, trail, body, region))
    title = axes.set_title(f"{heading(run)}\n")
    sample_time = run.fleet.time.sample_time
    length = max(len(path) for _, path, *_ in bodies)
    stride = max(1, -(-length // _FRAMES), round(1 / (_RATE * sample_time)))
    writer = PillowWriter(fps=max(1, round(1 / (stride * sample_time))))
    with writer.saving(figure, str(path), _DPI):
        instants = [*range(0, length - 1, stride), *[length - 1] * max(1, round(_LAST * writer.fps))]
        for instant in instants:
            for agent, way, trail, body, region in bodies:
                here = way[: instant + 1]
                trail.set_data(here[:, 0], here[:, 1])
                body.set_data(here[-1:, 0], here[-1:, 1])
                corners = run.geometry.outline(agent, here[-1])
                if corners is not None:
                    region.set(xy=corners, visible=True)
            title.set_text(f"{heading(run)}\n{instant * sample_time:.1f} s")
            writer.grab_frame()
            figure.set_layout_engine("none")  # keep the layout of the first picture
    return True
