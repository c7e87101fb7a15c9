from dataclasses import replace

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.plant import Setpoint
from plants.point_mass import PointMass

ONE_LANDS_EARLY = [
    "time.clock=virtual",
    "arena={min=[-1.6,-1.6],max=[1.6,1.01]}",
    'safety.neighbour_silent={after=0.6,then="continue"}',
    "agents.2.start=[0,0.5]",
    "agents.2.target=[0,1.5]",
    "agents.1.start=[0,-1]",
    "agents.1.target=[0,-1.3]",
]


@pytest.fixture(scope="module")
def landed(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Agent 2 leaves the arena after 8 of 125 steps and lands; the others fly on."""
    folder = tmp_path_factory.mktemp("landed") / "run"
    return dcf_zenoh.simulate("position_swap_lossy", changes=ONE_LANDS_EARLY, out=folder)


@pytest.fixture(scope="module")
def swap() -> Run:
    return dcf_zenoh.simulate("position_swap", changes=["time.clock=virtual"])


def test_safety_is_measured_over_all_time_also_after_an_agent_has_landed(landed: Run) -> None:
    assert landed.agents[2].landed
    assert (landed.steps, landed.common_steps) == (125, 8)
    assert landed.barriers.min() == pytest.approx(1.631, abs=5e-4)
    assert landed.summary()["steps"] == 125
    closest = landed.closest("barrier")
    assert closest is not None
    assert closest.value <= landed.barriers.min()
    assert closest.time > 7 * 0.2  # after its last step, at 1.4 s


def test_a_landed_body_is_where_its_log_ends(landed: Run) -> None:
    place = list(landed.agents).index(2)
    np.testing.assert_array_equal(landed.positions[8:, place], np.tile(landed.agents[2].path[-1], (117, 1)))
    assert landed.motions[2].at(np.array([20.0]))[0] == pytest.approx(landed.agents[2].path[-1], abs=1e-9)


def test_arrival_counts_only_steps_that_all_agents_recorded(landed: Run) -> None:
    assert landed.arrival_time is None


def dense(run: Run, every: float) -> dict[int, np.ndarray]:
    """Positions every `every` seconds: the recorded setpoints on point masses, sensed that often."""
    found = {}
    for i, log in run.agents.items():
        body, positions, now = PointMass(np.array(run.fleet.agent(i).start)), [], 0
        commands = [(round(at * 1e9), row) for row, at in enumerate(log.acted)]
        while now <= round(log.acted[-1] * 1e9):
            while commands and commands[0][0] <= now:
                at, row = commands.pop(0)
                position, velocity, acceleration = np.split(log.setpoint[row], 3)
                body.act(Setpoint(position, velocity, acceleration), at)
            positions.append(body.sense(now).position)
            now += round(every * 1e9)
        found[i] = np.array(positions)
    return found


def test_the_closest_approach_counts_between_the_samples(swap: Run) -> None:
    found = dense(swap, 0.001)
    pairs = [(i, j) for i in found for j in found if i < j]
    distance = min(np.linalg.norm(found[i] - found[j], axis=1).min() for i, j in pairs)
    h = min(((abs(found[i] - found[j]) / [0.5, 0.25]).sum(axis=1) - 1).min() for i, j in pairs)
    summary = swap.summary()
    assert summary["between_samples"]
    assert summary["min_distance"] == pytest.approx(distance, abs=1e-4)
    assert summary["min_distance"] == pytest.approx(0.251, abs=5e-4)
    assert summary["min_barrier"] == pytest.approx(h, abs=2e-3)
    assert summary["min_barrier"] == pytest.approx(0.120, abs=5e-4)
    assert summary["min_distance"] <= distance
    assert summary["min_distance"] < swap.distances.min() - 0.005


def test_a_violation_between_the_samples_is_found() -> None:
    run = dcf_zenoh.simulate("position_swap", changes=["time.clock=virtual", "problem.barrier.radii=[0.25,0.25]"])
    assert run.barriers.min() > -0.001
    assert run.summary()["min_barrier"] == pytest.approx(-0.014, abs=5e-4)
    assert min(each.value for each in run.violations) == run.summary()["min_barrier"]
    assert all(0 < each.duration < 1.0 for each in run.violations)


def test_a_path_that_misses_the_recorded_states_is_not_used(swap: Run) -> None:
    log = swap.agents[1]
    moved = replace(log, state=log.state + 0.001)
    run = replace(swap, agents={**swap.agents, 1: moved})
    assert not run.between_samples
    assert run.motions[2].known
    course = run.courses["distance"][1, 2]
    assert not course.between
    assert len(course.values) == run.steps + 1


def test_paths_of_other_plants_are_known() -> None:
    for plant in ("single_integrator", "unicycle"):
        run = dcf_zenoh.simulate("position_swap", changes=["time.duration=3.0", f"plants.point={{kind='{plant}'}}"])
        assert run.between_samples, plant
