"""Draws the pictures of docs/plants.md from real flights, and prints the numbers that the text names.

python docs/figures/bodies.py [NAME ...]        # default: all; into docs/images
"""

from collections.abc import Callable
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from pictures import draw

from agentd.figures.style import BLUE, GREEN, GREY, ORANGE
from agentd.figures.trajectories import draw_paths, limits, paths_key
from dcf_zenoh import simulate
from dcf_zenoh.analysis.metrics import overshoot
from dcf_zenoh.plant import Array, Setpoint
from dcf_zenoh.records.run import Run
from plants.crazyflie.options import FlightOptions, Reference, lead_of
from plants.crazyflie.simulated import Crazyflie

REFERENCES: tuple[Reference, ...] = ("velocity", "lead", "planned", "integrated", "position")
MS = 1_000_000  # ns
SAMPLE_TIME = 0.2  # s
LATE = 0.1  # s from the measurement until the setpoint acts, as where rounds take time
PUSH = np.repeat([1.0, 0.0, -1.0, 0.0], 5)  # m/s², in each sample
ROUND = "exchange.compute_time=0.001"  # s


def pushed(kind: Reference) -> tuple[Array, Array, Array]:
    """One Crazyflie under `PUSH` along x, its setpoints made as a receding horizon makes them.

    Returns:
        Position and velocity along x in every ms from the first measurement on, shape (K,), m and m/s; and what it was
        told in each sample: a velocity, or with "position" a position.
    """
    body = Crazyflie(
        np.zeros(2), SAMPLE_TIME, np.random.Generator(np.random.Philox(1)), flight=FlightOptions(reference=kind)
    )
    body.prepare()
    body.start(0)
    path, told, last = [], [], 0.0
    late, whole = round(LATE * 1e3), round(SAMPLE_TIME * 1e3)
    for step, a in enumerate(PUSH):
        begin = step * whole
        measured = body.sense(begin * MS)
        ahead = measured.position[0] + measured.velocity[0] * SAMPLE_TIME + a * SAMPLE_TIME**2 / 2
        planned = measured.velocity[0] + a * SAMPLE_TIME
        path += [body.sense((begin + tick) * MS).vector for tick in range(late)]
        acting = body.sense((begin + late) * MS)
        last = (last if kind == "integrated" and step else acting.velocity[0]) + a * lead_of(kind, SAMPLE_TIME)
        told.append({"planned": planned, "position": ahead}.get(kind, last))
        body.act(Setpoint(np.array([ahead, 0.0]), np.array([planned, 0.0]), np.array([a, 0.0])), (begin + late) * MS)
        path += [body.sense((begin + tick) * MS).vector for tick in range(late, whole)]
    states = np.array(path)
    return states[:, 0], states[:, 3], np.array(told)


def reference(kind: Reference) -> Figure:
    """One Crazyflie pushed, and four that change places."""
    position, velocity, told = pushed(kind)
    run = swap(f"plants.twin.flight.reference={kind}", ROUND)
    time = np.arange(len(position)) * 1e-3
    push = np.concatenate((np.zeros(round(LATE * 1e3)), np.repeat(PUSH, round(SAMPLE_TIME * 1e3))))
    ideal = np.cumsum(push[: len(time)]) * 1e-3
    acts = np.arange(len(told)) * SAMPLE_TIME + LATE
    figure = plt.figure(figsize=(10.5, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1))
    above = figure.add_subplot(grid[0, 0])
    below = figure.add_subplot(grid[1, 0], sharex=above)
    paths = figure.add_subplot(grid[:, 1])
    for axes, wanted, flown in ((above, ideal, velocity), (below, np.cumsum(ideal) * 1e-3, position)):
        (dashed,) = axes.plot(time, wanted, "--", color=GREY, lw=1.5)
        (solid,) = axes.plot(time, flown, color=BLUE, lw=2)
    axes = below if kind == "position" else above
    (steps,) = axes.step([*acts, time[-1]], [*told, told[-1]], where="post", color=ORANGE, lw=1.5)
    axes.plot(acts, told, ".", color=ORANGE, ms=5)
    above.set(ylabel="velocity in m/s")
    below.set(xlabel="time in s", ylabel="position in m", xlim=(0, 4))
    below.legend([dashed, solid, steps], ["double integrator", "flown", "told"], fontsize=8.5,
                 loc="upper left" if kind == "position" else "lower right")  # fmt: skip
    for begin, a in zip((LATE, 1 + LATE, 2 + LATE, 3 + LATE), ("1", "0", "−1", "0"), strict=True):
        place = (begin + 0.45, 1.0)
        above.annotate(
            f"a = {a} m/s²", place, xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=8.5
        )
    draw_paths(paths, run, f'reference = "{kind}"\n{outcome(run)}')
    paths.set_ylabel("y in m")
    met = (velocity[round((LATE + SAMPLE_TIME) * 1e3)] - velocity[round(LATE * 1e3)]) / (PUSH[0] * SAMPLE_TIME)
    print(
        f"{kind}: of the first change of velocity {100 * met:.0f} % is met after {SAMPLE_TIME:g} s;"
        f" {velocity[round((1 + LATE) * 1e3)]:.2f} m/s after 1 s at 1 m/s², {velocity[-1]:.2f} m/s and"
        f" {position[-1]:.2f} m at the end (a double integrator: 1, 0 m/s, {np.sum(ideal) * 1e-3:.2f} m)"
    )
    print(f"    swap, rounds of 1 ms: {outcome(run)}, fastest {speed(run):.2f} m/s")
    print(f"    swap, rounds in no time: {outcome(swap(f'plants.twin.flight.reference={kind}'))}")
    return figure


