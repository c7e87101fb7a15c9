from pathlib import Path

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.spec import Kind
from tests.support.fleet_files import edit, problems


def test_built_in_fleet_is_found_by_name() -> None:
    fleet = load("position_swap")
    assert fleet.spec.name == "position_swap"
    assert fleet.folder == Path(fleet.source).parent
    assert fleet.spec.agent(1).plant == Kind(kind="point_mass", accel_max=2.0)  # type: ignore[call-arg]


def test_agents_override_the_problem_and_target_is_short_for_problem_target(file: Path) -> None:
    spec = load(file).spec
    assert spec.agent(1).problem.options == {"radius": 0.5, "sides": 3, "target": (0.0, -1.0)}
    assert spec.agent(3).problem.options == {"radius": 1, "sides": 3, "target": (-1.0, 0.0)}


def test_seed_and_clock_replace_those_of_the_file(file: Path) -> None:
    spec = load(file, Overrides(seed=4, clock="wall")).spec
    assert (spec.seed, spec.time.clock) == (4, "wall")
    assert problems(file, clock="sun")[0].startswith("time.clock: expected 'wall' or 'virtual'")


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
        "exchange.max_rounds: expected a whole number >= 1"
        " (most rounds of a step, those for sharing states included), not 0",
        "agents.1.start: expected a list of numbers (position before the first step, m), not [0.0, 'x']",
        "agents.2.plant: there is no [plants.pointmass]; did you mean 'point_mass'? there are: point_mass",
        "problem.radius: expected a number, not true",
        "agents.3.problem.radius: expected a number, not [1]",
        "agents.3.plants.point_mass.acel_max: PointMass has no key 'acel_max'; did you mean 'accel_max'?"
        " accepted: velocity, accel_max",
        "algorithm.stpe: descend has no key 'stpe'; did you mean 'step'? accepted: step, relax",
        "topology: grid refused its options: rows must divide the 3 agents, so be one of [1, 3], not 2",
    ]


def test_file_without_name_is_still_checked(file: Path) -> None:
    edit(file, 'name = "test"', "")
    found = problems(file, "algorithm.stpe=1")
    assert found[0].startswith("name: missing; expected a string that matches ")
    assert found[1].startswith("algorithm.stpe: descend has no key 'stpe'")
