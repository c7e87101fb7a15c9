"""Same seed, same bits: in the simulator in any order of agents, and in daemons over Zenoh, on any topology."""

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.records.run import Run
from tests.support.daemons import both_cores_busy, launch_virtual
from tests.support.references import INSTANCES, Reference

pytestmark = pytest.mark.no_cover  # many rounds of the same lines

EXAMPLES = Path(__file__).parents[2] / "examples"
TEN_STEPS = "time.duration=2.0"


@pytest.mark.parametrize("fleet", ["position_swap", "position_swap_six", "average"])
def test_the_order_in_which_the_simulator_resumes_agents_does_not_matter(fleet: str) -> None:
    digests = {dcf_zenoh.simulate(fleet, changes=[TEN_STEPS]).digest}
    for seed in range(3):
        order = random.Random(seed)
        digests.add(dcf_zenoh.simulate(fleet, changes=[TEN_STEPS], choose=order.randrange).digest)
    assert len(digests) == 1


def test_a_recorded_run_equals_one_that_is_kept_in_memory(tmp_path: Path) -> None:
    memory = dcf_zenoh.simulate("position_swap", changes=[TEN_STEPS])
    recorded = dcf_zenoh.simulate("position_swap", changes=[TEN_STEPS], out=tmp_path / "run")
    assert recorded.digest == memory.digest
    assert Run.read(tmp_path / "run").digest == memory.digest


ODD = """
from dcf_zenoh import PerNeighbour
def edges(problem, me):
    x = problem.value
    while True:
        inbox = yield PerNeighbour({j: {"x": x + j, "n": me.id} for j in me.neighbourhood.sends_to}), 1.0
        x = x + 0.1 * sum(inbox[j]["x"] for j in inbox)
        if inbox.stop:
            return me.result(x)
def early(game, me, *, who=(3,), after=4):
    u = game.start(me.last)
    for number in range(10**6):
        inbox = yield {"u": u}, 1.0 / (1 + number)
        u = game.project(0.9 * u + 0.01 * me.mix(inbox, "u") - 0.05 * game.gradient(u, game.contribution(u)))
        if inbox.stop or (me.id in who and number >= after):
            return me.result(u)
"""
OVERRUN = ["exchange.compute_time=0.045", "exchange.round_timeout=0.01", "time.duration=8.0", "time.arrived.within=0.2"]


@pytest.mark.parametrize(
    ("fleet", "algorithm", "changes"),
    [
        ("average", "edges", ["exchange.max_rounds=20"]),
        ("average", "edges", ["exchange.max_rounds=20", "topology.kind=edges", "topology.directed=true",
                              "topology.links=[[1,2],[2,3],[3,4],[4,5],[5,1],[1,4]]"]),
        pytest.param("position_swap", "early", [*OVERRUN, "topology.kind=star"], marks=pytest.mark.large),
        ("position_swap", "early", [*OVERRUN, "topology.kind=path", "exchange.missing=absent", "exchange.margin=3"]),
        ("position_swap", "early", ["exchange.compute_time=0.03", "agents.2.faults.slow.factor=5", "topology.kind=path",
                                     "exchange.late=hold"]),
    ],
)  # fmt: skip
def test_overruns_time_outs_early_leavers_and_edge_payloads_are_reproduced(
    fleet: str, algorithm: str, changes: list[str], tmp_path: Path
) -> None:
    (tmp_path / "odd.py").write_text(ODD)
    kind = f"{tmp_path}/odd.py:{algorithm}"
    runs = [dcf_zenoh.simulate(fleet, algorithm=kind, changes=changes)]
    for seed in range(2):
        order = random.Random(seed).randrange
        runs.append(dcf_zenoh.simulate(fleet, algorithm=kind, changes=changes, choose=order))
    options = [word for change in changes for word in ("--set", change)]
    launched = launch_virtual(fleet, tmp_path / "run", "--algorithm", kind, *options)
    assert {run.digest for run in runs} == {launched["digest"]}
    assert {json.dumps(run.summary()["messages"]) for run in runs} == {json.dumps(launched["messages"])}


@pytest.mark.parametrize(
    "topology",
    [
        "path",
        *(pytest.param(each, marks=pytest.mark.large) for each in ("complete", "ring", "star")),
    ],  # others fly them
)
def test_daemons_do_what_the_simulator_does(topology: str, tmp_path: Path) -> None:
    changes = ["time.duration=3.0"]
    simulated = dcf_zenoh.simulate("position_swap", topology=topology, changes=changes)
    launched = launch_virtual("position_swap", tmp_path / "run", "--topology", topology, "--set", *changes)
    assert launched["digest"] == simulated.digest
    assert launched["steps"] == 15


@pytest.mark.large
def test_a_larger_fleet_does_what_the_simulator_does_again_and_again(tmp_path: Path) -> None:
    simulated = dcf_zenoh.simulate("position_swap_six", changes=[TEN_STEPS])
    for attempt in range(2):
        launched = launch_virtual("position_swap_six", tmp_path / f"run{attempt}", "--set", TEN_STEPS)
        assert launched["digest"] == simulated.digest


def test_the_load_of_the_machine_does_not_matter(tmp_path: Path) -> None:
    simulated = dcf_zenoh.simulate("position_swap", topology="ring", changes=[TEN_STEPS])
    with both_cores_busy():
        launched = launch_virtual("position_swap", tmp_path / "run", "--topology", "ring", "--set", TEN_STEPS)
    assert launched["digest"] == simulated.digest


def test_a_full_swap_over_zenoh_is_the_simulated_one_and_arrives(tmp_path: Path) -> None:
    simulated = dcf_zenoh.simulate("position_swap")
    launched = launch_virtual("position_swap", tmp_path / "run")
    assert launched["digest"] == simulated.digest
    assert launched["arrived"]
    assert 9.5 <= launched["arrival_time"] <= 13.0
    assert launched["min_barrier"] >= 0.11
    assert launched["min_distance"] >= 0.25


