import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dcf_zenoh.config import LoadedFleet, freeze, graph_of, load, to_toml, weights_of
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.graph import metropolis, uniform
from dcf_zenoh.spec import Kind

FLEET = """
name = "test"

[time]
sample_time = 0.2

[topology]
kind = "ring"

[problem]
kind = "./mine.py:Meet"
radius = 0.5

[algorithm]
kind = "./mine.py:descend"
step = 0.1

[algorithms.fine]
kind = "./mine.py:descend"
relax = 0.5

[plants.point_mass]
accel_max = 1

[agents.1]
start = [0.0, 1.0]
target = [0.0, -1.0]

[agents.2]
start = [0.0, -1.0]
target = [0.0, 1.0]
plants.point_mass.accel_max = 2.5

[agents.3]
start = [1.0, 0.0]
target = [-1.0, 0.0]
problem.radius = 1
"""

MINE = """
class Meet:
    def __init__(self, agent, agents, sample_time, *, target: tuple[float, ...], radius: float = 1.0, sides: int = 3):
        raise AssertionError("nothing is constructed")

def descend(problem, me, *, step: float = 0.05, relax: float = 1.0):
    yield

def spokes(agents, *, hub: int):
    for j in agents:
        if j != hub:
            yield hub, j

class Blimp:
    def __init__(self, start, *, mass: float = 1.0): pass
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "fleet.toml").write_text(FLEET)
    return tmp_path / "fleet.toml"


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def problems(source: Path | str, *changes: str, **choices: Any) -> list[str]:
    """What loading finds wrong, without the file's name."""
    with pytest.raises(ConfigurationError) as caught:
        load(source, changes=changes, **choices)
    assert caught.value.source == str(source)
    assert str(caught.value).splitlines() == [f"{source}: {problem}" for problem in caught.value.problems]
    return list(caught.value.problems)


# The file


def test_built_in_fleet_is_found_by_name() -> None:
    fleet = load("position_swap")
    assert fleet.spec.name == "position_swap"
    assert fleet.folder == Path(fleet.source).parent
    assert fleet.spec.agent(1).plant == Kind(kind="point_mass")


def test_unknown_fleet_lists_the_built_in_ones() -> None:
    text = problems("position_swop")[0]
    assert text.startswith("no file and no built-in fleet of this name; did you mean 'position_swap'? built in: ")


def test_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    assert problems(tmp_path / "none.toml") == ["there is no such file"]


def test_what_is_not_toml_is_reported_with_line_and_column(file: Path) -> None:
    edit(file, "step = 0.1", "step = ")
    assert problems(file) == ["not TOML: Invalid value (at line 16, column 8)"]


def test_what_is_not_utf8_is_reported(file: Path) -> None:
    file.write_bytes(b'name = "\xff"')
    assert problems(file)[0].startswith("not TOML, which is UTF-8: ")


def test_agent_given_twice_is_reported(file: Path) -> None:
    edit(file, "[agents.2]", "[agents.1]")
    assert problems(file)[0].startswith("not TOML: Cannot declare ('agents', '1') twice (at line ")


def test_two_spellings_of_one_id_are_one_agent(file: Path) -> None:
    edit(file, "[agents.2]", "[agents.01]")
    assert problems(file) == ["agents.01: the same agent as agents.1"]


def test_id_with_a_leading_zero_is_a_number(file: Path) -> None:
    edit(file, "[agents.2]", "[agents.02]")
    assert load(file, changes=["agents.002.start=[3.0, 3.0]"]).spec.agents[2].start == (3.0, 3.0)


@pytest.mark.parametrize("key", ["left", "-1", "'1.0'", "'²'"])
def test_id_that_is_no_whole_number_is_refused(file: Path, key: str) -> None:
    edit(file, "[agents.2]", f"[agents.{key}]")
    name = key.strip("'")
    assert problems(file) == [f"agents.{name}: the id of an agent is a whole number >= 0, not {name!r}"]


# Defaults and overrides


def test_only_plant_is_everyones_and_its_kind_is_its_name(file: Path) -> None:
    spec = load(file).spec
    assert spec.plant == "point_mass"
    assert spec.agent(1).plant == Kind(kind="point_mass", accel_max=1)  # type: ignore[call-arg]
    assert spec.agent(2).plant == Kind(kind="point_mass", accel_max=2.5)  # type: ignore[call-arg]


def test_agents_override_the_problem_and_target_is_short_for_problem_target(file: Path) -> None:
    spec = load(file).spec
    assert spec.agent(1).problem.options == {"radius": 0.5, "target": (0.0, -1.0)}
    assert spec.agent(3).problem.options == {"radius": 1, "target": (-1.0, 0.0)}


