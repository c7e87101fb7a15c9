"""The paper's example with nonlinear Crazyflies."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from dcf_zenoh.analysis.metrics import overshoot
from dcf_zenoh.simulation import simulate

START = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]])  # the targets are opposite

TWO_SECONDS = "time.duration=2.0"


def test_position_swap_arrives_with_a_little_overshoot_and_without_a_collision() -> None:
    run = simulate("position_swap", plant="twin")
    assert run.arrival_time is not None
    assert 10 <= run.arrival_time <= 14
    assert run.distances.min() >= 0.2
    assert run.barriers.min() > 0.05
    assert 0.05 < (overshoot(run) or 0.0) < 0.2
    np.testing.assert_allclose(run.positions[0, :, :2], START, atol=0.01)
    np.testing.assert_allclose(run.positions[:, :, 2], 1.0, atol=0.03)


def test_noise_and_wind_repeat_with_the_seed_of_the_fleet() -> None:
    changes = ['plants.twin.sensing="lighthouse"', "plants.twin.wind.gusts=0.2", "time.duration=3.0"]
    first, again = (simulate("position_swap", plant="twin", changes=changes) for _ in range(2))
    other = simulate("position_swap", plant="twin", changes=changes, seed=2)
    assert first.digest == again.digest
    assert first.digest != other.digest


def test_daemons_and_simulator_agree_on_noise_wind_and_gusts(tmp_path: Path) -> None:
    changes = ['plants.twin.sensing="lighthouse"', "plants.twin.wind={mean=[0.2, 0.1], gusts=0.2}", TWO_SECONDS]
    simulated = simulate("position_swap", plant="twin", changes=changes)
    command = [sys.executable, "-m", "agentd", "launch", "position_swap", "--plant", "twin", "--clock", "virtual"]
    options = [word for change in changes for word in ("--set", change)]
    done = subprocess.run(
        [*command, *options, "--out", str(tmp_path / "run"), "--json", "--no-report"],
        capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["digest"] == simulated.digest
    calm = simulate("position_swap", plant="twin", changes=[changes[0], TWO_SECONDS])
    assert calm.digest != simulated.digest