@pytest.mark.parametrize("fleet", ["position_swap_six", pytest.param("position_swap_ten", marks=pytest.mark.large)])
def test_larger_fleets_arrive_without_collision(fleet: str, tmp_path: Path) -> None:
    summary = dcf_zenoh.simulate(fleet).summary()
    first = ("--set", "time.duration=1.0")
    simulated = dcf_zenoh.simulate(fleet, changes=first[1:])
    assert launch_virtual(fleet, tmp_path / "run", *first)["digest"] == simulated.digest
    assert summary["arrived"]
    assert summary["min_barrier"] >= 0.0


@pytest.mark.parametrize("name", INSTANCES)
def test_the_distributed_solution_is_the_equilibrium_in_the_simulator_and_over_zenoh(name: str, tmp_path: Path) -> None:
    reference = Reference.read(name)
    file = tmp_path / f"{name}.toml"
    file.write_text(reference.fleet_file(rounds=2500, threshold=1e-10))
    simulated = dcf_zenoh.simulate(file)
    shadow = np.array(reference.data["A_lambda"]).reshape(len(reference.agents), 6)
    for i, log in simulated.agents.items():
        np.testing.assert_allclose(log.decision[0], reference.expected("u_star", i), atol=1e-6)
        lam = np.array(log.rounds_log[0][-1][3]["lam"])
        np.testing.assert_allclose(reference.games[i].A.T @ lam, shadow[i], atol=1e-6)
    if name == "n6_line_nonpotential":  # six agents on a line
        rounds = "exchange.max_rounds=300"
        launched = launch_virtual(file, tmp_path / "run", "--set", rounds)
        assert launched["digest"] == dcf_zenoh.simulate(file, changes=[rounds]).digest


def test_average_consensus_finds_the_mean(tmp_path: Path) -> None:
    simulated = dcf_zenoh.simulate("average")
    for log in simulated.agents.values():
        np.testing.assert_allclose(log.decision, [[4.0]], atol=1e-8)
    assert launch_virtual("average", tmp_path / "run")["digest"] == simulated.digest


def test_an_algorithm_in_a_file_of_its_own_flies_in_the_simulator_and_in_daemons(tmp_path: Path) -> None:
    file = EXAMPLES / "algorithm" / "my_swap.toml"  # the whole flight: tests/system/test_examples.py
    begun = dcf_zenoh.simulate(file, changes=[TEN_STEPS])
    assert launch_virtual(file, tmp_path / "run", "--set", TEN_STEPS)["digest"] == begun.digest


def test_another_seed_is_another_run_only_where_chance_plays(tmp_path: Path) -> None:
    (tmp_path / "coin.py").write_text(
        "import numpy as np\n"
        "def coin(problem, me):\n"
        "    inbox = yield {'x': me.rng.normal(size=2)}, 0.0\n"
        "    return me.result(me.mix(inbox, 'x'))\n"
    )
    kind = f"{tmp_path}/coin.py:coin"
    digests = [dcf_zenoh.simulate("average", algorithm=kind, seed=seed).digest for seed in (1, 1, 2)]
    assert digests[0] == digests[1] != digests[2]


def test_what_came_in_cannot_be_changed_by_one_receiver_for_the_others(tmp_path: Path) -> None:
    (tmp_path / "grasping.py").write_text(
        "def grasping(problem, me):\n"
        "    inbox = yield {'x': problem.value}, 0.0\n"
        "    for j in inbox:\n"
        "        inbox[j]['x'] = 100.0\n"
        "    return me.result(me.mix(inbox, 'x'))\n"
    )
    with pytest.raises(AlgorithmError, match=r"item assignment \(grasping.py:4\)$"):
        dcf_zenoh.simulate("average", algorithm=f"{tmp_path}/grasping.py:grasping")


LARGE = """
import numpy as np
def large(problem, me):
    rng = np.random.default_rng(me.id)
    a, x = rng.normal(size=(600, 600)) / 600, rng.normal(size=(600, 40))
    while True:
        inbox = yield {"x": x}, 1.0
        x = a @ x + me.mix(inbox, "x")
        if inbox.stop:
            return me.result(x.sum(axis=1))
"""


LARGE_FLEET = """
name = "large"
problem = { kind = "average", value = 1.0 }
algorithm = { kind = "./large.py:large" }
topology = { kind = "ring" }
exchange = { max_rounds = 12 }
agents = { 1 = {}, 2 = {}, 3 = {} }
"""


@pytest.mark.parametrize(
    "fleet", ["large", *(pytest.param(each, marks=pytest.mark.large) for each in ("position_swap", "lasso"))]
)
def test_threads_of_the_linear_algebra_change_nothing(fleet: str, tmp_path: Path) -> None:
    (tmp_path / "large.py").write_text(LARGE)  # matrices for which OpenBLAS uses all its threads
    (tmp_path / "large.toml").write_text(LARGE_FLEET)
    which = [str(tmp_path / "large.toml")] if fleet == "large" else [fleet, "--set", "time.duration=1.0"]
    digests = set()
    for threads in ("1", "4"):
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        settings = os.environ | dict.fromkeys(names, threads)
        for how in (["simulate"], ["launch", "--clock", "virtual"]):
            out = str(tmp_path / f"{how[0]}-{threads}")
            command = [sys.executable, "-m", "agentd", *how, *which, "--json", "--no-report", "--out", out]
            done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False, env=settings)
            assert done.returncode == 0, done.stderr
            digests.add(json.loads(done.stdout)["digest"])
    assert len(digests) == 1
