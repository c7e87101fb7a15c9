"""Draws the pictures of docs/algorithms.md from runs of the built-in fleets, and prints its table of rounds.

python docs/figures/algorithms.py [NAME ...]        # default: all; into docs/images
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from agentd.figures.style import BLUE, GREEN, GREY, INK, ORANGE, PINK, RED, SKY, STYLE
from dcf_zenoh import simulate
from dcf_zenoh.algorithms.algorithm import Algorithm
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import load
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.records.run import Run
from dcf_zenoh.rounds.dialogue import RoundRecord
from dcf_zenoh.testing import fleet_of, lockstep

DOCS = Path(__file__).resolve().parents[1]
FLOOR = 1e-12  # below it is rounding
NO_END = "exchange.threshold=0"

Line = tuple[str, str, str, Array]  # label, colour, dashes, error after each round


def errors(run: Run, answer: Sequence[float] | None = None) -> Array:
    """Largest distance of any agent's decision to its answer (by default the mean of the last ones), round by round."""
    rounds = [[RoundRecord(*record).noted for record in log.rounds_log[0]] for log in run.agents.values()]
    paths = np.array([[np.ravel(noted["x" if "x" in noted else "u"]) for noted in each] for each in rounds])
    ends = paths[:, -1].mean(axis=0)[np.newaxis] if answer is None else np.reshape(answer, (len(paths), -1))
    gaps: Array = abs(paths - ends[:, np.newaxis]).max(axis=(0, 2))
    return gaps


def measured(
    fleet: str, algorithm: str, answer: Sequence[float], rounds: int, *changes: str, topology: str | None = None
) -> Array:
    """The errors of a built-in fleet over so many rounds."""
    run = simulate(
        fleet, algorithm=algorithm, topology=topology, changes=[f"exchange.max_rounds={rounds}", NO_END, *changes]
    )
    return errors(run, answer)


def panel(axes: Axes, lines: Sequence[Line], title: str, *, legend: bool = True) -> None:
    """Errors over rounds."""
    for label, colour, dashes, gaps in lines:
        shown = np.where(gaps > FLOOR, gaps, np.nan)
        axes.plot(np.arange(1, len(gaps) + 1), shown, dashes, color=colour, linewidth=1.7, label=label)
    axes.set_yscale("log")
    axes.set(xlabel="round", title=title)
    if legend:
        axes.legend(fontsize=8.5, labelspacing=0.3, handlelength=2.2)


ONE = [1.0] * 4


