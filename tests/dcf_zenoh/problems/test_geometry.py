"""Runs are measured by the safety region and the obstacles that their problem has, built-in or not."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.analysis.metrics import intrusions
from dcf_zenoh.config import load
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.distance_swap import DistanceSwap
from dcf_zenoh.problems.geometry import (
    DeadlockLayout,
    ObstacleClearance,
    ObstacleOutlines,
    RegionOutline,
    SafetyRegion,
)
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.problems.rendezvous import Rendezvous
from dcf_zenoh.problems.shared.swap_options import DiamondOptions
from tests.support.own_region import circle, ellipse, fly, write_fleet

ALL = (SafetyRegion, RegionOutline, ObstacleClearance, ObstacleOutlines, DeadlockLayout)
PAIRS = list(combinations(range(3), 2))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A fleet with a safety region of its own, in a run directory."""
    folder = tmp_path_factory.mktemp("own_region")
    return fly(folder, out=folder / "run")


def between(run: Run) -> tuple[Array, Array]:
    """Instants every 0.1 ms, s, and the positions of all agents, shape (n, N, 2), m."""
    times = np.linspace(0.0, run.steps * 0.2, round(run.steps * 2000) + 1)
    return times, np.stack([motion.at(times) for motion in run.motions.values()], axis=1)


def test_barrier_values_are_those_of_the_problem(recorded: Run) -> None:
    positions = recorded.positions
    expected = np.stack([ellipse(positions[:, i] - positions[:, j]) for i, j in PAIRS], axis=1)
    assert expected.min() < 0 < expected.max()
    np.testing.assert_allclose(recorded.barriers, expected, atol=1e-12)
    times, path = between(recorded)
    expected = np.stack([ellipse(path[:, i] - path[:, j]) for i, j in PAIRS], axis=1)
    assert recorded.summary()["min_barrier"] == pytest.approx(expected.min(), abs=5e-4)
    inside = intrusions(recorded)
    assert inside is not None
    assert inside.time == pytest.approx((expected.min(axis=1) < 0).mean() * times[-1], abs=1e-3)


def test_clearances_are_those_of_the_problem(recorded: Run) -> None:
    expected = circle(recorded.positions)
    np.testing.assert_allclose(recorded.clearances, expected, atol=1e-12)
    assert recorded.summary()["min_clearance"] == pytest.approx(circle(between(recorded)[1]).min(), abs=1e-4)


def test_a_run_in_memory_is_measured_alike(tmp_path: Path, recorded: Run) -> None:
    kept = fly(tmp_path)
    assert kept.folder is None
    np.testing.assert_array_equal(kept.barriers, recorded.barriers)
    np.testing.assert_array_equal(kept.clearances, recorded.clearances)


def test_outlines_are_where_the_barrier_value_is_zero(recorded: Run) -> None:
    here = np.array([0.3, -0.2])
    corners = recorded.geometry.outline(2, here)
    assert corners is not None
    np.testing.assert_allclose(ellipse(corners - here), 0.0, atol=1e-12)
    (obstacle,) = recorded.geometry.obstacles
    np.testing.assert_allclose(circle(obstacle), 0.0, atol=1e-12)


def test_a_problem_with_nothing_but_a_separation_is_measured_by_that(tmp_path: Path, recorded: Run) -> None:
    run = fly(tmp_path, "Apart")
    np.testing.assert_array_equal(run.barriers, recorded.barriers)
    assert run.clearances.shape == (run.steps, 0)
    assert run.summary()["min_clearance"] is None
    assert run.geometry.outline(1, np.zeros(2)) is None
    assert run.geometry.obstacles == ()
    assert run.geometry.unknown is None


def test_a_problem_without_geometry_has_distances_alone(tmp_path: Path) -> None:
    run = fly(tmp_path, "Straight")
    assert run.summary()["min_barrier"] is None
    path = between(run)[1]
    gaps = [np.linalg.norm(path[:, i] - path[:, j], axis=1).min() for i, j in PAIRS]
    assert run.summary()["min_distance"] == pytest.approx(min(gaps), abs=1e-4)
    assert (run.geometry.has_regions, run.geometry.unknown) == (False, None)


def test_a_function_that_makes_a_problem_is_asked_too(tmp_path: Path, recorded: Run) -> None:
    np.testing.assert_array_equal(fly(tmp_path, "Made").barriers, recorded.barriers)


def test_the_code_of_a_run_is_not_run_where_it_must_not(recorded: Run, caplog: pytest.LogCaptureFixture) -> None:
    assert recorded.folder is not None
    run = Run.read(recorded.folder, run_plugins=False)
    assert run.digest == recorded.digest
    assert not caplog.records
    assert (run.barriers.shape, run.clearances.shape) == ((run.steps, 0), (run.steps, 0))
    assert run.summary()["min_barrier"] is None
    text = "the geometry of the problem is not known: ./plugins/own_region.py:Ellipse was not run"
    assert run.geometry.unknown == text
    assert [record.getMessage() for record in caplog.records] == [text]