def test_values_are_toml_or_else_strings(file: Path) -> None:
    changes = [
        "time.duration=3",
        "time.clock=wall",
        'exchange.missing="absent"',
        "time.arrived={within = 0.1, for = 2}",
    ]
    spec = load(file, changes=changes).spec
    assert (spec.time.duration, spec.time.clock, spec.exchange.missing) == (3.0, "wall", "absent")
    assert spec.time.arrived is not None
    assert spec.time.arrived.for_ == 2.0


def test_tables_on_the_way_to_a_value_are_made(file: Path) -> None:
    spec = load(
        file, changes=["safety.neighbour_silent.after=2", "agents.7.start=[2.0, 2.0]", "agents.7.target=[0, 0]"]
    ).spec
    assert spec.safety.neighbour_silent.after == 2.0
    assert spec.ids == (1, 2, 3, 7)


def test_keys_of_zenoh_may_have_slashes(file: Path) -> None:
    spec = load(file, changes=["zenoh.settings.transport/link/tx/lease=1000"]).spec
    assert spec.zenoh.settings == {"transport/link/tx/lease": 1000}


@pytest.mark.parametrize("change", ["seed", "=3", "a..b=1"])
def test_change_that_is_no_assignment_is_refused(file: Path, change: str) -> None:
    assert problems(file, change) == [f"{change}: expected key.path=value, such as time.duration=10.0"]


def test_change_inside_a_value_is_refused(file: Path) -> None:
    assert problems(file, "time.sample_time.x=1") == [
        "time.sample_time.x: cannot be set: time.sample_time is 0.2, not a table"
    ]


def test_seed_and_clock_replace_those_of_the_file(file: Path) -> None:
    spec = load(file, seed=4, clock="wall").spec
    assert (spec.seed, spec.time.clock) == (4, "wall")
    assert problems(file, clock="sun")[0].startswith("time.clock: expected 'wall' or 'virtual'")


# Choosing kinds


def test_another_kind_drops_the_keys_of_the_old_one_and_says_so(file: Path) -> None:
    edit(file, 'kind = "ring"', 'kind = "grid"\nrows = 1\ncolumns = 3\nweights = "uniform"')
    fleet = load(file, topology="ring")
    assert fleet.spec.topology.options == {}
    assert fleet.spec.topology.weights == "uniform"
    assert fleet.notes == ("topology: kind changed from grid to ring, dropped rows, columns",)


def test_keys_set_after_the_kind_are_kept(file: Path) -> None:
    fleet = load(file, changes=["topology.kind=grid", "topology.rows=1", "topology.kind=grid"])
    assert fleet.spec.topology.options == {"rows": 1}
    fleet = load(file, changes=["topology.rows=1", "topology.kind=grid"])
    assert fleet.notes == ("topology: kind changed from ring to grid, dropped rows",)
    assert load(file, topology="star", changes=["topology.hub=2"]).spec.topology.options == {"hub": 2}


def test_another_kind_of_plant_drops_the_overrides_too(file: Path) -> None:
    fleet = load(file, changes=["plants.point_mass.kind=./mine.py:Blimp"])
    assert fleet.notes == (
        "plants.point_mass: kind changed from point_mass to ./mine.py:Blimp,"
        " dropped accel_max, agents.2.plants.point_mass",
    )


def test_another_kind_of_problem_drops_the_overrides_too(file: Path) -> None:
    notes = load(file, changes=["problem.kind=position_swap"]).notes
    assert notes == ("problem: kind changed from ./mine.py:Meet to position_swap, dropped radius, agents.3.problem",)


def test_algorithm_is_chosen_among_the_named_tables(file: Path) -> None:
    fleet = load(file, algorithm="fine", changes=["algorithms.fine.step=0.3"])
    assert fleet.spec.algorithm.options == {"relax": 0.5, "step": 0.3}
    assert fleet.notes == ("algorithm: replaced by [algorithms.fine], dropped step",)


def test_algorithm_may_be_a_kind(file: Path) -> None:
    fleet = load(file, algorithm="trades")
    assert fleet.spec.algorithm == Kind(kind="trades")
    assert fleet.notes == ("algorithm: kind changed from ./mine.py:descend to trades, dropped step",)


def test_plant_is_chosen_for_all_agents(file: Path) -> None:
    edit(file, "[agents.1]", "[plants.other]\nkind = './mine.py:Blimp'\n[agents.1]\nplant = 'other'")
    edit(file, "[agents.2]", "[agents.2]\nplant = 'point_mass'")
    edit(file, "[agents.3]", "[agents.3]\nplant = 'point_mass'")
    chosen = load(file, plant="other").spec
    assert [chosen.agent(i).plant for i in chosen.ids] == [Kind(kind="./mine.py:Blimp")] * 3
    implicit = load(file, plant="./mine.py:Blimp").spec
    assert implicit.agent(2).plant == Kind(kind="./mine.py:Blimp")


