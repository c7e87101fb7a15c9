"""The examples run, and their answers are right by a closed form or an independent solver."""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import dcf_zenoh
from agentd.cli import main
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Setpoint
from dcf_zenoh.testing import check_fault, check_plant, check_problem, check_topology

EXAMPLES = Path(__file__).parents[2] / "examples"
FLEETS = sorted(EXAMPLES.glob("*/*.toml"))
NOTEBOOK = EXAMPLES / "notebook" / "first_flight.ipynb"
SLOT = 0.002  # s


def read(path: str) -> dict[str, Any]:
    """What a Python file of the examples defines."""
    return runpy.run_path(str(EXAMPLES / path))


@pytest.mark.parametrize("fleet", FLEETS, ids=lambda path: path.stem)
def test_fleet_files_pass_the_check(fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(fleet), "--load"]) == 0, capsys.readouterr().err


def test_readme_has_a_row_for_every_example() -> None:
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    named = {path.removeprefix("examples/") for path in re.findall(r"examples/[\w/]+\.\w+", text)}
    assert all((EXAMPLES / path).is_file() for path in named)
    assert {path.relative_to(EXAMPLES).as_posix() for path in [*FLEETS, NOTEBOOK]} <= named
    assert {path.name for path in EXAMPLES.iterdir() if path.is_dir()} == {path.split("/")[0] for path in named}


def test_my_algorithm_keeps_the_contract_and_finds_the_central_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES / "algorithm")
    assert read("algorithm/check_my_tracking.py")["check"]() < 1e-8


def test_my_algorithm_flies_the_swap() -> None:
    run = dcf_zenoh.simulate(EXAMPLES / "algorithm" / "my_swap.toml")
    assert run.arrival_time is not None
    ends = {i: run.positions[-1, place] for place, i in enumerate(run.agents)}
    for i, target in {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}.items():
        np.testing.assert_allclose(ends[i], target, atol=0.05)
    assert run.barriers.min() >= 0.11


@pytest.mark.parametrize("algorithm", [None, "gradient_tracking"])
def test_my_problem_finds_the_beacon_by_least_squares(algorithm: str | None) -> None:
    bearings, weights = np.radians([45, 135, 210, 270]), np.sqrt([1, 1, 2, 0.5])
    normals = np.column_stack((-np.sin(bearings), np.cos(bearings)))
    offsets = (normals * [[0, 0], [4, 0], [4, 3], [2, 4]]).sum(axis=1)
    beacon = np.linalg.lstsq(normals * weights[:, None], offsets * weights)[0]
    run = dcf_zenoh.simulate(EXAMPLES / "problem" / "beacon.toml", algorithm=algorithm)
    for log in run.agents.values():
        np.testing.assert_allclose(log.decision[-1], beacon, atol=1e-6)


def test_my_problem_keeps_the_contract() -> None:
    bearing = read("problem/bearings.py")["Bearing"]
    check_problem(lambda: bearing(place=[1.0, -2.0], bearing=30.0, weight=2.0))


def test_my_plant_keeps_the_contract_and_tends_to_its_largest_speed() -> None:
    boat = read("plant/boat.py")["Boat"]
    check_plant(lambda: boat([1.0, 2.0]))
    made, end = boat([0.0, 0.0], time_constant=2.0, accel_max=1.5), 3.0
    made.act(Setpoint(acceleration=np.array([5.0, -0.5])), 0)  # the first component saturates
    for instant in (1.0, 2.5):
        made.sense(round(instant * 1e9))
    state = made.sense(round(end * 1e9))
    left = np.exp(-end / 2.0)
    speed = np.array([1.5, -0.5]) * 2.0
    np.testing.assert_allclose(state.velocity, speed * (1 - left))
    np.testing.assert_allclose(state.position, speed * (end - 2.0 * (1 - left)))


def test_my_plants_meet_at_the_mean_of_their_starts() -> None:
    run = dcf_zenoh.simulate(EXAMPLES / "plant" / "harbour.toml")
    assert run.arrival_time is not None
    np.testing.assert_allclose(run.positions.mean(axis=1), [[1.0, 0.0]] * run.steps, atol=1e-3)  # drag is linear
    np.testing.assert_allclose(run.positions[-1], [[1.0, 0.0]] * 4, atol=0.05)


def test_my_topology_keeps_the_contract_and_has_one_bridge() -> None:
    barbell = read("topology/barbell.py")["barbell"]
    check_topology(barbell)
    graph = Graph.of(range(1, 7), barbell((1, 2, 3, 4, 5, 6), bridge=(2, 5)))
    assert (len(graph.links), graph.diameter) == (14, 3)
    assert {link for link in graph.links if (link[0] <= 3) != (link[1] <= 3)} == {(2, 5), (5, 2)}
    with pytest.raises(ValueError, match="bridge must join"):
        barbell((1, 2, 3, 4), bridge=(1, 2))


def test_my_topology_leads_to_the_mean() -> None:
    run = dcf_zenoh.simulate(EXAMPLES / "topology" / "rooms.toml")
    for log in run.agents.values():
        np.testing.assert_allclose(log.decision[-1], 11.0, atol=1e-6)


def test_my_fault_keeps_the_contract() -> None:
    slots = read("fault/time_slots.py")["TimeSlots"]
    check_fault(lambda: slots(3, slot=0.002, count=4))


def test_my_fault_puts_every_message_in_a_slot_of_its_sender() -> None:
    run = dcf_zenoh.simulate(EXAMPLES / "fault" / "slotted_radio.toml")
    for i, log in run.agents.items():
        np.testing.assert_allclose(log.decision[-1], 3.5, atol=1e-9)
        last = max(j % 4 for j in run.agents if j != i)  # the slot of a frame in which the last of the others sends
        assert log.negotiation[-1] == pytest.approx((last + 4 * (log.rounds[-1] - 1)) * SLOT)


def test_notebook_flies_breaks_and_mends_the_swap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all((cell["outputs"], cell["execution_count"]) == ([], None) for cell in cells)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    with mpl.rc_context({"backend": "Agg"}):
        for cell in cells:
            exec("".join(cell["source"]), names)  # noqa: S102
        plt.close("all")
    perfect, broken, robust = (names[name] for name in ("perfect", "broken", "robust"))
    for run in (perfect, robust):
        ends = {i: run.positions[-1, place] for place, i in enumerate(run.agents)}
        for i, log in run.agents.items():
            np.testing.assert_allclose(ends[i], -log.state[0, :2], atol=0.05)  # the opposite corner
        assert run.barriers.min() > 0
    assert broken.arrival_time is None
    assert broken.barriers.min() < 0
    assert list(tmp_path.iterdir()) == []