def swap(*changes: str, plant: str = "twin") -> Run:
    """The four of `position_swap`."""
    return simulate("position_swap", plant=plant, changes=changes)


def outcome(run: Run) -> str:
    """Arrival, overshoot, closest approach, in words."""
    arrival = "not in 25 s" if run.arrival_time is None else f"arrived at {run.arrival_time:.1f} s"
    return f"{arrival}, overshoot {100 * (overshoot(run) or 0.0):.1f} cm, closest {run.distances.min():.3f} m"


def speed(run: Run) -> float:
    """The greatest of any agent at the samples, in the plane, m/s."""
    velocities = [log.state[:, log.state.shape[1] // 2 :][:, :2] for log in run.agents.values()]
    return float(max(np.linalg.norm(each, axis=1).max() for each in velocities))


def met(run: Run) -> float:
    """How much of the change of velocity that was planned for a sample came about in it: slope of a fit to all."""
    asked, came = [], []
    for log in run.agents.values():
        half = log.state.shape[1] // 2
        asked.append(log.setpoint[:-1, -2:] * SAMPLE_TIME)
        came.append(np.diff(log.state[:, half : half + 2], axis=0))
    wanted, found = np.concatenate(asked), np.concatenate(came)
    return float(np.sum(wanted * found) / np.sum(wanted**2))


def swaps() -> Figure:
    """Point masses, Crazyflies, and Crazyflies with Lighthouse in wind."""
    runs = {
        "point mass": swap(plant="point"),
        "Crazyflie": swap(),
        "Crazyflie, Lighthouse, wind": swap(
            'plants.twin.sensing="lighthouse"', "plants.twin.wind={mean=[0.2, 0.1], gusts=0.1}"
        ),
    }
    figure = plt.figure(figsize=(11, 7.6), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.55, 1))
    panels = above.subplots(1, 3, sharex=True, sharey=True)
    corners = [limits(run) for run in runs.values()]
    low, high = np.min([each[0] for each in corners], axis=0), np.max([each[1] for each in corners], axis=0)
    panels[0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), ylabel="y in m")
    for axes, (name, run) in zip(panels, runs.items(), strict=True):
        arrival = "did not arrive" if run.arrival_time is None else f"arrived at {run.arrival_time:.1f} s"
        draw_paths(axes, run, f"{name}\n{arrival}, overshoot {100 * (overshoot(run) or 0.0):.1f} cm")
        print(f"{name}: {outcome(run)}, least h {run.barriers.min():.3f}, fastest {speed(run):.2f} m/s, "
              f"{100 * met(run):.0f} % of a t_s met within a sample")  # fmt: skip
    above.legend(handles=paths_key(list(runs.values())), loc="outside lower center", ncols=4)
    distance, moving = below.subplots(1, 2)
    for (name, run), colour, dashes in zip(runs.items(), (GREY, BLUE, ORANGE), ("--", "-", "-."), strict=True):
        _distance(distance, run, color=colour, linestyle=dashes, label=name)
        moving.plot(run.time, run.agents[1].state[: run.steps, run.agents[1].state.shape[1] // 2 + 1], color=colour,
                    linestyle=dashes, lw=1.8)  # fmt: skip
    distance.axhline(5, color=GREEN, lw=1.2, ls=":")
    distance.annotate("arrived: 5 cm", (0, 5), xytext=(4, 3), textcoords="offset points", color=GREEN, fontsize=9)
    distance.set(xlabel="time in s", ylabel="farthest from its target, in cm", yscale="log")
    distance.yaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
    moving.set(xlabel="time in s", ylabel="agent 1: velocity along y, in m/s")
    distance.legend(loc="lower left", fontsize=9)
    return figure


def _distance(axes: Axes, run: Run, **style: object) -> None:
    goals = np.stack([run.targets[i][:2] for i in run.agents])
    far = np.linalg.norm(run.positions[..., :2] - goals, axis=2).max(axis=1)
    axes.plot(run.time, 100 * far, lw=1.8, **style)


PICTURES: dict[str, Callable[[], Figure]] = {
    **{f"reference_{kind}": partial(reference, kind) for kind in REFERENCES},
    "swaps": swaps,
}

if __name__ == "__main__":
    draw("plants", PICTURES)
