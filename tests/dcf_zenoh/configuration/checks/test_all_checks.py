from pathlib import Path

import pytest

from dcf_zenoh.config import Overrides, graph_of, load
from tests.support.fleet_files import MINE, edit, problems


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("exchange.budget=0.3", "exchange.budget: expected at most time.sample_time = 0.2 s, not 0.3 s"),
        ("plant=pont", "plant: there is no [plants.pont]; there are: point_mass"),
        ("agents.1.plants.twin.mass=1", "agents.1.plants.twin: there is no [plants.twin]; there are: point_mass"),
        (
            "agents.1.plants.point_mass.kind=x",
            "agents.1.plants.point_mass.kind: expected other keys of [plants.point_mass];",
        ),
        (
            "agents.1.problem.kind=x",
            "agents.1.problem.kind: expected other keys of [problem]; the kind is given there alone",
        ),
        ("agents.1.problem.target=[1]", "agents.1.problem.target: given twice: also as agents.1.target"),
        ("agents.2.start=[0,0,1]", "agents.2.start: expected 2 components as in agents.1.start, not 3"),
        ("agents.4.target=[0,0]", "agents.4.start: missing; plant 'point_mass' starts at a position, in m"),
        ("agents.4.start=[0,0]", "agents.4.target: missing; Meet needs a list of numbers"),
        ("problem.kind=average", "problem.value: missing; Average needs a number or a list of numbers"),
        ("controller.kind=solve_onse", "controller.kind: unknown kind 'solve_onse'; did you mean 'solve_once'?"),
        ("algorithms.fine.x=1", "algorithms.fine.x: descend has no key 'x'; accepted: step, relax"),
        ("algorithms.other.x=1", "algorithms.other.kind: unknown kind 'other'; known algorithms: "),
        ("plants.other={}", "plants.other.kind: unknown kind 'other'; known plants: "),
        ("topology.kind=edges", "topology.links: missing; edges needs a list of lists of 2 whole numbers"),
    ],
)
def test_problem_is_named_with_what_is_allowed(file: Path, change: str, problem: str) -> None:
    found = problems(file, change)
    assert any(text.startswith(problem) for text in found), found


def test_target_of_a_problem_without_one_is_refused(file: Path) -> None:
    assert "agents.1.target: Average has no key 'target'; accepted: value" in problems(file, "problem.kind=average")


def test_agents_must_choose_when_there_are_several_plants(file: Path) -> None:
    edit(file, "[agents.1]", "[plants.other]\nkind = './mine.py:Blimp'\n[agents.1]\nplant = 'other'")
    assert problems(file) == [
        f"agents.{i}.plant: missing; either all agents have a plant or none: choose one of point_mass, other here, for"
        " all agents by plant = ..., or by --plant"
        for i in (2, 3)
    ]


@pytest.mark.parametrize("clock", ["wall", "virtual"])
def test_either_all_agents_have_a_plant_or_none(file: Path, clock: str) -> None:
    edit(file, "[plants.point_mass]", "[plants.other]\nkind = './mine.py:Blimp'\n[plants.point_mass]")
    plants = ["agents.1.plant=point_mass", "agents.2.plant=other"]
    assert problems(file, *plants, clock=clock) == [
        "agents.3.plant: missing; either all agents have a plant or none: choose one of other, point_mass here, for"
        " all agents by plant = ..., or by --plant"
    ]
    assert load(file, Overrides(clock=clock), changes=[*plants, "agents.3.plant=other"]).spec.has_plants


def test_disconnected_topology_names_who_cannot_be_reached(file: Path) -> None:
    change = "topology={kind = 'edges', links = [[1, 2]]}"
    assert problems(file, change) == ["topology: the graph is not connected: nothing agent 1 sends can reach agent 3"]


def test_metropolis_weights_on_a_directed_ring_are_refused(file: Path) -> None:
    assert problems(file, "topology.directed=true", "topology.weights=metropolis")[0].startswith(
        "topology.weights: Metropolis weights need an undirected graph, and link 1 -> 2 has no opposite"
    )


