"""Draws the pictures of docs/faults.md from real links and real runs.

python docs/figures/faults.py [NAME ...]        # default: all; into docs/images
"""

import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pictures import DOCS, draw

from agentd.figures.style import BLUE, GREEN, GREY, INK, ORANGE, RED
from dcf_zenoh import simulate
from dcf_zenoh.faults.bandwidth import Bandwidth
from dcf_zenoh.faults.bursts import Bursts
from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer, Passage
from dcf_zenoh.faults.fault import Fault, FaultLink
from dcf_zenoh.faults.latency import Latency
from dcf_zenoh.faults.loss import Loss
from dcf_zenoh.faults.noise import Noise
from dcf_zenoh.faults.quantisation import Quantisation
from dcf_zenoh.faults.tampering import Tampering
from dcf_zenoh.message import Last, Message, canonical
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.plant import Array
from dcf_zenoh.records.run import Run
from dcf_zenoh.rounds.receiver import Passed

MS = 1_000_000  # ns
SEED = 32

PAIR = """
name = "pair"
seed = 5

[exchange]
mode = "{mode}"
max_rounds = 10
round_timeout = 0.006
period = 0.005
jitter = 0.0015
compute_time = 0.001
threshold = 0

[problem]
kind = "average"
value = 1.0

[algorithm]
kind = "average_consensus"

[agents.1]

[agents.2]
exchange.period = 0.008

[faults]
latency = {{ distribution = "gamma", mean = 0.002, std = 0.001 }}
loss = 0.25
"""


def convey(fault: Fault, entering: Sequence[int], values: Array | None = None) -> list[Passage]:
    """Lead one message after the other over a link with one fault; `entering` in ns."""
    link = FaultChain(SEED, 1, 2, [Layer("fault", [(ALWAYS, fault)])])
    passages = []
    for number, entered in enumerate(entering):
        payload = canonical({"x": np.array([0.0 if values is None else values[number]])})
        message = Message(1, 0, number, 0, number, entered, -1, -1, 0, Last.NO, (1.0,), (), payload)
        passages.append(link.convey(Delivery(message, entered, entered)))
    return passages


def loss() -> Figure:
    """Which messages get lost, one by one."""
    kinds = {
        "loss = 0.2": Loss(probability=0.2),
        "bursts, mean_loss = 0.2,\nmean_length = 5": Bursts(mean_loss=0.2, mean_length=5),
        "bursts, good_to_bad = 0.05,\nbad_to_good = 0.1,\nloss_good = 0.02, loss_bad = 0.6": Bursts(
            good_to_bad=0.05, bad_to_good=0.1, loss_good=0.02, loss_bad=0.6
        ),
    }
    figure, axes = plt.subplots(figsize=(8, 2.5))
    for row, fault in enumerate(kinds.values()):
        came = np.array([bool(passage.deliveries) for passage in convey(fault, range(200))])
        axes.broken_barh([(0, len(came))], (-row - 0.35, 0.7), color="#c9d6df")
        axes.broken_barh([(float(k), 1.0) for k in np.flatnonzero(~came)], (-row - 0.35, 0.7), color=RED)
        axes.text(201, -row, f"{100 * (~came).mean():.0f} % lost", va="center", fontsize=9, color=INK)
    axes.set_yticks([-row for row in range(len(kinds))], kinds, fontsize=9)
    axes.set(xlim=(-2, 200), xlabel="message of one link; red: lost")
    axes.grid(visible=False)
    axes.spines[["left", "bottom"]].set_visible(False)
    return figure


