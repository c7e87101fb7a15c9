"""Every family of algorithms in fleets: simulated, over Zenoh with the same bits, and with kinds of one's own."""

from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.errors import NumericalError
from dcf_zenoh.plugins import known
from tests.support.daemons import launch_virtual

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

FLEETS = {
    "quadratic": [[1.0]] * 4,
    "allocation": [[4.0], [3.0], [1.5], [1.5]],
    "cournot": [[7 / 3], [4 / 3], [1 / 3], [0.0]],
    "two_players": [[1.0], [2.0]],
    "directed": [[4.0]] * 5,
}


@pytest.mark.parametrize("name", FLEETS)
def test_the_built_in_fleets_find_their_answers_and_agree_to_stop(name: str) -> None:
    run = dcf_zenoh.simulate(name)
    for log, answer in zip(run.agents.values(), FLEETS[name], strict=True):
        np.testing.assert_allclose(log.decision[-1], answer, atol=1e-7)
        assert log.stopped_by == ("agreed",)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("topology", ["complete", "ring", "star", "regular"])
@pytest.mark.parametrize("algorithm", ["extra", "consensus_admm", "edge_admm", "centralised"])
def test_another_algorithm_on_another_graph_finds_the_same(algorithm: str, topology: str, seed: int) -> None:
    changes = [f"topology.seed={seed}"] if topology == "regular" else []
    run = dcf_zenoh.simulate("quadratic", algorithm=algorithm, topology=topology, seed=seed, changes=changes)
    for log in run.agents.values():
        np.testing.assert_allclose(log.decision[-1], [1.0], atol=1e-8)
        assert log.stopped_by == ("agreed",)


@pytest.mark.parametrize(
    ("fleet", "algorithm"),
    [
        ("quadratic", "gradient_tracking"), ("quadratic", "dual_decomposition"), ("quadratic", "extra"),
        ("quadratic", "admm_tracking_gradient"), ("two_players", "pseudo_gradient_partial"),
    ],
)  # fmt: skip
def test_a_step_size_that_is_far_too_large_is_told_in_one_line_and_without_warnings(fleet: str, algorithm: str) -> None:
    with pytest.raises(
        NumericalError,
        match=r"^agent \d: step 0 round \d+: the algorithm's payload '\w' is not finite: -?inf at \[.*\]; it",
    ):
        dcf_zenoh.simulate(fleet, algorithm=algorithm, changes=["algorithm.step=1e6"])


@pytest.mark.parametrize("loss", [0.2, 0.5])
def test_the_lasso_bears_lost_messages_in_a_fleet(loss: float) -> None:
    exact = dcf_zenoh.simulate("lasso", algorithm="centralised", changes=["faults.loss=false"])
    run = dcf_zenoh.simulate("lasso", changes=[f"faults.loss={loss}"])
    assert run.summary()["messages"]["lost"] > 0
    for log in run.agents.values():
        np.testing.assert_allclose(log.decision[-1], exact.agents[1].decision[-1], atol=1e-6)


def test_the_position_swap_in_one_place_flies_as_the_exact_one() -> None:
    central = dcf_zenoh.simulate("position_swap", algorithm="centralised", topology="path")
    assert central.arrival_time == pytest.approx(10.6, abs=0.01)
    assert central.barriers.min() == pytest.approx(0.123, abs=1e-3)


# Every algorithm on its own problem, one after the other in one dialogue: three daemons instead of three for each.
EVERYTHING = """
import numpy as np
from pathlib import Path

from dcf_zenoh import Inbox
from dcf_zenoh.plugins import known, load
from dcf_zenoh.problems.average import Average
from dcf_zenoh.problems.cournot import Cournot
from dcf_zenoh.problems.distance_swap import DistanceSwap
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.problems.resource_allocation import ResourceAllocation

ROUNDS = 12
MEAN = ("average_consensus", "push_sum")
SHARED = ("dual_subgradient", "tracking_admm")
COUPLED = ("admm_mpc", "trades", "trades_robust")
GAMES = ("pseudo_gradient", "pseudo_gradient_partial", "trades_primal", *COUPLED)


def problem_for(name, me):
    if name in MEAN:
        return Average(value=[0.1 * me.id, -3.0])
    if name in SHARED:
        return ResourceAllocation(me.agents, demand=[2.0, 0.7], weight=1.0 + me.id)
    if name == "sqp_admm":
        states = {i: np.array([0.3 * i, 0.4 - 0.1 * i * i, -0.2 * i, 0.3]) for i in me.agents}
        return DistanceSwap(me.id, me.agents, 0.2, target=[0.0, 0.2]).at(states)
    if name in GAMES:
        return Cournot(me.id, me.agents, cost=0.3 * me.id, capacity=4.0 if name in COUPLED else None)
    return Quadratic(centre=[float(me.id), 0.1], weight=1.0 / me.id)


def everything(problem, me):
    decisions = []
    for name in sorted(known("algorithms")):
        if name == "pseudo_gradient" and me.neighbourhood.diameter > 1:
            continue
        me.forget()
        dialogue = load("algorithms", name, Path())(problem_for(name, me), me)
        payload, _ = next(dialogue)
        for number in range(1, ROUNDS + 1):
            inbox = yield payload, float("inf")
            heard = Inbox(inbox.own, inbox.payloads, stop=number == ROUNDS, missing=inbox.missing)
            try:
                payload, _ = dialogue.send(heard)
            except StopIteration as finished:
                decisions.append(finished.value.decision)
    return me.result(np.concatenate(decisions))
"""
TRIO = """
name = "trio"
[time]
sample_time = 20.0
[exchange]
max_rounds = 1000
[topology]
kind = "{topology}"
[problem]
kind = "average"
value = 0.0
[algorithm]
kind = "./everything.py:everything"
[agents]
1 = {{}}
2 = {{}}
5 = {{}}
"""


