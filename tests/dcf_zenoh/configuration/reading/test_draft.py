import re
from pathlib import Path

import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.spec import Kind
from tests.support.fleet_files import MINE, edit, problems


def test_unknown_fleet_lists_the_built_in_ones() -> None:
    text = problems("position_swop")[0]
    assert text.startswith("no file and no built-in fleet of this name; did you mean 'position_swap'? built in: ")


def test_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    assert problems(tmp_path / "none.toml") == ["there is no such file"]


def test_what_is_not_toml_is_reported_with_line_and_column(file: Path) -> None:
    edit(file, "step = 0.1", "step = ")
    assert problems(file) == ["not TOML: Invalid value (at line 16, column 8)"]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_files_as_other_systems_write_them_are_read(file: Path, encoding: str) -> None:
    before = load(file).spec
    text = file.read_text(encoding="utf-8").replace("\n", "\r\n")
    file.write_bytes(text.encode(encoding))
    assert load(file).spec == before


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


def test_only_plant_is_everyones_and_its_kind_is_its_name(file: Path) -> None:
    spec = load(file).spec
    assert spec.plant == "point_mass"
    assert spec.agent(1).plant == Kind(kind="point_mass", accel_max=1)  # type: ignore[call-arg]
    assert spec.agent(2).plant == Kind(kind="point_mass", accel_max=2.5)  # type: ignore[call-arg]


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


def test_another_kind_drops_the_keys_of_the_old_one_with_a_note(file: Path) -> None:
    edit(file, 'kind = "ring"', 'kind = "grid"\nrows = 1\ncolumns = 3\nweights = "uniform"')
    fleet = load(file, Overrides(topology="ring"))
    assert fleet.spec.topology.options == {"directed": False}
    assert fleet.spec.topology.weights == "uniform"
    assert fleet.notes == ("topology: kind changed from grid to ring, dropped rows, columns",)


def test_keys_set_after_the_kind_are_kept(file: Path) -> None:
    fleet = load(file, changes=["topology.kind=grid", "topology.rows=1", "topology.kind=grid"])
    assert fleet.spec.topology.options == {"rows": 1}
    fleet = load(file, changes=["topology.rows=1", "topology.kind=grid"])
    assert fleet.notes == ("topology: kind changed from ring to grid, dropped rows",)
    assert load(file, Overrides(topology="star"), changes=["topology.hub=2"]).spec.topology.options == {"hub": 2}


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
    fleet = load(file, Overrides(algorithm="fine"), changes=["algorithms.fine.step=0.3"])
    assert fleet.spec.algorithm.options == {"relax": 0.5, "step": 0.3}
    assert fleet.notes == ("algorithm: replaced by [algorithms.fine], dropped step",)


def test_algorithm_may_be_a_kind(file: Path) -> None:
    fleet = load(file, Overrides(algorithm="trades"))
    assert fleet.spec.algorithm.kind == "trades"
    assert fleet.spec.algorithm.options["step"] == 0.05  # its own default, not the 0.1 of the other kind
    assert fleet.notes == ("algorithm: kind changed from ./mine.py:descend to trades, dropped step",)


def test_plant_is_chosen_for_all_agents(file: Path) -> None:
    edit(file, "[agents.1]", "[plants.other]\nkind = './mine.py:Blimp'\n[agents.1]\nplant = 'other'")
    edit(file, "[agents.2]", "[agents.2]\nplant = 'point_mass'")
    edit(file, "[agents.3]", "[agents.3]\nplant = 'point_mass'")
    chosen = load(file, Overrides(plant="other")).spec
    assert [chosen.agent(i).plant for i in chosen.ids] == [Kind(kind="./mine.py:Blimp", mass=1.0)] * 3  # type: ignore[call-arg]
    implicit = load(file, Overrides(plant="./mine.py:Blimp")).spec
    assert implicit.agent(2).plant == Kind(kind="./mine.py:Blimp", mass=1.0)  # type: ignore[call-arg]


def test_file_given_by_an_argument_is_looked_for_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    fleet = load("position_swap", Overrides(algorithm="./mine.py:descend"))
    assert fleet.spec.algorithm.kind == f"{tmp_path / 'mine.py'}:descend"


def test_choices_that_are_not_there_get_the_nearest_spelling(file: Path) -> None:
    found = problems(file, plant="point_mas", algorithm="fin", topology="rnig")
    assert [re.split(r"(?<=\?) ", text)[0] for text in found] == [
        "plant: there is no [plants.point_mas] and no kind 'point_mas'; did you mean 'point_mass'?",
        "algorithm: there is no [algorithms.fin] and no kind 'fin'; did you mean 'fine'?",
        "topology.kind: unknown kind 'rnig'; did you mean 'ring'?",
    ]
