"""Two agents that are too fast for the barrier in step 0: the stated fall-back flies on, and is counted."""

from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.errors import DcfError
from dcf_zenoh.records.run import Run

HEAD_ON = """
name = "head_on"
time = { sample_time = 0.2, duration = 2.0 }
exchange = { max_rounds = 300 }
problem = { kind = "position_swap" }
algorithm = { kind = "ALGORITHM" }
controller = { kind = "receding_horizon", infeasible = "HOW" }
plants.p = { kind = "point_mass" }
agents.1 = { start = [-0.6, 0.0], target = [1.0, 0.1], plants.p.velocity = [1.5, 0.0] }
agents.2 = { start = [0.6, 0.0], target = [-1.0, -0.1], plants.p.velocity = [-1.5, 0.0] }
"""
METHODS = ("centralised", "admm_mpc")


def flown(folder: Path, method: str, how: str) -> Run:
    fleet = folder / "fleet.toml"
    fleet.write_text(HEAD_ON.replace("ALGORITHM", method).replace("HOW", how))
    return dcf_zenoh.simulate(fleet)


def test_the_least_violation_flies_on_and_passes(tmp_path: Path) -> None:
    for method in METHODS:
        run = flown(tmp_path, method, "least_violation")
        assert run.summary()["notes"]["infeasible"] == 2  # both agents, in step 0
        assert run.agents[1].notes[0]["infeasible"] == 1
        assert all(len(log.step) == 10 for log in run.agents.values())


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("how", ["brake", "previous_plan"])
def test_without_a_solution_an_agent_brakes_as_hard_as_it_can(tmp_path: Path, method: str, how: str) -> None:
    run = flown(tmp_path, method, how)  # in step 0 there is no plan before
    first = run.agents[1].decision[0]
    np.testing.assert_allclose(first[:4], [-2.0, 0.0, -2.0, 0.0], atol=1e-12)
    assert run.summary()["notes"]["infeasible"] >= 2


@pytest.mark.parametrize("method", METHODS)
def test_fail_ends_the_run_and_names_the_key(tmp_path: Path, method: str) -> None:
    with pytest.raises(DcfError, match=r'step 0 .*is infeasible: .*controller.infeasible = "fail"'):
        flown(tmp_path, method, "fail")