def latency() -> Figure:
    """How latencies are distributed; messages that overtake each other."""
    made: dict[str, tuple[Latency, str]] = {
        "uniform, 5 to 15 ms": (_latency(distribution="uniform", low=0.005, high=0.015), BLUE),
        "normal, mean 10, std 3 ms": (_latency(distribution="normal", mean=0.010, std=0.003), GREEN),
        "gamma, mean 10, std 6 ms": (_latency(distribution="gamma", mean=0.010, std=0.006), ORANGE),
    }
    figure, (left, *right) = plt.subplots(1, 3, figsize=(8.5, 2.9), width_ratios=(1.5, 1, 1), layout="constrained")
    for label, (fault, colour) in made.items():
        took = [passage.deliveries[0].due * 1e-6 for passage in convey(fault, [0] * 20_000)]
        left.hist(took, bins=np.arange(0, 36, 0.75), histtype="step", density=True, color=colour, lw=1.6, label=label)
    left.axvline(10, color=INK, ls=":", lw=1.4, label="constant, 10 ms")
    left.set(xlabel="latency (ms)", ylabel="density (1/ms)", xlim=(0, 36), ylim=(0, 0.23))
    left.legend(loc="upper right", fontsize=8, labelspacing=0.3)
    for axes, reorder in zip(right, (True, False), strict=True):
        sent = range(0, 60 * MS, 4 * MS)
        passages = convey(_latency(distribution="gamma", mean=0.010, std=0.006, reorder=reorder), sent)
        due = [passage.deliveries[0].due for passage in passages]
        for number, (start, end) in enumerate(zip(sent, due, strict=True)):
            overtakes = any(end < earlier for earlier in due[:number])
            axes.plot([start / MS, end / MS], [1, 0], color=RED if overtakes else BLUE, lw=1.2)
        axes.set_title(f"reorder = {str(reorder).lower()}", fontsize=10)
        axes.set(xlabel="time (ms)", xlim=(0, 80), ylim=(-0.05, 1.05))
        axes.set_yticks([0, 1], ["there", "sent"] if reorder else ["", ""])
        axes.grid(visible=False, axis="y")
    return figure


def _latency(**keys: object) -> Latency:
    return Latency(FaultLink(1, 2, Path()), **keys)  # type: ignore[arg-type]


def bandwidth() -> Figure:
    """What enters a link in crowds and leaves it at its own pace."""
    entering = [step * 100 * MS + k * MS for step in range(4) for k in range((15, 40, 60, 15)[step])]
    passages = convey(Bandwidth(rate=20_000, burst=600, queue=900), entering)
    size = Delivery(
        Message(1, 0, 99, 0, 99, MS, -1, -1, 0, Last.NO, (1.0,), (), canonical({"x": np.zeros(1)})), 0, 0
    ).size
    pairs = list(zip(entering, passages, strict=True))
    left = sorted(passage.deliveries[0].due / MS for _, passage in pairs if passage.deliveries)
    lost = [(place, entered / MS) for place, (entered, passage) in enumerate(pairs) if not passage.deliveries]
    figure, axes = plt.subplots(figsize=(8, 2.9))
    total = size * np.arange(1, len(entering) + 1) / 1000
    axes.step([each / MS for each in entering], total, where="post", color=GREY, lw=1.6, label="entered")
    places, times = zip(*lost, strict=True)
    axes.plot(times, total[list(places)], "x", color=RED, ms=4, label="lost: no room in the queue")
    axes.step(left, size * np.arange(1, len(left) + 1) / 1000, where="post", color=BLUE, lw=1.8, label="left")
    axes.annotate("slope: rate", (270, 4.62), (285, 3.4), color=BLUE, arrowprops={"arrowstyle": "-", "color": BLUE})
    axes.set(xlabel="time (ms)", ylabel="together (kB)", xlim=(0, 350), ylim=(0, None))
    axes.legend(loc="upper left")
    return figure


def payload() -> Figure:
    """One number of a payload as it is, and as it is received."""
    time = np.linspace(0, 1, 60)
    truth = np.sin(2 * np.pi * time) + 0.4 * time
    kinds: dict[str, Fault] = {
        "noise = 0.15": Noise(std=0.15),
        "quantisation = 0.5": Quantisation(step=0.5),
        "tampering:\nscale 0.5, offset 0.5": Tampering(scale=0.5, offset=0.5),
        "tampering:\nfreeze, from 0.25 s on": Tampering(freeze=True),
    }
    figure, row = plt.subplots(1, 4, figsize=(8, 2.3), sharey=True)
    for axes, (title, fault) in zip(row, kinds.items(), strict=True):
        begin = 15 if "freeze" in title else 0
        arrived = [
            float(np.ravel(passage.deliveries[0].message.payload["x"])[0])
            for passage in convey(fault, range(60 - begin), truth[begin:])
        ]
        axes.plot(time, truth, color=GREY, lw=1.2, label="sent")
        axes.plot(time, [*truth[:begin], *arrived], ".", ms=3.5, color=RED, label="received")
        axes.set_title(title, fontsize=9)
        axes.set(xlabel="time (s)")
    row[0].legend(loc="lower left", fontsize=8, handletextpad=0.2)
    return figure


