import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib._pylab_helpers import Gcf
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Polygon
from PIL import Image
from rich.console import Console

import dcf_zenoh
from agentd.figures import FIGURES
from agentd.figures.convergence import residuals
from agentd.results.report import write_report
from agentd.results.summary import summary_table
from dcf_zenoh import Run
from dcf_zenoh.analysis.link_health import link_health
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.records.log_writer import log_name, read_stream
from tests.support.faulty_runs import named

AVERAGE = """
name = "average"
[topology]
kind = "ring"
[problem]
kind = "average"
[algorithm]
kind = "average_consensus"
[agents.1]
problem.value = 1.0
[agents.2]
problem.value = 4.0
[agents.3]
problem.value = 2.0
[agents.4]
problem.value = 9.0
"""


@pytest.fixture(scope="module")
def swap() -> Run:
    """Four point masses, 15 steps, with a log of rounds."""
    return dcf_zenoh.simulate("position_swap", changes=["time.duration=3.0", "log.rounds=true"])


@pytest.fixture(scope="module")
def average(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Four agents without plants."""
    path = tmp_path_factory.mktemp("average") / "average.toml"
    path.write_text(AVERAGE)
    return dcf_zenoh.simulate(path)


def draw(name: str, *runs: Run) -> Figure:
    figure = FIGURES[name](runs)
    assert figure is not None
    return figure


def texts(axes: Axes) -> str:
    return "\n".join([axes.get_title(), *(text.get_text() for text in axes.texts)])


def legend(axes: Axes) -> list[str]:
    found = axes.get_legend()
    assert found is not None
    return [text.get_text() for text in found.get_texts()]


def boxes(axes: Axes) -> list[PathPatch]:
    return [patch for patch in axes.patches if isinstance(patch, PathPatch)]


def changed(run: Run, agent: int, **values: object) -> Run:
    return replace(run, agents={**run.agents, agent: replace(run.agents[agent], **values)})  # type: ignore[arg-type]


def test_every_figure_is_written_as_png_and_pdf(swap: Run, tmp_path: Path) -> None:
    written = write_report([swap], tmp_path / "new" / "report")
    assert {path.name for path in written} == {
        f"{name}.{ending}"
        for name in ("trajectories", "times", "separation", "convergence")
        for ending in ("png", "pdf")
    }
    starts = {path.suffix: path.read_bytes()[:4] for path in written}
    assert starts == {".png": b"\x89PNG", ".pdf": b"%PDF"}


def test_a_second_report_replaces_the_first(average: Run, tmp_path: Path) -> None:
    assert write_report([average], tmp_path) == write_report([average], tmp_path)


def test_the_gif_shows_every_step_and_is_small(swap: Run, tmp_path: Path) -> None:
    (gif,) = (path for path in write_report([swap], tmp_path, animate=True) if path.suffix == ".gif")
    assert gif.name == "flight.gif"
    assert gif.stat().st_size < 3e6
    with Image.open(gif) as picture:
        assert getattr(picture, "n_frames", 0) >= swap.steps
        assert picture.info["duration"] == 200  # ms, the sample time


def test_each_of_several_runs_has_its_own_gif(swap: Run, average: Run, tmp_path: Path) -> None:
    short = [dcf_zenoh.simulate("position_swap", changes=["time.duration=0.4"])] * 2
    written = write_report([*short, average], tmp_path, animate=True)
    assert [path.name for path in written if path.suffix == ".gif"] == [
        "flight-position_swap-1.gif",
        "flight-position_swap-2.gif",
    ]


def test_a_folder_that_cannot_be_made_is_named(swap: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"file.*: cannot be written: File exists"):
        write_report([swap], tmp_path / "file")


def test_importing_the_report_does_not_import_matplotlib() -> None:
    modules = "agentd.results.report, agentd.results.export, agentd.results.summary"
    code = f"import sys, {modules}; print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "False"


def test_drawing_uses_no_global_figures(swap: Run) -> None:
    draw("trajectories", swap)
    assert not Gcf.get_all_fig_managers()


def test_trajectories_have_equal_axes_units_and_a_telling_title(swap: Run) -> None:
    (axes,) = draw("trajectories", swap).axes
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x in m", "y in m")
    title = axes.get_title()
    assert all(word in title for word in ("position_swap", "complete topology", "virtual clock", "least barrier h ="))
    assert [text.get_text() for text in axes.texts] == ["1", "2", "3", "4"]


def test_paths_are_drawn_as_they_were_recorded(swap: Run) -> None:
    (axes,) = draw("trajectories", swap).axes
    drawn = [line.get_xydata() for line in axes.lines if len(np.asarray(line.get_xdata())) > 1]
    assert len(drawn) == 4
    for line, log in zip(drawn, swap.agents.values(), strict=True):
        np.testing.assert_array_equal(line, log.path)


def test_safety_regions_are_drawn_around_the_positions_of_the_closest_instant(swap: Run) -> None:
    (axes,) = draw("trajectories", swap).axes
    closest = swap.closest("barrier")
    assert closest is not None
    outlines = [patch for patch in axes.patches if isinstance(patch, Polygon) and not patch.get_fill()]
    centres = [outline.get_xy()[:4].mean(axis=0) for outline in outlines]
    np.testing.assert_allclose(
        centres, [motion.at(np.array([closest.time]))[0] for motion in swap.motions.values()], atol=1e-12
    )


def test_runs_side_by_side_have_a_panel_each(swap: Run) -> None:
    runs = [swap, replace(swap, name="again"), replace(swap, name="third"), replace(swap, name="fourth")]
    assert [axes.get_title().split("\n")[0] for axes in draw("trajectories", *runs).axes] == [
        "position_swap", "position_swap, again", "position_swap, third", "position_swap, fourth",
    ]  # fmt: skip
    assert len(draw("separation", *runs).axes) == 3 * 4
    assert len(draw("convergence", *runs).axes) == 4
    assert [len(boxes(axes)) for axes in draw("times", *runs).axes] == [4, 4]


def test_no_panel_cuts_off_what_another_run_needs(swap: Run) -> None:
    busy = changed(swap, 2, rounds=swap.agents[2].rounds + 1000)
    axes = draw("separation", swap, busy).axes[-1]
    assert axes.get_ylim()[1] > 1000


def test_box_plots_state_the_budget_and_say_what_kind_of_time_it_is(swap: Run) -> None:
    negotiation, compute = draw("times", swap).axes
    assert negotiation.get_ylabel() == "time per step in ms, model time"
    assert compute.get_ylabel() == "time per step in ms, real time"
    for axes in (negotiation, compute):
        (segment,) = axes.collections[0].get_paths()
        np.testing.assert_allclose(np.asarray(segment.vertices)[:, 1], 150.0)  # ms, of the fleet file
    clock = swap.fleet.time.model_copy(update={"clock": "wall"})
    wall = replace(swap, fleet=swap.fleet.model_copy(update={"time": clock}))
    assert draw("times", wall).axes[0].get_ylabel() == "time per step in ms"


def test_abstained_steps_are_left_out_of_the_boxes_and_counted(swap: Run) -> None:
    log = swap.agents[3]
    words = (*log.stopped_by[:-2], "abstained", "abstained")
    compute = log.compute.copy()
    compute[-2:] = 5.0
    (axes, beside) = draw("times", changed(swap, 3, stopped_by=words, compute=compute)).axes
    label = axes.get_xticklabels()[0].get_text()
    assert "58 agent-steps" in label
    assert "left out: 2 abstained" in label
    assert "max 5e+03 ms" not in texts(beside)


def test_boxes_span_the_quartiles(swap: Run) -> None:
    (box,) = boxes(draw("times", swap).axes[1])
    every = np.concatenate([log.compute for log in swap.agents.values()]) * 1e3
    heights = np.asarray(box.get_path().vertices)[:, 1]
    np.testing.assert_allclose([heights.min(), heights.max()], np.percentile(every, (25, 75)))


def test_separation_shows_least_values_danger_and_rounds(swap: Run) -> None:
    distance, barrier, rounds = draw("separation", swap).axes
    assert distance.get_ylabel() == "distance in m"
    assert barrier.get_ylabel() == "barrier h"
    assert (rounds.get_xlabel(), rounds.get_ylabel()) == ("time in s", "rounds per step")
    assert f"{swap.summary()['min_distance']:.3f} m at" in texts(distance)
    assert f"{swap.summary()['min_barrier']:.3f} at" in texts(barrier)
    assert "in the safety region,\nh < 0" in legend(barrier)
    assert barrier.get_ylim()[0] < 0
    assert legend(rounds) == ["all agents"]


def test_separation_of_bodies_without_safety_regions_has_distances_and_rounds() -> None:
    run = dcf_zenoh.simulate("rendezvous", changes=["time.duration=0.4"])
    assert [axes.get_ylabel() for axes in draw("separation", run).axes] == ["distance in m", "rounds per step"]


def test_steps_without_agreement_and_late_steps_are_marked(swap: Run) -> None:
    log = swap.agents[1]
    late = log.late.copy()
    late[3] = True
    words = ("budget", "rounds", *log.stopped_by[2:])
    rounds = draw("separation", changed(swap, 1, stopped_by=words, late=late)).axes[-1]
    assert legend(rounds)[1:] == ["out of time", "out of rounds", "deadline missed"]


def test_convergence_needs_a_log_of_rounds(swap: Run, average: Run) -> None:
    assert FIGURES["convergence"]([average]) is None
    (axes,) = draw("convergence", swap).axes
    assert axes.get_yscale() == "log"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("round of the step", "residual")
    words = legend(axes)
    assert "threshold" in words
    assert sum("worst agent" in word for word in words) == 5


def test_residuals_are_taken_from_the_log_and_those_of_sharing_rounds_are_not_numbers(swap: Run) -> None:
    table = residuals(swap)
    assert table.shape == (4, swap.steps, max(log.rounds.max() for log in swap.agents.values()))
    assert np.isnan(table[:, :, 0]).all()  # states are shared in the first round
    for row, log in zip(table, swap.agents.values(), strict=True):
        last = [residual[count - 1] for residual, count in zip(row, log.rounds, strict=True)]
        np.testing.assert_array_equal(last, log.residual)


def test_a_fleet_without_plants_shows_times_and_decisions_alone(average: Run, tmp_path: Path) -> None:
    written = write_report([average], tmp_path, animate=True)
    assert [path.name for path in written] == ["times.png", "times.pdf", "decisions.png", "decisions.pdf"]
    (axes,) = draw("decisions", average).axes
    (line,) = axes.lines
    np.testing.assert_allclose(np.asarray(line.get_ydata()), 4.0, atol=1e-2)
    assert "largest difference" in axes.get_title()


@pytest.mark.parametrize(("agents", "length", "lines"), [(3, 60_000, 3), (40, 20, 1)])
def test_long_decisions_of_many_agents_take_few_lines(average: Run, agents: int, length: int, lines: int) -> None:
    log = average.agents[1]
    chance = np.random.default_rng(1)
    logs = {i: replace(log, agent=i, decision=chance.normal(size=(1, length))) for i in range(agents)}
    (axes,) = draw("decisions", replace(average, agents=logs)).axes
    assert len(axes.lines) == lines
    assert max(len(np.asarray(line.get_xdata())) for line in axes.lines) <= 2000
    values = np.array([each.decision[-1] for each in logs.values()])
    assert f"largest difference {np.ptp(values, axis=0).max():.2g}" in axes.get_title()


def test_a_log_that_breaks_off_is_drawn_as_far_as_it_goes_and_named(tmp_path: Path) -> None:
    dcf_zenoh.simulate("position_swap", changes=["time.duration=2.0"], out=tmp_path / "run")
    path = tmp_path / "run" / log_name(3)
    path.write_bytes(path.read_bytes()[:-700])
    run = Run.read(tmp_path / "run")
    assert 0 < run.common_steps < run.steps == 10
    title = draw("separation", run).axes[0].get_title()
    assert f"incomplete: agent 3 cut off after step {run.common_steps - 1}" in title
    assert write_report([run], tmp_path / "report")


def test_an_agent_without_any_step_leaves_the_others_in_the_picture(tmp_path: Path) -> None:
    dcf_zenoh.simulate("position_swap", changes=["time.duration=1.0"], out=tmp_path / "run")
    path = tmp_path / "run" / log_name(2)
    data = path.read_bytes()
    _, end = next(read_stream(data))
    path.write_bytes(data[: end + 20])
    run = Run.read(tmp_path / "run")
    assert len(run.agents[2].step) == 0
    (axes,) = draw("trajectories", run).axes
    assert "incomplete: agent 2 cut off before step 0" in axes.get_title()
    assert [text.get_text() for text in axes.texts] == ["1", "3", "4"]
    assert write_report([run], tmp_path / "report", animate=True)


def test_an_agent_that_failed_is_drawn_to_its_last_step_and_named(swap: Run) -> None:
    end = {"end": "failed", "time": -1, "state": [], "remark": "it broke", "counts": {}}
    (axes,) = draw("trajectories", changed(swap, 4, end=end)).axes
    assert "incomplete: agent 4 failed after step 14" in axes.get_title()
    assert "incomplete" not in draw("trajectories", swap).axes[0].get_title()


def show(run: Run) -> str:
    console = Console(width=120, color_system=None)
    with console.capture() as capture:
        console.print(summary_table(run.summary()))
    return capture.get()


def test_the_summary_counts_misses_and_how_steps_ended(swap: Run) -> None:
    log = swap.agents[1]
    late = log.late.copy()
    late[3] = True
    text = show(changed(swap, 1, late=late, stopped_by=("budget", "rounds", "abstained", *log.stopped_by[3:])))
    assert "1 of 60 (1.7 %)" in text
    assert "57 by agreement, 1 out of rounds, 1 out of time, 1 abstained" in text
    assert f"{swap.summary()['min_distance']:.3f} m, least barrier {swap.summary()['min_barrier']:.3f}" in text
    assert "not all" in text
    assert "model time" in text


def test_the_summary_of_a_fleet_without_plants_says_nothing_of_flying(average: Run) -> None:
    text = show(average)
    assert "4 without plants" in text
    assert "arrived" not in text
    assert "closest" not in text


@pytest.fixture(scope="module")
def lossy_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Losses and latencies on all links, a partition from 0.4 to 0.8 s, and an agent that dies at 1.5 s."""
    faults = """
[faults]
loss = 0.2
latency = 0.0005
[[faults.rule]]
during = [0.4, 0.8]
partition = [[1, 2], [3, 4]]
[agents.2.faults]
crash = { at = 1.5 }
"""
    return named(tmp_path_factory.mktemp("lossy"), faults, "safety.neighbour_silent.then=continue")


def test_links_are_drawn_only_where_something_was_recorded(swap: Run, average: Run, lossy_run: Run) -> None:
    assert FIGURES["links"]([swap, average]) is None
    assert len(draw("links", swap, lossy_run).axes) == 4


def test_cells_of_the_matrices_have_the_numbers_of_their_links(lossy_run: Run) -> None:
    loss, latency, *_ = draw("links", lossy_run).axes
    assert (loss.get_title(), latency.get_title()) == ("messages lost, %", "latency in ms: median, 95 % (colour)")
    assert (loss.get_xlabel(), loss.get_ylabel()) == ("receiver", "sender")
    health = link_health(lossy_run)
    cells = {tuple(map(int, text.get_position())): text.get_text() for text in loss.texts}
    assert cells == {(each.receiver - 1, each.sender - 1): f"{100 * each.loss:.1f}" for each in health}
    assert {text.get_text() for text in latency.texts} == {"0.50\n0.50"}


def test_losses_over_time_stand_above_the_least_barrier_with_what_was_wrong_shaded(lossy_run: Run) -> None:
    *_, share, least = draw("links", lossy_run).axes
    assert share.get_ylabel() == "messages per step, %"
    assert least.get_xlabel() == "time in s"
    assert legend(share)[:2] == ["worst link", "lost, all links"]
    assert {text.get_text() for text in share.texts} >= {"partition", "agent 2 absent"}
    assert f"{lossy_run.summary()['min_barrier']:.3f} at" in texts(least)
    (worst,) = (line for line in share.lines if line.get_label() == "worst link")
    heights = np.asarray(worst.get_ydata())
    assert heights[2] == heights[3] == 100.0
    assert share.get_shared_x_axes().joined(share, least)


def test_the_summary_tells_losses_by_cause_and_what_controllers_noted(lossy_run: Run) -> None:
    summary = lossy_run.summary()
    assert set(summary["lost_by"]["faults"]) == {"loss", "partition"}
    assert sum(summary["lost_by"]["faults"].values()) == pytest.approx(summary["messages"]["lost"], abs=100)
    text = show(lossy_run)
    assert f"{summary['lost_by']['faults']['partition']} by 'partition'" in text
    notes = ({"sign_disagreements": 2, "lost_agents": 0},) * len(lossy_run.agents[1].step)
    noted = changed(lossy_run, 1, notes=notes)
    assert noted.summary()["notes"]["sign_disagreements"] == 2 * len(notes)
    assert f"{2 * len(notes)} sign_disagreements" in show(noted)


def test_the_summary_tells_of_faults_whose_names_no_payload_had(tmp_path: Path) -> None:
    faults = """
[faults]
noise = { std = 0.001, names = ["lamda", "lam"] }
[[faults.rule]]
from = [1]
to = [2]
noise = { std = 0.001, names = ["lamb"] }
"""
    run = named(tmp_path, faults, "time.duration=0.4")
    met = "there were 'c', 'ids', 'lam', 's', 'states'"
    told = {f"noise: no payload had 'lamb'; {met}": 1, f"noise: no payload had 'lamda'; {met}": 11}
    assert run.summary()["unmet"] == told
    text = " ".join(show(run).split())
    assert "faults without effect" in text
    assert f"'lamda'; {met} (11 links)" in text
    assert f"'lamb'; {met} (1 link)" in text


def test_the_summary_of_a_run_without_losses_says_nothing_of_their_causes(swap: Run) -> None:
    assert swap.summary()["unmet"] == {}
    assert "faults without effect" not in show(swap)
    assert swap.summary()["lost_by"] == {"faults": {}, "network": 0}
    assert "messages lost" not in show(swap)
    assert "controllers noted" not in show(swap)


def test_the_links_name_what_happened(lossy_run: Run) -> None:
    log = lossy_run.agents[1]
    events = (
        {"event": "inspected", "time": 0, "checks": []},
        {"event": "fault", "time": int(2e9), "change": []},
        {"event": "alarm", "time": int(3e9), "rule": "geofence", "then": "log", "text": "out", "step": 15},
    )
    axes = draw("links", changed(lossy_run, 1, events=(*log.events, *events))).axes
    words = [text.get_text() for each in axes for text in each.texts]
    assert words.count("faults changed") == 1
    assert "alarm: geofence" in words