def test_topology_that_fails_while_it_is_read_refused_its_options(file: Path) -> None:
    (file.parent / "bad.py").write_text("def bad(agents):\n    yield 1, 2\n    raise KeyError('oops')")
    assert problems(file, topology="./bad.py:bad") == ["topology: ./bad.py:bad refused its options: KeyError: 'oops'"]


def test_worst_case_of_a_step_is_noted(file: Path) -> None:
    assert load(file, changes=["exchange.round_timeout=0.003"]).notes == (
        "exchange: worst case 200 x 3 ms = 0.600 s > budget 0.150 s: a step may end by time, not by agreement",
    )
    assert load(file, changes=["exchange.round_timeout=0.003", "exchange.max_rounds=50"]).notes == ()


def test_endpoint_of_two_agents_is_refused(file: Path) -> None:
    changes = ["agents.1.endpoint=tcp/10.0.0.1:7447", "agents.3.endpoint=tcp/10.0.0.1:7447"]
    assert problems(file, *changes) == ["agents.3.endpoint: tcp/10.0.0.1:7447 is taken by agent 1; each needs its own"]
    assert load(file, changes=[changes[0], "agents.3.endpoint=tcp/10.0.0.1:7448"]).notes == ()


def test_step_needs_more_rounds_than_the_diameter_of_the_graph(file: Path) -> None:
    for agents, diameter in ((3, 2), (4, 3)):
        changes = ["topology.kind=path"]
        if agents == 4:
            changes += ["agents.4.start=[2.0, 2.0]", "agents.4.target=[0.0, 0.0]"]
        assert problems(file, *changes, f"exchange.max_rounds={diameter}") == [
            f"exchange.max_rounds: expected more than {diameter} (the diameter of the graph: sharing states and"
            f" agreeing take so many rounds), not {diameter}"
        ]
        fleet = load(file, changes=[*changes, f"exchange.max_rounds={diameter + 1}"])
        assert graph_of(fleet).diameter == diameter


def test_diameter_of_a_topology_that_was_not_drawn_is_not_checked(file: Path) -> None:
    changes = ["topology.kind=./mine.py:spokes", "topology.hub=2", "exchange.max_rounds=1"]
    assert load(file, changes=changes, run_plugins=False).spec.exchange.max_rounds == 1


def test_third_party_code_runs_only_on_request(file: Path) -> None:
    (file.parent / "mine.py").write_text("1 / 0\n" + MINE)
    assert "ZeroDivisionError" in problems(file)[0]
    fleet = load(file, run_plugins=False)
    assert fleet.notes == (
        "problem: ./mine.py:Meet was not run, so its keys are checked by name at most",
        "algorithm: ./mine.py:descend was not run, so its keys are checked by name at most",
        "algorithms.fine: ./mine.py:descend was not run, so its keys are checked by name at most",
    )
    assert problems(file, "algorithm.stpe=1", "agents.4.start=[1, 1]", run_plugins=False) == [
        "agents.4.target: missing; Meet needs a value",
        "algorithm.stpe: descend has no key 'stpe'; did you mean 'step'? accepted: step, relax",
    ]


def test_third_party_topology_is_drawn_only_on_request(file: Path) -> None:
    changes = ["topology.kind=./mine.py:spokes", "topology.hub=2"]
    assert problems(file, *changes) == [
        "topology: the graph is not strongly connected: nothing agent 1 sends can reach agent 2"
    ]
    assert load(file, changes=changes, run_plugins=False).spec.topology.options == {"hub": 2}


def test_unused_plugins_are_not_run(file: Path) -> None:
    (file.parent / "driver.py").write_text("import no_such_driver\nclass Robot:\n    def __init__(self, *, uri): pass")
    edit(file, "[agents.1]", "[plants.hardware]\nkind = './driver.py:Robot'\n[agents.1]\nplants.hardware.uri = 'radio'")
    edit(file, 'name = "test"', 'name = "test"\nplant = "point_mass"')
    assert load(file).notes == ()
    assert problems(file, "agents.1.plants.hardware.url=1") == [
        "agents.1.plants.hardware.url: Robot has no key 'url'; did you mean 'uri'? accepted: uri"
    ]
    assert "No module named 'no_such_driver'" in problems(file, plant="hardware")[0]
