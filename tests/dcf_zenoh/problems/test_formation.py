"""Formations and meetings, flown by point masses in the simulator, whatever algorithm agrees on the place."""

from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.plant import State
from dcf_zenoh.problems.formation import Formation
from dcf_zenoh.problems.rendezvous import Rendezvous
from dcf_zenoh.problems.shared.approach import Approach
from plants.point_mass import PointMass
from tests.support.fleet_files import problems

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

OFFSETS = np.array([[0.5, 0.5], [-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5]])
MEAN = np.array([0.5, 0.0])  # of the starts in rendezvous.toml, below
STARTS = ["agents.1.start=[0.0,2.0]", "agents.2.start=[-1.0,-1.0]", "agents.3.start=[2.0,0.5]"]
STARTS += ["agents.4.start=[1.0,-1.5]", "problem.pace=0.8"]  # so slow that no acceleration meets its bound
ALGORITHMS = ("average_consensus", "exact_diffusion", "edge_admm", "centralised")


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("topology", ["complete", "ring", "path", "star"])
def test_all_meet_at_the_mean_of_where_they_start(algorithm: str, topology: str) -> None:
    run = dcf_zenoh.simulate(
        "rendezvous", algorithm=algorithm, topology=topology, changes=[*STARTS, "exchange.threshold=1e-6"]
    )
    assert run.summary()["arrived"]
    assert run.arrival_time is not None
    assert 5.0 < run.arrival_time < 15.0
    np.testing.assert_allclose(run.positions[-1], np.tile(MEAN, (4, 1)), atol=0.02)
    np.testing.assert_allclose(run.positions.mean(axis=1), np.tile(MEAN, (run.steps, 1)), atol=2e-3)  # it stays there


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_formation_follows_the_agent_that_knows_the_goal(algorithm: str) -> None:
    run = dcf_zenoh.simulate("formation", algorithm=algorithm)
    assert run.summary()["arrived"]
    np.testing.assert_allclose(run.positions[-1], np.array([4.0, 1.0]) + OFFSETS, atol=0.03)
    shape = run.positions - run.positions.mean(axis=1, keepdims=True)
    late = run.time > 6.0
    np.testing.assert_allclose(shape[late], np.tile(OFFSETS, (late.sum(), 1, 1)), atol=0.05)  # on the way, too


def test_without_a_goal_the_formation_is_made_where_the_agents_are() -> None:
    change = "agents.1.problem={offset=[0.5,0.5]}"
    run = dcf_zenoh.simulate("formation", changes=[change, "exchange.threshold=1e-6", "problem.pace=0.8"])
    starts = run.positions[0]
    assert run.summary()["arrived"]
    np.testing.assert_allclose(run.positions[-1] - starts.mean(axis=0), OFFSETS, atol=0.03)


def test_bodies_in_space_meet_in_space_or_in_the_plane() -> None:
    starts = [f"agents.{i}.start=[{x},{y},{z}]" for i, x, y, z in
              [(1, 0.0, 2.0, 1.0), (2, -1.0, -1.0, 2.0), (3, 2.0, 0.5, 0.5), (4, 1.0, -1.5, 1.5)]]  # fmt: skip
    run = dcf_zenoh.simulate("rendezvous", changes=[*starts, "problem.dimensions=3", "problem.pace=0.8"])
    np.testing.assert_allclose(run.positions[-1].mean(axis=0), [0.5, 0.0, 1.25], atol=2e-3)
    assert run.distances[-1].max() < 0.03


def test_faults_only_make_a_lossy_meeting_later() -> None:
    changes = [*STARTS, "faults.loss=0.2", "exchange.round_timeout=0.003", "exchange.max_rounds=40"]
    run = dcf_zenoh.simulate("rendezvous", algorithm="edge_admm", changes=changes)
    assert run.summary()["arrived"]
    np.testing.assert_allclose(run.positions[-1], np.tile(MEAN, (4, 1)), atol=0.03)


@pytest.mark.parametrize("bound", [10.0, 0.5])
def test_an_approach_predicts_what_a_point_mass_does(bound: float) -> None:
    approach = Approach.of(0.2, 1.5, bound)
    body = PointMass(np.array([1.0, -2.0]), velocity=(0.5, 0.0), accel_max=bound)
    start, place = body.sense(0), np.array([-1.0, 0.0])
    for step in range(6):
        state = body.sense(step * 200_000_000)
        setpoint = approach.setpoint(state.position, state.velocity, place, 0)
        planned = approach.setpoint(start.position, start.velocity, place, step)
        np.testing.assert_allclose(planned.vector, setpoint.vector, atol=1e-12)
        assert setpoint.acceleration is not None
        assert abs(setpoint.acceleration).max() <= bound
        body.act(setpoint, step * 200_000_000)
        after = body.sense((step + 1) * 200_000_000)
        np.testing.assert_allclose(after.vector, np.concatenate((setpoint.position, setpoint.velocity)), atol=1e-12)


def test_the_distance_to_go_is_to_the_goal_or_to_where_it_was_sent() -> None:
    here = State(np.array([1.0, 0.0, 5.0]), np.zeros(3))
    led = Formation(1, 0.2, offset=(1.0, 0.0), goal=(3.0, 4.0))
    assert led.distance_to_go(here) == pytest.approx(5.0)
    free = Rendezvous(1, 0.2)
    assert free.distance_to_go(here) == float("inf")
    free.at({1: here.vector}).setpoint(np.array([1.0, 2.0]), 0)
    assert free.distance_to_go(here) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Formation(1, 0.2, offset=()), "offset must have at least one component"),
        (lambda: Formation(1, 0.2, offset=(0.0,), goal=(1.0, 2.0)), "goal has 2 components, offset has 1"),
        (lambda: Formation(1, 0.2, offset=(0.0,), pull=0.0), "pull must be positive, not 0"),
        (lambda: Rendezvous(1, 0.2, pace=5.0), "pace must be positive and less than 1 / sample_time, 5, not 5"),
        (lambda: Rendezvous(1, 0.2, accel_max=0.0), "accel_max must be positive, in m/s², not 0"),
        (lambda: Rendezvous(1, 0.2, dimensions=0), "dimensions must be at least 1, not 0"),
    ],
)  # fmt: skip
def test_numbers_out_of_range_are_refused(make: object, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        make()  # type: ignore[operator]


def test_a_game_is_not_agreed_on_by_consensus(tmp_path: Path) -> None:
    fleet = tmp_path / "meet.toml"
    fleet.write_text(
        'name = "meet"\nproblem = { kind = "rendezvous" }\nalgorithm = { kind = "trades" }\n'
        'plants = { point = { kind = "point_mass" } }\n'
        "agents = { 1 = { start = [0.0, 1.0] }, 2 = { start = [1.0, 0.0] } }\n"
    )
    (text,) = problems(fleet)
    assert text.startswith(
        "algorithm.kind: trades solves an aggregative game with shared constraints, and rendezvous is a mean of values"
        " and a consensus problem; those that can solve it: admm_tracking_gradient, average_consensus, centralised,"
    )
