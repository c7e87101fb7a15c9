"""The position swap around obstacles."""

from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.config import load
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.problems.shared.diamond import Obstacle
from dcf_zenoh.records.run import Run

AROUND = "position_swap_obstacles"


def obstacles_of(run: Run) -> list[Obstacle]:
    return [Obstacle.of(numbers) for numbers in run.fleet.problem.options["barrier"]["obstacles"]]


def cuts(run: Run) -> bool:
    """Whether any agent's straight way leads through an obstacle."""
    share = np.linspace(0, 1, 101)[:, None]
    ways = [np.array(own.start) * (1 - share) + np.array(own.target) * share for own in run.fleet.agents.values()]
    return any(obstacle.barrier(place) < 0 for way in ways for place in way for obstacle in obstacles_of(run))


@pytest.mark.parametrize(
    ("algorithm", "topology", "plant"),
    [
        ("trades", "complete", "point"),
        ("robust", "star", "point"),
        ("trades", "ring", "twin"),
    ],
)
def test_agents_go_around_obstacles(algorithm: str, topology: str, plant: str) -> None:
    run = dcf_zenoh.simulate(AROUND, algorithm=algorithm, topology=topology, plant=plant)
    assert cuts(run)
    assert run.arrival_time is not None
    assert run.barriers.min() >= 0
    assert run.clearances.min() >= 0
    assert run.clearances.shape == (run.steps, 8)
    assert 0 <= run.summary()["min_clearance"] <= run.clearances.min()  # between the samples it may be less


def test_an_obstacle_beside_the_way_keeps_them_out_where_they_would_fly_through_it() -> None:
    beside = ["controller.detour=false", "problem.barrier.obstacles=[[0.45, 0.5, 0.3, 0.3], [-0.5, -0.3, 0.35, 0.3]]"]
    around = dcf_zenoh.simulate(AROUND, changes=beside)
    assert around.arrival_time is not None
    assert 0.02 - 1e-3 <= around.clearances.min() <= 0.1
    free = dcf_zenoh.simulate(AROUND, changes=[*beside, "problem.barrier.obstacles=[]"])
    assert min(each.barrier(place) for each in obstacles_of(around) for step in free.positions for place in step) < 0
    assert free.summary()["min_clearance"] is None


def test_clearance_is_the_barrier_value_of_every_agent_with_every_obstacle() -> None:
    run = dcf_zenoh.simulate(AROUND, changes=["time.duration=1.0"])
    for step in range(run.steps):
        expected = [obstacle.barrier(place) for obstacle in obstacles_of(run) for place in run.positions[step]]
        np.testing.assert_allclose(run.clearances[step], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("obstacles", "complaint"),
    [
        ("[[0.0, 1.0, 0.2, 0.2]]", "agent 1 would start in obstacle 1: h = -1, expected at least 0.02"),
        ("[[0.0, 0.0, 0.2]]", "problem.barrier.obstacles"),
        ("[[0.0, 0.0, 0.2, 0.0]]", "r1 and r2 positive, not [0.0, 0.0, 0.2, 0.0]"),
        ("[[0.0, 0.0, 'wide', 0.2]]", "problem.barrier.obstacles"),
    ],
)
def test_an_obstacle_that_cannot_be_is_refused(obstacles: str, complaint: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load(AROUND, changes=[f"problem.barrier.obstacles={obstacles}"])
    assert complaint in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_obstacles_and_the_arena_are_in_the_picture(tmp_path: Path) -> None:
    from agentd.figures.trajectories import trajectories  # noqa: PLC0415

    run = dcf_zenoh.simulate(AROUND, changes=["time.duration=1.0", "arena={min=[-2.0, -1.5], max=[2.0, 1.5]}"])
    figure = trajectories([run])
    assert figure is not None
    assert {"obstacle", "arena"} <= {text.get_text() for text in figure.legends[0].get_texts()}
    hatched = [patch for patch in figure.axes[0].patches if patch.get_hatch()]
    assert len(hatched) == 2
    figure.savefig(tmp_path / "trajectories.png")
