"""The attitude estimate takes rotor drag for tilt, as the firmware's does where only positions are measured.

The numbers of one drone on the way of `position_swap` were measured with the real firmware, compiled for a host: with
Lighthouse it arrives after 6.2 to 6.4 s with 0.15 to 0.16 m overshoot, with the attitude measured after 4.2 s and
0.010 m.
"""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from plants.crazyflie.model.attitude_estimate import GRAVITY, AttitudeEstimate, gains

PERIOD = 0.01  # s


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`position_swap` with agent 1 alone, a vehicle like that of the measurement."""
    head, *agents = re.split(r"(?m)^(?=\[agents\.)", (files("agentd.fleets") / "position_swap.toml").read_text())
    path = tmp_path_factory.mktemp("alone") / "alone.toml"
    path.write_text(head + "".join(each for each in agents if each.startswith("[agents.1")))
    return path


@pytest.mark.parametrize(
    ("sensing", "arrives", "overshoot", "within"), [("lighthouse", 6.3, 0.155, 0.03), ("perfect", 4.2, 0.010, 0.02)]
)
def test_one_drone_arrives_and_overshoots_as_with_the_real_firmware(
    sensing: str, arrives: float, overshoot: float, within: float, alone: Path
) -> None:
    changes = [f"plants.twin.sensing='{sensing}'", "plants.twin.parameters='cf2x_p250'"]
    run = dcf_zenoh.simulate(alone, plant="twin", changes=changes)
    assert run.arrival_time == pytest.approx(arrives, rel=0.1)
    beyond = max(0.0, -1.0 - float(run.positions[:, 0, 1].min()))
    assert beyond == pytest.approx(overshoot, abs=within)


def level(seconds: float, drag: float, *, measured: bool = True) -> AttitudeEstimate:
    """A body that stays level and is slowed down by drag, m/s², along x."""
    estimate = AttitudeEstimate(PERIOD)
    up = np.array([0.0, 0.0, 1.0])
    for k in range(round(seconds / PERIOD)):
        estimate.step(np.array([-drag * PERIOD * k, 0.0, 0.0]), up, measured=measured)
    return estimate


def test_constant_drag_is_taken_for_tilt_within_seconds() -> None:
    assert level(6.0, 0.2).tilt == pytest.approx([-0.2 / GRAVITY, 0.0], abs=1e-4)
    assert abs(level(0.3, 0.2).tilt[0]) < 0.3 * 0.2 / GRAVITY


def test_without_positions_the_tilt_stays_as_the_gyroscope_has_it() -> None:
    assert level(3.0, 0.2, measured=False).tilt == pytest.approx([0.0, 0.0])


def test_measured_attitude_leaves_no_error() -> None:
    estimate = level(6.0, 0.2)
    for _ in range(50):
        estimate.measure()
    assert abs(estimate.tilt).max() < 1e-5


def test_gains_are_those_of_a_stable_filter() -> None:
    position, velocity, tilt = gains(PERIOD)
    step = np.array([[1.0, PERIOD, 0.0], [0.0, 1.0, GRAVITY * PERIOD], [0.0, 0.0, 1.0]])
    closed = (np.eye(3) - np.outer([position, velocity, tilt], [1.0, 0.0, 0.0])) @ step
    assert max(abs(np.linalg.eigvals(closed))) < 1.0
