"""The central solution beside a run."""

from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.analysis.oracle import consult
from dcf_zenoh.records.run import Run

TIGHT = ("exchange.threshold=1e-10", "exchange.max_rounds=3000", "time.duration=2.0")


def run_of(fleet: str, *changes: str, algorithm: str | None = None) -> Run:
    return dcf_zenoh.simulate(fleet, algorithm=algorithm, changes=changes)


@pytest.mark.parametrize("topology", ["complete", "path"])
def test_rounds_without_end_come_to_the_central_decision(topology: str) -> None:
    found = consult(dcf_zenoh.simulate("position_swap", topology=topology, changes=TIGHT))
    assert not found.unsolved
    assert found.gap.shape == found.plan_gap.shape == found.residual.shape == (10, 4)
    assert found.gap.max() < 1e-6
    assert found.plan_gap.max() < 1e-7
    assert found.violation.max() < 1e-7
    assert found.residual.max() < 1e-10


def test_the_earlier_rounds_stop_the_farther_the_decisions_are_from_the_central_ones() -> None:
    found = [
        consult(run_of("position_swap", f"exchange.threshold={each}", "time.duration=5.0"))
        for each in (1e-2, 1e-3, 1e-4)
    ]
    plans = [each.plan_gap.max() for each in found]
    assert plans[0] > 3 * plans[1] > 9 * plans[2]
    assert plans[1] < 1.3e-3  # m; how far closed loops were apart at this threshold
    assert [each.residual.max() < limit for each, limit in zip(found, (1e-2, 1e-3, 1e-4), strict=True)] == [True] * 3
    assert found[0].violation.max() > found[2].violation.max() > 0


def test_a_biased_method_is_farther_off_under_loss() -> None:
    plain, robust = (
        consult(run_of("position_swap_lossy", "time.duration=5.0", algorithm=each)) for each in ("plain", "robust")
    )
    assert np.median(plain.plan_gap) > 5 * np.median(robust.plan_gap)
    assert plain.violation.max() > robust.violation.max()


def test_detours_and_predicted_states_are_part_of_what_was_solved() -> None:
    found = consult(
        run_of(
            "position_swap_random",
            "exchange.threshold=1e-7",
            "exchange.max_rounds=1000",
            "time.duration=4.0",
            "controller.predict_delay=0.1",
        )
    )
    assert not found.unsolved
    assert found.gap.max() < 1e-5


def test_steps_without_some_agent_are_not_judged() -> None:
    changes = (
        "agents.3.faults.crash={at=1.0, restart_after=1.0}",
        "time.duration=4.0",
        "safety.neighbour_silent.then='continue'",
    )
    found = consult(run_of("position_swap_lossy", *changes))
    absent = [step for step, why in found.unsolved.items() if why == "took no part: 3"]
    assert absent
    assert set(absent) <= set(range(5, 12))
    rows = np.isin(found.step, list(found.unsolved))
    assert np.isnan(found.gap[rows]).all()
    assert np.isfinite(found.gap[~rows]).all()


def test_a_run_whose_log_is_missing_is_not_judged(tmp_path: Path) -> None:
    dcf_zenoh.simulate("position_swap_random", changes=["time.duration=0.6"], out=tmp_path / "run")
    (tmp_path / "run" / "agent-2.msgpack").unlink()
    assert set(consult(Run.read(tmp_path / "run")).unsolved.values()) == {"took no part: 2"}