@pytest.mark.parametrize("topology", ["path", "complete"])
def test_every_algorithm_gives_the_same_bits_over_zenoh(topology: str, tmp_path: Path) -> None:
    (tmp_path / "everything.py").write_text(EVERYTHING)
    fleet = tmp_path / "trio.toml"
    fleet.write_text(TRIO.format(topology=topology))
    run = dcf_zenoh.simulate(fleet)
    assert run.agents[1].decision.shape[1] > len(known("algorithms"))
    rounds = 12 * (len(known("algorithms")) - (topology == "path"))
    assert all(log.rounds.tolist() == [rounds] for log in run.agents.values())
    launched = launch_virtual(fleet, tmp_path / "run")
    assert launched["digest"] == run.digest


def test_lossy_and_switching_fleets_and_one_with_bodies_give_the_same_bits_over_zenoh(tmp_path: Path) -> None:
    switching = ["faults.switching=0.5", "exchange.round_timeout=0.001", "exchange.missing=absent"]
    runs = {
        "lasso": ["exchange.max_rounds=60"],
        "rendezvous": ["time.duration=2.0"],
        "quadratic": [*switching, "exchange.max_rounds=60"],
    }
    for name, changes in runs.items():
        run = dcf_zenoh.simulate(name, changes=changes)
        options = [word for change in changes for word in ("--set", change)]
        assert launch_virtual(name, tmp_path / name, *options)["digest"] == run.digest


MINE = '''
"""A problem and an algorithm of one's own, in one file."""

import numpy as np

from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem


class Hyperbolic(ConsensusProblem):
    """f(x) = sqrt(1 + (x - centre)²): convex, smooth, and not a square."""

    strongly_convex = False

    def __init__(self, *, centre: float) -> None:
        self.size = 1
        self.centre = centre

    def cost(self, x):
        return float(np.sqrt(1 + (x[0] - self.centre) ** 2))

    def gradient(self, x):
        return (x - self.centre) / np.sqrt(1 + (x - self.centre) ** 2)

    def argmin(self, slope, weight):
        x = np.full(1, self.centre)
        for _ in range(60):  # Newton, damped by the weight
            curvature = (1 + (x - self.centre) ** 2) ** -1.5 + weight
            x = x - (self.gradient(x) + slope + weight * x) / (curvature + 1.0)
        return x


@needs(ConsensusProblem, traits=("smooth",), doubly_stochastic=True)
def heavy_ball(problem, me, *, step: float = 0.1, momentum: float = 0.3):
    """Gradient tracking with momentum."""
    x = before = problem.start(me.last)
    y = own = problem.gradient(x)
    change = float("inf")
    while True:
        inbox = yield {"x": x - step * y + momentum * (x - before), "y": y}, change
        x, before = me.mix(inbox, "x"), x
        gradient = problem.gradient(x)
        y, own = me.mix(inbox, "y") + gradient - own, gradient
        change = float(abs(x - before).max())
        if inbox.stop:
            return me.result(x)
'''
OWN = """
name = "own"
[time]
sample_time = 20.0
[exchange]
max_rounds = 2000
threshold = 1e-11
[topology]
kind = "path"
[problem]
kind = "./mine.py:Hyperbolic"
[algorithm]
kind = "./mine.py:heavy_ball"
[agents]
1.problem.centre = 0.0
2.problem.centre = 1.0
3.problem.centre = 5.0
"""


def test_a_problem_and_an_algorithm_of_one_s_own_run_in_the_simulator_and_in_daemons(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    fleet = tmp_path / "own.toml"
    fleet.write_text(OWN)
    grid = np.linspace(0.0, 5.0, 500_001)
    best = grid[np.argmin(sum(np.sqrt(1 + (grid - centre) ** 2) for centre in (0.0, 1.0, 5.0)))]
    mine = dcf_zenoh.simulate(fleet)
    for log in mine.agents.values():
        np.testing.assert_allclose(log.decision[-1], [best], atol=1e-5)
    assert launch_virtual(fleet, tmp_path / "run")["digest"] == mine.digest
    for algorithm in ("gradient_tracking", "extra", "edge_admm"):  # built-in ones on a problem of one's own
        other = dcf_zenoh.simulate(fleet, algorithm=algorithm)
        for log in other.agents.values():
            np.testing.assert_allclose(log.decision[-1], [best], atol=1e-5)
