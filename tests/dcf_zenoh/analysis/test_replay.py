from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh import Run
from dcf_zenoh.analysis.replay import FreeBody, replay
from dcf_zenoh.plant import Setpoint, State
from tests.support.faulty_runs import named

HARDWARE = '''
from plants.point_mass import PointMass
from dcf_zenoh.plant import Plant

class Drone(Plant):
    """A body that nobody can put anywhere."""
    flown = 0
    def __init__(self, start):
        self.body = PointMass(start)
    def prepare(self):
        Drone.flown += 1
        assert Drone.flown <= 4, "somebody flies it again"
    def sense(self, now):
        return self.body.sense(now)
    def act(self, setpoint, now):
        self.body.act(setpoint, now)
'''


@pytest.fixture(scope="module")
def swap(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return dcf_zenoh.simulate(
        "position_swap", changes=["time.duration=2.0"], out=tmp_path_factory.mktemp("swap") / "run"
    )


@pytest.mark.parametrize(("first", "end"), [(0, 1), (4, 5), (3, 7)])
def test_without_faults_the_replay_is_the_run(swap: Run, first: int, end: int) -> None:
    again = replay(swap, first, end)
    assert again.agreed
    for agent, log in swap.agents.items():
        np.testing.assert_allclose(again.states[agent], log.state[end], atol=1e-3)


def test_setpoints_act_as_late_as_they_did(tmp_path: Path) -> None:
    run = named(tmp_path, "", "exchange.compute_time=0.001", "exchange.max_rounds=120")
    assert min(log.negotiation.min() for log in run.agents.values()) > 0.02
    again = replay(run, 5, 6)
    for agent, log in run.agents.items():
        np.testing.assert_allclose(again.states[agent], log.state[6], atol=1e-3)


def test_a_replay_knows_no_loss(tmp_path: Path, swap: Run) -> None:
    run = named(tmp_path, "[faults]\nloss = 0.5\n")
    first = replay(run, 0, 1)
    for agent, log in swap.agents.items():
        np.testing.assert_allclose(first.states[agent], log.state[1], atol=5e-3)
        assert abs(run.agents[agent].state[1] - log.state[1]).max() > 5e-3


def test_hardware_is_left_alone_and_a_free_body_stands_in(tmp_path: Path) -> None:
    (tmp_path / "drone.py").write_text(HARDWARE)
    run = dcf_zenoh.simulate(
        "position_swap",
        changes=["time.duration=1.0", f'plants.drone.kind="{tmp_path}/drone.py:Drone"', 'plant="drone"'],
        out=tmp_path / "run",
    )
    again = replay(run, 3, 4)
    assert again.free == (1, 2, 3, 4)
    for agent, log in run.agents.items():
        np.testing.assert_allclose(again.states[agent], log.state[4], atol=1e-3)


def test_a_free_body_accelerates_as_told_in_as_many_dimensions_as_it_is_told() -> None:
    body = FreeBody(np.zeros(3))
    body.resume(State(np.array([1.0, 0.0, 2.0]), np.array([0.5, 0.0, 0.0])), 0)
    body.act(Setpoint(acceleration=np.array([2.0, 4.0])), 0)
    state = body.sense(500_000_000)
    np.testing.assert_allclose(state.vector, [1.5, 0.5, 2.0, 1.5, 2.0, 0.0], rtol=1e-12)
    body.act(Setpoint.hold(state), 500_000_000)
    np.testing.assert_array_equal(body.sense(900_000_000).velocity, 0.0)
