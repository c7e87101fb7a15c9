"""The robust method in the real simulator, over links that lose and delay: the equilibrium, and the closed loop."""

from pathlib import Path

import pytest

import dcf_zenoh
from tests.support.references import Reference

SEEDS = range(10)
# Flights in every `make test`: each case once, each topology twice. The other seeds are large.
OFTEN = {
    ("a fifth lost, 40 rounds", "complete", 0),
    ("half lost, 40 rounds", "ring", 0),
    ("half lost, 150 rounds", "complete", 0),
    ("three rounds late", "ring", 0),
}
# Rounds end after 50 us, so that the step's decision acts almost at its beginning, as without losses.
SWIFT = [
    "exchange.round_timeout=5e-5",
    "exchange.compute_time=0.0",
    "controller.predict_delay=0.0",
    "faults.rule=[]",
    "faults.latency=0.0",
]
CASES = {
    "a fifth lost, 40 rounds": (0.1, ["exchange.max_rounds=40", "faults.loss=0.2"]),
    "half lost, 40 rounds": (0.05, ["exchange.max_rounds=40", "faults.loss=0.5"]),
    "half lost, 150 rounds": (0.12, ["exchange.max_rounds=150", "faults.loss=0.5"]),
    "three rounds late": (0.12, ["exchange.max_rounds=150", "faults.loss=0.0", "faults.latency=1.5e-4"]),
}


FLIGHTS = [
    pytest.param(case, topology, seed, marks=() if (case, topology, seed) in OFTEN else pytest.mark.large)
    for case in CASES
    for topology in ("complete", "ring")
    for seed in (SEEDS if "lost" in case else SEEDS[:1])  # nothing is drawn where nothing is lost
]


@pytest.mark.parametrize(("case", "topology", "seed"), FLIGHTS)
def test_all_arrive_and_keep_their_distance(case: str, topology: str, seed: int) -> None:
    least, changes = CASES[case]
    run = dcf_zenoh.simulate("position_swap_lossy", topology=topology, seed=seed, changes=[*SWIFT, *changes])
    assert run.arrival_time is not None
    assert run.barriers.min() >= least


# All four instances: test_trades_robust.py.
@pytest.mark.parametrize("name", ["n4_line_agg", pytest.param("n6_line_nonpotential", marks=pytest.mark.large)])
def test_loss_leaves_no_bias_but_in_the_plain_method(name: str, tmp_path: Path) -> None:
    reference = Reference.read(name)
    file = tmp_path / "fleet.toml"
    file.write_text(reference.fleet_file(rounds=1600, threshold=0.0))
    changes = ["controller.kind='receding_horizon'", "controller.sharing='piggyback'", "exchange.round_timeout=1e-6"]
    errors = {}
    for algorithm, rounds in (("trades_robust", 1600), ("trades", 300)):
        now = [*changes, "faults.loss=0.5", f"exchange.max_rounds={rounds}"]
        run = dcf_zenoh.simulate(file, algorithm=algorithm, seed=3, changes=now)
        decisions = {i: log.decision[0] for i, log in run.agents.items()}
        errors[algorithm] = max(abs(u - reference.expected("u_star", i)).max() for i, u in decisions.items())
    assert errors["trades_robust"] < 1e-9
    assert errors["trades"] > 1e-3
