from pathlib import Path

import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError
from tests.support.fleet_files import FLEET, MINE, problems

REAL = """
from dcf_zenoh.plant import Plant, State

class Rover(Plant):
    real = True
    own_keys = ("port",)
    def __init__(self, start, *, port: str): pass
    def sense(self, now): return State()
    def act(self, setpoint, now): pass
"""


@pytest.fixture
def rovers(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(MINE + REAL)
    text = FLEET.replace("accel_max = 1\n", 'kind = "./mine.py:Rover"\nport = "a"\n')
    text = text.replace("plants.point_mass.accel_max = 2.5", 'plants.point_mass.port = "b"')
    text = text.replace("problem.radius = 1\n", 'problem.radius = 1\nplants.point_mass.port = "c"\n')
    (tmp_path / "rovers.toml").write_text(text)
    return tmp_path / "rovers.toml"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("arena={min=[0,0],max=[1]}", "arena: expected as many coordinates in min as in max, 1 to 3, not 2 and 1"),
        ("arena={min=[],max=[]}", "arena: expected as many coordinates in min as in max, 1 to 3, not 0 and 0"),
        (
            "arena={min=[0,0,0,0],max=[1,1,1,1]}",
            "arena: expected as many coordinates in min as in max, 1 to 3, not 4 and 4",
        ),
        ("arena={min=[0,1],max=[1,1]}", "arena: expected min < max on each axis, not 1 and 1 m"),
        (
            "arena={min=[-1,-1,0],max=[0.9,1,2]}",
            "agents.3.start: outside the arena: x = 1 m, allowed -1 .. 0.9 m",
        ),
        ("arena.max=[1]", "arena.min: missing; expected a list of numbers (least coordinates, m)"),
        (
            "safety.geofence='fly'",
            "safety.geofence: expected 'log' or 'hold' or 'land' or 'stop' (outside the arena, if there is one), not",
        ),
        ("safety.speed={}", "safety.speed.max: missing; expected a number > 0"),
        ("safety.separation.min=-1", "safety.separation.min: expected a number > 0"),
        ("safety.missed_deadlines.in_a_row=0", "safety.missed_deadlines.in_a_row: expected a whole number >= 1"),
        ("safety.fence=1", "safety.fence: "),
    ],
)
def test_problem_is_named_with_what_is_allowed(file: Path, change: str, problem: str) -> None:
    found = problems(file, change)
    assert any(text.startswith(problem) for text in found), found


def test_what_moves_in_the_real_world_needs_real_time(rovers: Path) -> None:
    assert load(rovers, changes=["time.clock='wall'"]).spec.plant == "point_mass"
    assert problems(rovers, "time.clock='virtual'") == [
        "plants.point_mass: moves in the real world, which knows no virtual time: launch it with --clock wall"
    ]


def test_two_bodies_cannot_share_a_value_that_must_be_unique(rovers: Path) -> None:
    found = problems(rovers, "time.clock='wall'", "agents.3.plants.point_mass.port='a'")
    assert found == ["agents.3.plants.point_mass.port: 'a' is taken by agent 1; each needs its own"]


def test_nor_can_they_by_way_of_two_plants_of_one_kind(rovers: Path) -> None:
    other = [
        "plants.other.kind='./mine.py:Rover'",
        "plants.other.port='a'",
        "plant='point_mass'",
        "agents.3.plant='other'",
    ]
    found = problems(rovers, "time.clock='wall'", *other)
    assert found == ["agents.3.plants.other.port: 'a' is taken by agent 1; each needs its own"]


@pytest.mark.parametrize(("changes", "height"), [([], "1"), (["plants.crazyflie.flight.height=0.05"], "0.05")])
def test_bodies_fly_at_a_height_that_is_in_the_arena(changes: list[str], height: str) -> None:
    arena = "arena={min=[-2,-2,0.1],max=[2,2,0.6]}"
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", Overrides(plant="crazyflie"), changes=[arena, *changes])
    assert refused.value.problems == (
        f"plants.crazyflie.flight.height: agent 1 would fly outside the arena: {height} m, allowed 0.1 .. 0.6 m",
    )
    assert load(
        "position_swap", Overrides(plant="crazyflie"), changes=[arena, "plants.crazyflie.flight.height=0.3"]
    ).spec.arena


DONGLE = """
    @classmethod
    def device(cls, key, value):
        return f"dongle {value[0]}"
"""


def test_a_device_of_two_agents_on_one_computer_is_noted(rovers: Path) -> None:
    (rovers.parent / "mine.py").write_text(MINE + REAL + DONGLE)
    ports = ["agents.2.plants.point_mass.port=x1", "agents.3.plants.point_mass.port=x2", "time.clock=wall"]
    apart = ["agents.2.endpoint=tcp/10.0.0.2:7447", "agents.3.endpoint=tcp/10.0.0.3:7447"]
    text = "agents.3.plants.point_mass.port: dongle x is used by agent 2, too: on one computer each agent needs its own"
    assert load(rovers, changes=ports).notes == (text,)
    assert load(rovers, changes=[*ports, *apart]).notes == ()
