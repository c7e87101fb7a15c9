"""A fleet of unlike bodies flies one game: it arrives, keeps its distance, and daemons do what the simulator does."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh

LOOK_AHEAD = 0.05  # m, of the robot


@pytest.mark.parametrize(
    ("topology", "seed"),
    [
        ("ring", 2),
        ("path", 3),
        *(pytest.param(*each, marks=pytest.mark.large) for each in (("complete", 1), ("star", 4), ("complete", 5))),
    ],
)
def test_unlike_bodies_arrive_and_keep_their_distance(topology: str, seed: int) -> None:
    run = dcf_zenoh.simulate("position_swap_mixed", topology=topology, seed=seed)
    assert run.summary()["plant"] == "crazyflie, point_mass, single_integrator, unicycle"
    assert run.arrival_time is not None
    assert 11.0 <= run.arrival_time <= 16.0
    assert run.barriers.min() >= 0.1
    assert run.distances.min() >= 0.24
    others = run.positions[:, :3] - run.positions[:, 3:]
    assert np.linalg.norm(others, axis=2).min() >= 0.2 + LOOK_AHEAD  # 0.2 m from the middle of the robot's axle
    np.testing.assert_allclose(run.agents[1].path[:, 2], 1.0, atol=0.1)  # the Crazyflie's height
    speeds = {i: np.linalg.norm(log.state[:, 2:], axis=1).max() for i, log in run.agents.items()}
    assert speeds[4] <= 0.2 + 1e-9  # the robot's wheels
    changes = np.diff(run.agents[3].state[:, 2:], axis=0) / 0.2
    assert abs(changes).max() <= 0.8 + 1e-9  # the heavy one


def test_start_errors_of_ten_centimetres_are_borne() -> None:
    rng = np.random.default_rng(5)
    starts = {1: (0.0, 1.0), 2: (0.0, -1.0), 3: (1.0, 0.0), 4: (-1.0, 0.0)}
    moved = [f"agents.{i}.start={(np.array(p) + 0.1 * rng.normal(size=2)).tolist()}" for i, p in starts.items()]
    run = dcf_zenoh.simulate("position_swap_mixed", topology="ring", changes=moved)
    assert run.arrival_time is not None
    assert run.barriers.min() >= 0.05


def test_states_in_the_plane_and_in_space_ride_on_lossy_messages_together() -> None:
    changes = [
        "controller.sharing=piggyback",
        "exchange.round_timeout=0.003",
        "exchange.max_rounds=40",
        "faults.loss=0.2",
    ]
    run = dcf_zenoh.simulate("position_swap_mixed", algorithm="trades_robust", topology="path", changes=changes)
    assert run.arrival_time is not None
    assert run.barriers.min() >= 0.05


def test_slow_computation_leaves_too_few_rounds_but_no_collision() -> None:
    run = dcf_zenoh.simulate("position_swap_mixed", changes=["exchange.compute_time=0.004"])
    assert run.summary()["ended_by"]["budget"] > 100
    assert run.arrival_time is not None
    assert run.barriers.min() >= 0.05


def test_daemons_do_what_the_simulator_does(tmp_path: Path) -> None:
    simulated = dcf_zenoh.simulate("position_swap_mixed", changes=["time.duration=2.0"])
    command = [sys.executable, "-m", "agentd", "launch", "position_swap_mixed", "--clock", "virtual"]
    options = ["--set", "time.duration=2.0", "--out", str(tmp_path / "run"), "--json", "--no-report"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["digest"] == simulated.digest