def consensus() -> Figure:
    """Four agents on a path agree on the least sum of squares, without and with lost messages."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 5.0), sharey=True, layout="constrained")
    methods = [
        ("subgradient, steps 0.5 / (k + 1)", GREY, "-", "subgradient", ()),
        ("subgradient, steps 0.04", GREY, "--", "subgradient", ("algorithm.step=0.04", "algorithm.decay=0.0")),
        ("dual decomposition", PINK, "-", "dual_decomposition", ("algorithm.step=0.2",)),
        ("gradient tracking", BLUE, "-", "gradient_tracking", ()),
        ("push-pull", SKY, "-", "push_pull", ()),
        ("EXTRA", ORANGE, "-.", "extra", ()),
        ("exact diffusion", ORANGE, "--", "exact_diffusion", ()),
        ("ADMM-tracking gradient", BLUE, ":", "admm_tracking_gradient", ()),
        ("consensus ADMM", GREEN, "-", "consensus_admm", ()),
        ("edge ADMM", GREEN, ":", "edge_admm", ()),
    ]
    lines = [
        (label, colour, dashes, measured("quadratic", name, ONE, 260, *changes))
        for label, colour, dashes, name, changes in methods
    ]
    panel(left, lines, "no losses", legend=False)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)
    lossy = ("faults.loss=0.5", "exchange.round_timeout=0.001")
    bearing = ("dual_decomposition", "admm_tracking_gradient", "edge_admm")
    chosen = [each for each in methods if each[3] in (*bearing, "gradient_tracking", "extra", "consensus_admm")]
    lines = [
        (label, colour, dashes, measured("quadratic", name, ONE, 260, *changes, *lossy))
        for label, colour, dashes, name, changes in chosen
    ]
    panel(right, lines, "every link loses half of all messages", legend=False)
    left.set_ylabel("largest error of any agent")
    left.set_ylim(FLOOR / 2, 20)
    return figure


def sharing() -> Figure:
    """Shared constraints: an allocation, and a market with a capacity."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    allocated = [4.0, 3.0, 1.5, 1.5]
    panel(
        left,
        [
            ("tracking-ADMM", GREEN, "-", measured("allocation", "tracking_admm", allocated, 1000)),
            (
                "dual subgradient, steps 1 / (k + 1)^0.7",
                GREY,
                "-",
                measured("allocation", "dual_subgradient", allocated, 1000),
            ),
            (
                "dual subgradient, steps 0.05",
                GREY,
                "--",
                measured(
                    "allocation", "dual_subgradient", allocated, 1000, "algorithm.step=0.05", "algorithm.decay=0.0"
                ),
            ),
        ],
        "allocation, on a ring",
    )
    capped = [7 / 3, 4 / 3, 1 / 3, 0.0]
    lossy = ("faults.loss=0.5", "exchange.round_timeout=0.001")
    panel(
        right,
        [
            ("TRADES, adapt then combine", BLUE, "-", measured("cournot", "trades", capped, 1000)),
            (
                "TRADES, combine then adapt",
                BLUE,
                "--",
                measured("cournot", "trades", capped, 1000, "algorithm.order=combine_then_adapt"),
            ),
            ("robust TRADES", GREEN, "-", measured("cournot", "trades_robust", capped, 1000)),
            (
                "robust TRADES, half of all messages lost",
                GREEN,
                ":",
                measured("cournot", "trades_robust", capped, 1000, *lossy),
            ),
            ("TRADES, half of all messages lost", RED, ":", measured("cournot", "trades", capped, 1000, *lossy)),
        ],
        "market with a capacity, on a ring",
    )
    left.set_ylabel("largest error of any agent")
    left.set_ylim(FLOOR / 2, 20)
    return figure


def games() -> Figure:
    """A market without a capacity, and the mean of values on a directed ring."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    nash = [3.0, 2.0, 1.0, 0.0]
    free = "problem={kind='cournot'}"
    panel(
        left,
        [
            (
                "all actions seen, complete graph",
                BLUE,
                "-",
                measured("cournot", "pseudo_gradient", nash, 700, free, topology="complete"),
            ),
            ("primal TRADES, ring", GREEN, "-", measured("cournot", "trades_primal", nash, 700, free)),
            (
                "primal TRADES, path",
                GREEN,
                "--",
                measured("cournot", "trades_primal", nash, 700, free, topology="path"),
            ),
            ("actions estimated, ring", ORANGE, "-", measured("cournot", "pseudo_gradient_partial", nash, 700, free)),
            (
                "actions estimated, path",
                ORANGE,
                "--",
                measured("cournot", "pseudo_gradient_partial", nash, 700, free, topology="path"),
            ),
        ],
        "market without a capacity",
    )
    directed = ("topology.kind=ring", "topology.directed=true")
    panel(
        right,
        [
            ("push-sum: a mean", BLUE, "-", measured("directed", "push_sum", [4.0] * 5, 250)),
            (
                "push-pull: a least sum, weights 'uniform'",
                SKY,
                "-",
                measured("quadratic", "push_pull", ONE, 250, *directed, "algorithm.step=0.05"),
            ),
            (
                "push-pull, weights 'uneven'",
                SKY,
                "--",
                measured(
                    "quadratic", "push_pull", ONE, 250, *directed, "topology.weights=uneven", "algorithm.step=0.05"
                ),
            ),
        ],
        "directed rings",
    )
    left.set_ylabel("largest error of any agent")
    left.set_ylim(FLOOR / 2, 20)
    return figure


def of_one_step(algorithm: str, topology: str, fleet: str, rounds: int, *changes: str) -> tuple[Array, Array]:
    """A fleet's first control step: what each agent decides, round by round, shape (agents, rounds, n), and at last."""
    run = simulate(
        fleet,
        algorithm=algorithm,
        topology=topology,
        changes=["time.duration=0.2", f"exchange.max_rounds={rounds}", NO_END, "log.rounds=true", *changes],
    )
    records = [[RoundRecord(*record).noted for record in log.rounds_log[0]] for log in run.agents.values()]
    paths = np.array([[np.ravel(noted["u"]) for noted in each if "u" in noted] for each in records])
    return paths, np.array([log.decision[0] for log in run.agents.values()])