def rounds() -> Figure:
    """Two agents and their messages, synchronous and asynchronous."""
    figure, pair = plt.subplots(2, 1, figsize=(8, 4.4), sharex=True)
    with TemporaryDirectory() as folder:
        for axes, mode in zip(pair, ("synchronous", "asynchronous"), strict=True):
            path = Path(folder) / f"{mode}.toml"
            path.write_text(PAIR.format(mode=mode), encoding="utf-8")
            _weave(axes, simulate(path, out=Path(folder) / mode))
            axes.set_title(f"{mode}", loc="left", fontsize=10)
    handles = [
        Line2D([], [], color=BLUE, label="message"),
        Line2D([], [], color=RED, ls=":", marker="x", label="lost"),
        Line2D([], [], color=INK, ls="", marker="o", ms=5, label="agent speaks"),
        Line2D([], [], color=GREY, lw=5, alpha=0.5, label="waits"),
    ]
    pair[0].legend(handles=handles, ncols=4, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8.5)
    pair[1].set(xlabel="time (ms)", xlim=(-1, 45))
    return figure


def _weave(axes: Axes, run: Run) -> None:
    """Messages as lines from who sent them, when, to who gets them, when."""
    line = {1: 1.0, 2: 0.0}
    asynchronous = run.fleet.exchange.mode == "asynchronous"
    for receiver, log in run.agents.items():
        passed: list[Passed] = [each for each in log.passed if each.step == 0]
        sender = 3 - receiver
        spoken = [each.entered / MS for each in passed]
        axes.plot(spoken, [line[sender]] * len(spoken), "o", color=INK, ms=5, zorder=3)
        for begin, end in pairwise(spoken):
            if not asynchronous:
                axes.plot([begin, end - 1], [line[sender]] * 2, color=GREY, lw=6, alpha=0.45, solid_capstyle="butt")
        for each in passed:
            begin, (here, there) = each.entered / MS, (line[sender], line[receiver])
            if each.due < 0:
                axes.plot([begin, begin + 0.8], [here, here + 0.4 * (there - here)], ":", color=RED, lw=1.5)
                axes.plot(begin + 0.8, here + 0.4 * (there - here), "x", color=RED, ms=6)
            else:
                axes.plot([begin, each.due / MS], [here, there], color=BLUE, lw=1.3)
    axes.set(ylim=(-0.25, 1.25))
    axes.set_yticks([1, 0], ["agent 1", "agent 2"])
    axes.grid(visible=False, axis="y")


def weather() -> Figure:
    """The share of messages that are missing, link by link and step by step, in the example of docs/faults.md."""
    found = re.search(r"<!-- file: weather.toml -->\n```toml\n(.*?)```", (DOCS / "faults.md").read_text("utf-8"), re.S)
    assert found, "docs/faults.md has no example weather.toml"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "weather.toml"
        path.write_text(found[1], encoding="utf-8")
        run = simulate(path, out=Path(folder) / "run")
    sample_time, ids = run.fleet.time.sample_time, run.fleet.ids
    links = [(i, j) for i in ids for j in ids if i != j]
    share = np.full((len(links), run.steps), np.nan)
    for row, (sender, receiver) in enumerate(links):
        log = run.agents[receiver]
        received, missing = log.links[sender][:, 0], log.links[sender][:, 1]
        there = received + missing > 0
        share[row, log.step[there]] = missing[there] / (received + missing)[there]
    colours = LinearSegmentedColormap.from_list("missing", ["#eef3f6", ORANGE, RED])
    colours.set_bad("#b5b5b5")
    figure, axes = plt.subplots(figsize=(8, 3.9))
    extent = (0, run.steps * sample_time, len(links) - 0.5, -0.5)
    image = axes.imshow(np.ma.masked_invalid(share), aspect="auto", cmap=colours, vmin=0, vmax=1, extent=extent)
    axes.set_yticks(range(len(links)), [f"{i} → {j}" for i, j in links], fontsize=9)
    axes.set(xlabel="time (s)", ylabel="link")
    axes.grid(visible=False)
    for below in (2.5, 5.5, 8.5):
        axes.axhline(below, color="white", lw=2)
    figure.colorbar(image, label="share of messages missing", pad=0.02)
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    each.__name__: each for each in (loss, latency, bandwidth, payload, rounds, weather)
}


if __name__ == "__main__":
    draw("faults", PICTURES)