def test_file_given_by_an_argument_is_looked_for_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    fleet = load("position_swap", algorithm="./mine.py:descend")
    assert fleet.spec.algorithm.kind == f"{tmp_path / 'mine.py'}:descend"


def test_choices_that_are_not_there_get_the_nearest_spelling(file: Path) -> None:
    found = problems(file, plant="point_mas", algorithm="fin", topology="rnig")
    assert [re.split(r"(?<=\?) ", text)[0] for text in found] == [
        "plant: there is no [plants.point_mas] and no kind 'point_mas'; did you mean 'point_mass'?",
        "algorithm: there is no [algorithms.fin] and no kind 'fin'; did you mean 'fine'?",
        "topology.kind: unknown kind 'rnig'; did you mean 'ring'?",
    ]


# What is wrong


def test_all_problems_of_a_file_are_reported_at_once(file: Path) -> None:
    found = problems(
        file,
        "time.sample_tme=0.1",
        "exchange.max_rounds=0",
        "agents.1.start=[0.0, 'x']",
        "agents.2.plant=pointmass",
        "problem.radius=true",
        "agents.3.problem.radius=[1]",
        "agents.3.plants.point_mass.acel_max=1",
        "algorithm.stpe=1",
        "topology.kind=grid",
        "topology.rows=2",
    )
    assert found == [
        "time.sample_tme: [time] has no key 'sample_tme'; did you mean 'sample_time'?"
        " accepted: clock, sample_time, duration, arrived",
        "exchange.max_rounds: expected a whole number >= 1, not 0",
        "agents.1.start: expected a list of numbers (position before the first step, m), not [0.0, 'x']",
        "agents.2.plant: there is no [plants.pointmass]; did you mean 'point_mass'? there are: point_mass",
        "problem.radius: expected a number, not true",
        "agents.3.problem.radius: expected a number, not [1]",
        "agents.3.plants.point_mass.acel_max: PointMass has no key 'acel_max'; did you mean 'accel_max'?"
        " accepted: velocity, accel_max",
        "algorithm.stpe: descend has no key 'stpe'; did you mean 'step'? accepted: step, relax",
        "topology: grid refused its options: rows must divide the 3 agents, so be one of [1, 3], not 2",
    ]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("name=two words", "name: expected a string that matches ^[A-Za-z0-9_][A-Za-z0-9_.-]*$, not 'two words'"),
        ("seed=-1", "seed: expected a whole number >= 0, not -1"),
        ("seed=1.5", "seed: expected a whole number >= 0, not 1.5"),
        (
            "log.rounds=1",
            "log.rounds: expected true or false (record payload, residual and arrivals of every round), not 1",
        ),
        ("time.sample_time=0", "time.sample_time: expected a number > 0 (control period t_s, s), not 0"),
        ("time.sample_time=true", "time.sample_time: expected a number > 0 (control period t_s, s), not true"),
        ("time.duration=inf", "time.duration: expected a number > 0 (length of the run, s), not inf"),
        ("algorithm=trades", "algorithm: expected a table, not 'trades'"),
        ("agents.2=3", "agents.2: expected a table, not 3"),
        ("agents={}", "agents: expected a table, not {}"),
        ("plants=3", "plants: expected a table (plants by name), not 3"),
        ("fautls={}", "fautls: a fleet file has no key 'fautls'; accepted: name, seed, plant, time, "),
        ("problem={}", "problem.kind: missing; expected a string (name of a built-in or installed kind, "),
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
        (
            "topology.weights=fair",
            "topology.weights: expected 'auto' or 'metropolis' or 'uniform' (mixing weights; auto: ",
        ),
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
        f"agents.{i}.plant: missing; choose one of point_mass, other here, for all agents by plant = ..., or by --plant"
        for i in (2, 3)
    ]


def test_file_without_name_is_still_checked(file: Path) -> None:
    edit(file, 'name = "test"', "")
    found = problems(file, "algorithm.stpe=1")
    assert found[0].startswith("name: missing; expected a string that matches ")
    assert found[1].startswith("algorithm.stpe: descend has no key 'stpe'")


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


# What should be known


def test_worst_case_of_a_step_is_noted(file: Path) -> None:
    assert load(file, changes=["exchange.round_timeout=0.003"]).notes == (
        "exchange: worst case 200 x 3 ms = 0.600 s > budget 0.150 s: a step may end by time, not by agreement",
    )
    assert load(file, changes=["exchange.round_timeout=0.003", "exchange.max_rounds=50"]).notes == ()


def test_endpoint_of_two_agents_is_noted(file: Path) -> None:
    edit(file, "[agents.3]", "[agents.3]\nendpoint = 'tcp/127.0.0.1:7451'")
    assert load(file).notes == ("agents.3.endpoint: tcp/127.0.0.1:7451 is the endpoint of agent 1 too",)


