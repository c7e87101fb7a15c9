"""Sub-tables of plug-ins in a fleet file: merged key by key, checked with full paths, written out complete."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from agentd.sweeps.variants import variants
from dcf_zenoh.config import freeze, load, to_toml
from dcf_zenoh.configuration.building.problem_and_plant import problem_of
from tests.support.fleet_files import edit, problems
from tests.support.glider import GLIDER, GLIDERS


@pytest.fixture
def gliders(tmp_path: Path) -> Path:
    """A fleet file whose plug-ins have sub-tables."""
    (tmp_path / "glider.py").write_text(GLIDER)
    (tmp_path / "fleet.toml").write_text(GLIDERS)
    return tmp_path / "fleet.toml"


def weights(source: Path, *changes: str) -> list[Any]:
    """The weights that the problem of each agent gets."""
    fleet = load(source, changes=changes)
    return [problem_of(fleet.spec, fleet.folder, agent).weights for agent in fleet.spec.ids]


def test_written_out_file_spells_out_all_defaults_of_a_table(gliders: Path) -> None:
    spec = load(gliders, changes=["faults.fog.kind=./glider.py:Fog", "exchange.round_timeout=0.001"]).spec
    table = tomllib.loads(to_toml(spec))
    inner = {"gain": 1.0, "names": ["a"]}
    assert table["problem"] == {
        "kind": "./glider.py:Glide",
        "target": [0.0, 0.0],
        "weights": {"state": [1.0, 0.1], "input": 2.0, "inner": inner},
        "limits": {"low": -1.0, "high": 9.0},
    }
    assert table["algorithm"]["weights"] == {"state": [1.0, 0.1], "input": 1.0, "inner": inner}
    assert table["plants"]["glider"]["weights"] == {"state": [2.0, 0.2], "input": 1.0, "inner": inner}
    assert table["faults"]["fog"]["limits"] == {"low": 1.0, "high": 9.0}
    assert table["agents"]["1"]["problem"] == {"weights": {"input": 3.0}}
    (gliders.parent / "again.toml").write_text(to_toml(spec))
    assert load(gliders.parent / "again.toml").spec == spec


def test_frozen_run_loads_to_the_same_fleet(gliders: Path, tmp_path: Path) -> None:
    fleet = load(gliders)
    frozen = freeze(fleet, tmp_path / "run")
    again = load(frozen.source).spec
    assert again.problem.options == fleet.spec.problem.options
    assert again.agents == fleet.spec.agents


def test_keys_of_an_agent_are_merged_into_the_table_of_the_fleet(gliders: Path) -> None:
    edit(gliders, "weights = { input = 2.0 }", "weights = { input = 2.0, state = [3.0, 0.3], inner = { gain = 5.0 } }")
    edit(gliders, "{ input = 3.0 }", "{ input = 3.0, inner = { names = ['b'] } }")
    one, two = weights(gliders)
    assert (one.state, one.input, one.inner.gain, one.inner.names) == ((3.0, 0.3), 3.0, 5.0, ("b",))
    assert (two.state, two.input, two.inner.gain, two.inner.names) == ((3.0, 0.3), 2.0, 5.0, ("a",))
    plants = [load(gliders).spec.agent(i).plant for i in (1, 2)]
    assert [each.options["weights"]["input"] for each in plants if each] == [1.0, 4.0]
    assert [each.options["weights"]["state"] for each in plants if each] == [[2.0, 0.2], [2.0, 0.2]]


@pytest.mark.parametrize("write_out", [False, True])
def test_changes_of_the_command_line_are_merged_too(gliders: Path, write_out: bool) -> None:
    source = gliders
    if write_out:
        source = gliders.with_name("complete.toml")
        source.write_text(to_toml(load(gliders).spec))
    one, two = weights(source, "problem.weights.inner.gain=7", "agents.2.problem.weights.input=8")
    assert (one.input, one.inner.gain, two.input, two.inner.gain) == (3.0, 7.0, 8.0, 7.0)


def test_keys_of_a_table_can_be_varied(gliders: Path) -> None:
    found = [weights(gliders, *each.changes)[1].input for each in variants(["problem.weights.input=1,2.5"], 2)]
    assert found == [1.0, 2.5]


@pytest.mark.parametrize("run_plugins", [True, False])
def test_misspelt_keys_are_reported_with_their_full_path(gliders: Path, run_plugins: bool) -> None:
    changes = [
        "problem.weights.inptu=1.0",
        "agents.1.problem.weights.stat=1.0",
        "agents.2.plants.glider.weights.inputs=1.0",
        "algorithm.weights.inner.nam=1",
    ]
    accepted = "accepted: state, input, inner, unit"
    assert problems(gliders, *changes, run_plugins=run_plugins) == [
        f"problem.weights.inptu: weights has no key 'inptu'; did you mean 'input'? {accepted}",
        f"agents.1.problem.weights.stat: weights has no key 'stat'; did you mean 'state'? {accepted}",
        f"agents.2.plants.glider.weights.inputs: weights has no key 'inputs'; did you mean 'input'? {accepted}",
        "algorithm.weights.inner.nam: inner has no key 'nam'; did you mean 'names'? accepted: gain, names",
    ]


def test_ill_typed_values_are_reported_with_their_full_path(gliders: Path) -> None:
    changes = ["problem.weights.input=-1", "agents.2.problem.weights.state=3", "plants.glider.weights=much"]
    assert problems(gliders, *changes) == [
        "problem.weights.input: expected a number > 0, not -1",
        "agents.2.problem.weights.state: expected a list of 2 numbers, not 3",
        "plants.glider.weights: expected a table, not 'much'",
    ]


def test_refusal_of_a_table_is_reported_at_the_table_that_is_wrong(gliders: Path) -> None:
    text = "input must be at most ten times the sum of state, not"
    assert problems(gliders, "problem.weights.input=12") == [f"problem.weights: {text} 12"]
    assert problems(gliders, "agents.2.problem.weights.input=12") == [f"agents.2.problem.weights: {text} 12"]
    edit(gliders, "weights = { input = 2.0 }", "weights = { input = 12.0, state = [1.0, 1.0] }")
    load(gliders, changes=["agents.2.problem.weights.input=20"])  # judged with the state of the fleet
    assert problems(gliders, "agents.2.problem.weights.input=21") == [f"agents.2.problem.weights: {text} 21"]


def test_required_key_of_a_table_is_reported_where_it_is_missing(gliders: Path) -> None:
    edit(gliders, "low = -1.0", "high = 3.0")
    assert problems(gliders) == ["problem.limits.low: missing; limits needs a number"]
    edit(gliders, "[problem.limits]\nhigh = 3.0", "")
    text = "missing; Glide needs a table with the keys low, high"
    assert problems(gliders) == [f"problem.limits: {text}"]


def test_required_key_may_come_from_the_agents(gliders: Path) -> None:
    (gliders.parent / "glider.py").write_text(GLIDER.replace('SHARED = ("limits", "weights.state")', ""))
    edit(gliders, "low = -1.0", "high = 3.0")
    change = "agents.1.problem.limits.low=1"
    assert problems(gliders, change) == ["agents.2.problem.limits.low: missing; limits needs a number"]
    fleet = load(gliders, changes=[change, "agents.2.problem.limits.low=2"])
    limits = [problem_of(fleet.spec, fleet.folder, agent).limits for agent in (1, 2)]
    assert [(each.low, each.high) for each in limits] == [(1.0, 3.0), (2.0, 3.0)]


def test_shared_tables_and_shared_keys_of_tables_cannot_differ(gliders: Path) -> None:
    changes = ["agents.1.problem.weights.state=[1, 1]", "agents.2.problem.limits.high=2"]
    assert problems(gliders, *changes) == [
        "agents.1.problem.weights.state: must be the same at every agent; set it in [problem]",
        "agents.2.problem.limits: must be the same at every agent; set it in [problem]",
    ]


def test_table_of_any_keys_is_merged_alike(gliders: Path) -> None:
    spec = load(gliders, changes=["problem.free={a=1,b={c=2}}", "agents.1.problem.free.b.d=3"]).spec
    assert spec.agent(1).problem.options["free"] == {"a": 1, "b": {"c": 2, "d": 3}}
    assert spec.agent(2).problem.options["free"] == {"a": 1, "b": {"c": 2}}


def test_rules_of_faults_have_tables_too(gliders: Path) -> None:
    changes = [
        "exchange.round_timeout=0.001",
        "faults.rule.1={from=1,to=2,fog={kind='./glider.py:Fog',limits={hihg=1}}}",
    ]
    assert problems(gliders, *changes) == [
        "faults.rule.1.fog.limits.hihg: limits has no key 'hihg'; did you mean 'high'? accepted: low, high"
    ]