def test_built_in_problems_are_asked_even_there(tmp_path: Path) -> None:
    run = dcf_zenoh.simulate("position_swap", changes=["time.duration=1.0"], out=tmp_path / "run")
    np.testing.assert_array_equal(Run.read(tmp_path / "run", run_plugins=False).barriers, run.barriers)


def test_a_run_whose_plugin_cannot_be_loaded_can_be_read(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    known = fly(tmp_path, out=tmp_path / "run").summary()
    copy = tmp_path / "run" / "plugins" / "own_region.py"
    copy.write_text("import a_package_of_another_machine\n" + copy.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "run" / "plugins.json").unlink()  # otherwise the change is what is told
    again = Run.read(tmp_path / "run")
    assert again.summary() == {**known, "min_barrier": None, "min_clearance": None, "findings": []}
    (record,) = caplog.records
    assert "No module named 'a_package_of_another_machine'" in record.getMessage()
    assert again.geometry.unknown == record.getMessage()


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("Fails", "separation() failed: ZeroDivisionError: no such region"),
        ("Flat", "separation() failed: expected shape (15), not ()"),
    ],
)
def test_a_geometry_that_fails_is_told_and_the_rest_of_the_run_is_known(
    tmp_path: Path, kind: str, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    run = fly(tmp_path, kind)
    assert run.barriers.shape == (run.steps, 0)
    assert run.clearances.shape == (run.steps, 3)
    assert run.geometry.unknown == f"the geometry of the problem is not known: ./own_region.py:{kind}: {why}"
    assert [record.getMessage() for record in caplog.records] == [run.geometry.unknown]


def test_a_layout_that_the_problem_knows_to_get_stuck_is_noted(tmp_path: Path) -> None:
    file = write_fleet(tmp_path)
    assert load(file).notes == ("agents: 1 and 2 fly towards each other",)
    assert load(file, changes=["agents.1.target=[1.0, 0.1]"]).notes == ()
    assert not [note for note in load(file, run_plugins=False).notes if note.startswith("agents:")]


def test_a_problem_that_is_asked_for_deadlocks_is_made_and_its_refusal_told(tmp_path: Path) -> None:
    file = write_fleet(tmp_path)
    with pytest.raises(ConfigurationError, match=r"problem: .*Ellipse refused its options: pace must be"):
        load(file, changes=["time.sample_time=1.0"])


def test_built_in_problems_offer_what_they_have() -> None:
    ids = (1, 2)
    swap = PositionSwap(1, ids, 0.2, target=(0.0, 0.0))
    offered = {type(each): [isinstance(each, part) for part in ALL] for each in (swap, Rendezvous(1, 0.2))}
    assert offered == {PositionSwap: [True] * 5, Rendezvous: [False] * 5}
    true_distance = DistanceSwap(1, ids, 0.2, target=(0.0, 0.0))
    assert [isinstance(true_distance, part) for part in ALL] == [True, True, False, False, False]


def test_the_diamond_of_the_position_swap_is_its_region() -> None:
    problem = PositionSwap(1, (1, 2), 0.2, target=(0.0, 0.0), barrier=DiamondOptions(obstacles=((1.0, 0.0, 0.2, 0.4),)))
    rng = np.random.default_rng(3)
    own, other = rng.normal(size=(2, 7, 3))
    expected = abs(own[:, 0] - other[:, 0]) / 0.5 + abs(own[:, 1] - other[:, 1]) / 0.25 - 1
    np.testing.assert_array_equal(problem.separation(own, other), expected)
    np.testing.assert_array_equal(problem.separation(own[0], other[0]), expected[0])
    around = problem.outline(own[0])
    halfway = (around + np.roll(around, 1, axis=0)) / 2
    np.testing.assert_allclose(problem.separation(np.vstack((around, halfway)), own[0, :2]), 0.0, atol=1e-12)
    (corners,) = problem.obstacle_outlines()
    np.testing.assert_allclose(problem.clearances(corners), 0.0, atol=1e-12)
    np.testing.assert_allclose(problem.clearances(np.array([1.0, 0.0, 5.0])), [-1.0])


def test_a_problem_that_is_not_there_any_more_leaves_a_run_readable(recorded: Run) -> None:
    spec = recorded.fleet.model_copy(update={"problem": type(recorded.fleet.problem)(kind="./gone.py:Region")})
    run = replace(recorded, fleet=spec)
    assert run.summary()["min_barrier"] is None
    assert run.geometry.unknown is not None
    assert "gone.py" in run.geometry.unknown