def test_nothing_of_others_runs_unless_told(file: Path) -> None:
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


def test_topology_of_others_is_not_drawn_unless_told(file: Path) -> None:
    changes = ["topology.kind=./mine.py:spokes", "topology.hub=2"]
    assert problems(file, *changes) == [
        "topology: the graph is not strongly connected: nothing agent 1 sends can reach agent 2"
    ]
    assert load(file, changes=changes, run_plugins=False).spec.topology.options == {"hub": 2}


def test_plugins_that_nobody_uses_are_not_run(file: Path) -> None:
    (file.parent / "driver.py").write_text("import no_such_driver\nclass Robot:\n    def __init__(self, *, uri): pass")
    edit(file, "[agents.1]", "[plants.hardware]\nkind = './driver.py:Robot'\n[agents.1]\nplants.hardware.uri = 'radio'")
    edit(file, 'name = "test"', 'name = "test"\nplant = "point_mass"')
    assert load(file).notes == ()
    assert problems(file, "agents.1.plants.hardware.url=1") == [
        "agents.1.plants.hardware.url: Robot has no key 'url'; did you mean 'uri'? accepted: uri"
    ]
    assert "No module named 'no_such_driver'" in problems(file, plant="hardware")[0]


# What comes of it


def test_graph_and_weights_follow_from_the_topology(file: Path) -> None:
    fleet = load(file)
    graph = graph_of(fleet)
    assert graph.in_neighbours(1) == (2, 3)
    assert np.array_equal(weights_of(fleet.spec, graph), metropolis(graph))
    directed = load(file, changes=["topology.directed=true"])
    assert np.array_equal(weights_of(directed.spec, graph_of(directed)), uniform(graph_of(directed)))


def again(spec_text: str, folder: Path) -> LoadedFleet:
    copy = folder / "again.toml"
    copy.write_text(spec_text, encoding="utf-8")
    return load(copy)


def test_written_out_file_loads_to_the_same_fleet(file: Path) -> None:
    changes = ["zenoh.settings.a/b='x [\\n'", "time.arrived.within=0.1", "agents.1.endpoint=tcp/127.0.0.1:9"]
    for fleet in (load("position_swap"), load(file, changes=changes, topology="star", algorithm="fine")):
        assert again(to_toml(fleet.spec), file.parent).spec == fleet.spec


def test_written_out_file_is_complete_and_in_order(file: Path) -> None:
    text = to_toml(load(file).spec)
    assert re.findall(r"^\[(\w+)\]", text, re.M) == [
        "time",
        "exchange",
        "topology",
        "problem",
        "algorithm",
        "log",
        "zenoh",
    ]
    assert "start = [0.0, 1.0]\n" in text
    assert "max_rounds = 200\n" in text


OPTIONS = st.recursive(
    st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    options=st.dictionaries(st.text(min_size=1), OPTIONS, max_size=4),
    threshold=st.floats(0, 1e300),
    seed=st.integers(0, 2**63),
)
def test_any_value_survives_writing_out(file: Path, options: dict[str, Any], threshold: float, seed: int) -> None:
    spec = load(file, seed=seed, changes=[f"exchange.threshold={threshold!r}"]).spec
    zenoh = spec.zenoh.model_copy(update={"settings": options})
    spec = spec.model_copy(update={"zenoh": zenoh})
    assert again(to_toml(spec), file.parent).spec == spec


def test_frozen_fleet_has_its_plugins_beside_it(file: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.py").write_text(MINE + "\n# other")
    changes = ["topology.kind=topologies.star:star", "plants.point_mass.kind=./other/mine.py:Blimp"]
    fleet = load(file, changes=changes)
    run = tmp_path / "runs" / "1"
    frozen = freeze(fleet, run)
    assert frozen.folder == run
    assert frozen.spec.problem.kind == "./plugins/mine.py:Meet"
    assert frozen.spec.algorithm.kind == frozen.spec.algorithms["fine"].kind == "./plugins/mine.py:descend"
    assert frozen.spec.plants["point_mass"].kind == "./plugins/mine_2.py:Blimp"
    assert frozen.spec.topology.kind == "topologies.star:star"
    assert frozen.notes == fleet.notes
    assert load(run / "fleet.toml").spec == frozen.spec

    digests = json.loads((run / "plugins.json").read_text())
    star = next(key for key in digests if key.endswith("star.py"))
    assert digests == {
        "plugins/mine.py": hashlib.sha256(MINE.encode()).hexdigest(),
        "plugins/mine_2.py": hashlib.sha256((MINE + "\n# other").encode()).hexdigest(),
        star: hashlib.sha256(Path(star).read_bytes()).hexdigest(),
    }
    assert (run / "plugins" / "mine.py").read_text() == MINE
