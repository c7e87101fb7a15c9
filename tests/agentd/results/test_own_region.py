"""A safety region of a plug-in is explained and drawn as the built-in one."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from agentd.cli import main
from agentd.figures import FIGURES
from agentd.figures.trajectories import limits
from agentd.results.explanation_text import why_lines
from agentd.results.report import write_report
from agentd.results.summary import summary_table
from dcf_zenoh import Run
from dcf_zenoh.analysis.explanation import explain
from dcf_zenoh.plant import Array
from tests.support.own_region import AXES, circle, ellipse, fly, write_fleet


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A fleet with an ellipse as its safety region, in a run directory."""
    folder = tmp_path_factory.mktemp("own_region")
    return fly(folder, out=folder / "run")


def draw(name: str, run: Run) -> Figure:
    figure = FIGURES[name]([run])
    assert figure is not None
    return figure


def legend(axes: Axes) -> list[str]:
    found = axes.get_legend()
    return [] if found is None else [text.get_text() for text in found.get_texts()]


def key(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def corners(patch: Polygon) -> Array:
    return np.asarray(patch.get_xy())


def least(run: Run) -> tuple[int, float]:
    """Step and barrier value of agents 1 and 2 where they are closest at the samples, by the ellipse's equation."""
    h = ellipse(run.positions[:, 0] - run.positions[:, 1])
    return int(h.argmin()), float(h.min())


def between(run: Run) -> tuple[float, float, float]:
    """Instant and barrier value of the closest approach of agents 1 and 2, and their least distance, every 0.1 ms."""
    times = np.linspace(0.0, run.steps * 0.2, round(run.steps * 2000) + 1)
    apart = run.motions[1].at(times) - run.motions[2].at(times)
    h = ellipse(apart)
    return float(times[h.argmin()]), float(h.min()), float(np.linalg.norm(apart, axis=1).min())


def test_why_explains_the_barrier_of_the_problem(recorded: Run) -> None:
    step, h = least(recorded)
    lines = list(why_lines(recorded, explain(recorded)))
    instant, value, _ = between(recorded)
    assert lines[1] == (
        f"Closest approach: h = {value:.3f} between agents 1 and 2 at {instant:.2f} s;"
        f" at the samples h = {h:.3f} at step {step} ({step * 0.2:.1f} s)."
    )
    assert lines[2] == "The barrier h >= 0 was violated: each was in the other's safety region."
    before = ellipse(recorded.positions[step - 1, 0] - recorded.positions[step - 1, 1])
    assert f"Step {step - 1} ({(step - 1) * 0.2:.1f} s), began at h = {before:.3f}:" in lines
    (again,) = (line for line in lines if line.startswith(f"  step {step - 1} once more ("))
    assert again.endswith(f"h = {h:.3f} at step {step} instead of {h:.3f}")  # decisions need nothing of the network


def test_why_tells_distances_where_the_region_is_not_known(recorded: Run) -> None:
    assert recorded.folder is not None
    run = Run.read(recorded.folder, run_plugins=False)
    lines = list(why_lines(run, explain(run)))
    assert lines[1].startswith(f"Closest approach: distance {between(run)[2]:.3f} m between agents 1 and 2")
    assert lines[2] == (
        "Safety regions were left out: the geometry of the problem is not known:"
        " ./plugins/own_region.py:Ellipse was not run."
    )


def test_the_summary_has_barrier_and_clearance(recorded: Run) -> None:
    table = summary_table(recorded.summary())
    rows = dict(zip(*(list(column.cells) for column in table.columns), strict=True))
    times = np.linspace(0.0, recorded.steps * 0.2, 20_001)
    clearance = min(float(circle(motion.at(times)).min()) for motion in recorded.motions.values())
    assert rows["closest"] == (
        f"{between(recorded)[2]:.3f} m, least barrier {between(recorded)[1]:.3f}, with obstacles {clearance:.3f}"
    )


def test_the_region_is_drawn_where_h_is_zero(recorded: Run) -> None:
    figure = draw("trajectories", recorded)
    (axes,) = figure.axes
    instant, h, _ = between(recorded)
    assert axes.get_title().endswith(f"closest at {instant:.1f} s: least barrier h = {h:.3f}")
    polygons = [patch for patch in axes.patches if isinstance(patch, Polygon)]
    (obstacle,) = (patch for patch in polygons if patch.get_hatch())
    np.testing.assert_allclose(circle(corners(obstacle)), 0.0, atol=1e-12)
    regions = [patch for patch in polygons if not patch.get_fill()]
    for region, motion in zip(regions, recorded.motions.values(), strict=True):
        np.testing.assert_allclose(ellipse(corners(region) - motion.at(np.array([instant]))), 0.0, atol=0.01)
    assert {"safety region, closest instant", "obstacle"} <= set(key(figure))


def test_all_of_an_obstacle_is_in_the_picture(recorded: Run) -> None:
    low, high = limits(recorded)
    (obstacle,) = recorded.geometry.obstacles
    assert (low <= obstacle.min(axis=0)).all()
    assert (high >= obstacle.max(axis=0)).all()


def test_separation_shows_the_barrier_and_the_circle_in_the_region(recorded: Run) -> None:
    distance, barrier, _ = draw("separation", recorded).axes
    np.testing.assert_allclose(np.asarray(barrier.lines[0].get_ydata(), float), recorded.barriers[:, 0])
    assert "least with obstacles" in legend(barrier)
    (reach,) = (patch.get_height() for patch in distance.patches)  # type: ignore[attr-defined]
    assert reach == pytest.approx(min(AXES), rel=0.01)  # a polygon with 60 corners


def test_without_an_outline_nothing_is_drawn_around_the_agents(tmp_path: Path) -> None:
    run = fly(tmp_path, "Apart")
    figure = draw("trajectories", run)
    assert not [patch for patch in figure.axes[0].patches if isinstance(patch, Polygon)]
    assert not {"safety region, closest instant", "obstacle"} & set(key(figure))
    assert "least barrier h =" in figure.axes[0].get_title()
    distance, barrier, _ = draw("separation", run).axes
    assert not distance.patches
    assert "least with obstacles" not in legend(barrier)
    assert "in the safety region,\nh < 0" in legend(barrier)


def test_the_flight_is_written_with_and_without_an_outline(recorded: Run, tmp_path: Path) -> None:
    for run in (recorded, fly(tmp_path, "Apart")):
        written = write_report([run], tmp_path / "report", animate=True)
        assert (tmp_path / "report" / "flight.gif") in written


def test_a_region_that_is_not_known_is_named_in_the_figure(recorded: Run) -> None:
    assert recorded.folder is not None
    unknown = Run.read(recorded.folder, run_plugins=False)
    figure = FIGURES["separation"]([recorded, unknown])
    assert figure is not None
    assert "safety region not known" in [text.get_text() for axes in figure.axes for text in axes.texts]


def test_check_notes_the_layout(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = write_fleet(tmp_path)
    assert main(["check", str(file), "--load"]) == 0
    assert "agents: 1 and 2 fly towards each other" in "".join(capfd.readouterr())