CROWDED = [  # agents of a swap in the middle of their way
    *(
        f"agents.{i}.start={place}"
        for i, place in ((1, [0.1, 0.6]), (2, [-0.1, -0.6]), (3, [0.8, 0.1]), (4, [-0.8, 0]))
    ),
]


def predictive() -> Figure:
    """One control step of the swap, by ADMM and by SQP with an inner ADMM."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), sharey=True, layout="constrained")
    kinds = {"complete": (BLUE, "-"), "ring": (GREEN, "-"), "star": (ORANGE, "-"), "path": (PINK, "-")}
    _, central = of_one_step("centralised", "complete", "position_swap", 6, *CROWDED)
    lines = [
        (f"ADMM, {kind}", *style, abs(of_one_step("admm_mpc", kind, "position_swap", 350, *CROWDED)[0]
                                      - central[:, np.newaxis]).max(axis=(0, 2)))
        for kind, style in kinds.items()
    ]  # fmt: skip
    trades = of_one_step("trades", "complete", "position_swap", 350, *CROWDED)[0]
    lines.append(("TRADES, complete", GREY, "--", abs(trades - central[:, np.newaxis]).max(axis=(0, 2))))
    panel(left, lines, "position_swap: linear constraints")
    lines = []
    for kind, style in kinds.items():
        _, end = of_one_step("sqp_admm", kind, "distance_swap", 900, *CROWDED)
        paths, _ = of_one_step("sqp_admm", kind, "distance_swap", 350, *CROWDED)
        lines.append((f"SQP with ADMM, {kind}", *style, abs(paths - end[:, np.newaxis]).max(axis=(0, 2))))
    panel(right, lines, "distance_swap: constraints that are not linear")
    left.set_ylabel("largest error of any agent, m/s²")
    left.set_ylim(FLOOR / 2, 20)
    return figure


METHODS: dict[str, Mapping[str, float]] = {
    "gradient_tracking": {"step": 0.1},
    "push_pull": {"step": 0.1},
    "extra": {"step": 0.2},
    "exact_diffusion": {"step": 0.2},
    "dual_decomposition": {"step": 0.1},
    "consensus_admm": {"penalty": 1.0},
    "edge_admm": {"penalty": 1.0},
    "admm_tracking_gradient": {},
}
GRAPHS: dict[str, tuple[str, dict[str, object]]] = {
    "complete": ("complete", {}),
    "Erdős-Rényi, 0.5": ("erdos_renyi", {"probability": 0.5}),
    "4-regular": ("regular", {"degree": 4}),
    "geometric, 0.5": ("geometric", {"radius": 0.5}),
    "grid 2 x 5": ("grid", {}),
    "star": ("star", {}),
    "ring": ("ring", {}),
    "path": ("path", {}),
}
SEEDS, AGENTS, WITHIN = range(5), tuple(range(1, 11)), 1e-6


def rounds_needed(name: str, graph: Graph, seed: int) -> float:
    """Rounds until all of ten agents are within 1e-6 of the least sum of random squares; infinite if not in 5000."""
    rng = np.random.default_rng(seed)
    weights, centres = rng.uniform(1, 4, len(AGENTS)), rng.normal(size=len(AGENTS))
    answer = float(weights @ centres / weights.sum())
    problems = {
        i: Quadratic(centre=float(c), weight=float(w)) for i, w, c in zip(AGENTS, weights, centres, strict=True)
    }
    fleet = fleet_of(graph)
    algorithm: Algorithm = partial(load("algorithms", name, Path()), **METHODS[name])
    needed = np.inf

    def near(number: int, _residuals: Mapping[int, float]) -> bool:
        nonlocal needed
        if number and all(abs(float(me.noted["x"][0]) - answer) < WITHIN for me in fleet.values()):
            needed = number
        return bool(np.isfinite(needed))

    lockstep(algorithm, problems, fleet, 5000, after_round=near)
    return needed


def graphs() -> Figure:
    """How many rounds each method needs on which graph; also printed as a table."""
    table = np.zeros((len(METHODS), len(GRAPHS)))
    for column, (kind, options) in enumerate(GRAPHS.values()):
        topology = load("topologies", kind, Path())
        random = kind in ("erdos_renyi", "regular", "geometric")
        drawn = [Graph.of(AGENTS, topology(AGENTS, **options, **({"seed": seed} if random else {}))) for seed in SEEDS]
        for row, name in enumerate(METHODS):
            table[row, column] = np.median(
                [rounds_needed(name, graph, seed) for seed, graph in zip(SEEDS, drawn, strict=True)]
            )
    print("| | " + " | ".join(GRAPHS) + " |\n" + "|---" * (len(GRAPHS) + 1) + "|")
    for name, row in zip(METHODS, table, strict=True):
        print(f"| `{name}` | " + " | ".join(f"{value:.0f}" for value in row) + " |")
    figure, axes = plt.subplots(figsize=(9.2, 4.0), layout="constrained")
    image = axes.imshow(np.log10(table), cmap="viridis_r", aspect="auto")
    for row in range(len(METHODS)):
        for column in range(len(GRAPHS)):
            value = table[row, column]
            dark = np.log10(value) > np.log10(table[np.isfinite(table)]).mean()
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", color="white" if dark else INK, fontsize=9)
    axes.set_xticks(range(len(GRAPHS)), [name.replace(", ", "\n") for name in GRAPHS], fontsize=9)
    axes.set_yticks(range(len(METHODS)), list(METHODS), fontsize=9)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    figure.colorbar(image, ticks=[1, 2, 3], label="rounds", pad=0.02).set_ticklabels(["10", "100", "1000"])
    return figure


def flights() -> Figure:
    """Four point masses meet; four others make a square that follows its leader."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 4.2), width_ratios=(1, 1.5), layout="constrained")
    for axes, fleet in ((left, "rendezvous"), (right, "formation")):
        run = simulate(fleet)
        for place, colour in enumerate((BLUE, ORANGE, GREEN, PINK)):
            path = run.positions[:, place]
            axes.plot(*path.T, color=colour, linewidth=1.7)
            axes.plot(*path[0], "o", color=colour, markersize=7)
            axes.plot(*path[-1], "s", color=colour, markersize=6, markeredgecolor=INK)
        if fleet == "formation":
            for step in (0, 10, 20, 35, run.steps - 1):
                corners = run.positions[step][[0, 2, 1, 3, 0]]
                axes.plot(*corners.T, color=GREY, linewidth=0.9, linestyle=":")
        axes.set(xlabel="x (m)", title=f"{fleet}, arrived after {run.arrival_time:.1f} s")
        axes.set_aspect("equal", adjustable="datalim")
    left.set_ylabel("y (m)")
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    each.__name__: each for each in (consensus, sharing, games, predictive, graphs, flights)
}


def main() -> None:
    """Draw what is named on the command line, or all."""
    with plt.rc_context(STYLE):
        for name in sys.argv[1:] or PICTURES:
            figure = PICTURES[name]()
            path = DOCS / "images" / f"algorithms_{name}.png"
            drawn = BytesIO()
            figure.savefig(drawn, dpi=110, bbox_inches="tight")
            Image.open(drawn).convert("RGB").quantize(256).save(path, optimize=True)
            plt.close(figure)
            print(f"{path.relative_to(DOCS.parent)}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
