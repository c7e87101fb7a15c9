"""Errors that only a plug-in can find in its values are reported when a fleet is loaded."""

from pathlib import Path

import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError
from tests.support.fleet_files import edit

HEAVY = "mass must be positive and at most 0.0592, in kg, the most that the rotors carry, not"
REFUSED = "refused its options:"


def found(*changes: str, source: str | Path = "position_swap", run_plugins: bool = True) -> list[str]:
    """What loading finds wrong."""
    with pytest.raises(ConfigurationError) as caught:
        load(
            source,
            Overrides(plant="twin" if source == "position_swap" else None),
            changes=changes,
            run_plugins=run_plugins,
        )
    return list(caught.value.problems)


@pytest.mark.parametrize("run_plugins", [True, False])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "plants.twin.parameters=forster",
            f"plants.twin: Crazyflie {REFUSED} unknown parameters 'forster'; known: cf2x_p250, forster2015",
        ),
        ("plants.twin.mass=-0.03", f"plants.twin: Crazyflie {REFUSED} {HEAVY} -0.03"),
        ("plants.twin.mass=0.08", f"plants.twin: Crazyflie {REFUSED} {HEAVY} 0.08"),
        ("agents.3.plants.twin.mass=0.08", f"agents.3.plants.twin: Crazyflie {REFUSED} {HEAVY} 0.08"),
        ("problem.prediction.horizon=0", "problem.prediction: horizon must be positive, not 0"),
        (
            "agents.4.problem.prediction.accel_max=-1.0",
            "agents.4.problem.prediction: accel_max must be positive, not -1.0",
        ),
        (
            "agents.3.start=[0.2, -0.9]",
            "agents.3.start: agent 3 would start in the safety region of agent 2: h = -0.2, expected at least 0"
            " (they are 0.2 m apart in x and 0.1 m in y; radii 0.5 m and 0.25 m)",
        ),
    ],
)
def test_what_built_in_kinds_refuse_is_one_line(change: str, said: str, run_plugins: bool) -> None:
    assert found(change, run_plugins=run_plugins) == [said]


def test_problem_of_one_agent_does_not_hide_that_of_another_table() -> None:
    assert found("plants.twin.mass=1.0", "problem.prediction.horizon=0", "plants.point.accel_max=0.0") == [
        "problem.prediction: horizon must be positive, not 0",
        f"plants.twin: Crazyflie {REFUSED} {HEAVY} 1.0",  # no agent has the other plant
    ]


@pytest.mark.parametrize(
    ("fleet", "changes", "said"),
    [
        (
            "quadratic",
            ["agents.2.problem.centre=[1.0, 2.0]"],
            ["agents.2.problem: components of a decision: expected 1, as agent 1 has, not 2"],
        ),
        (
            "average",
            ["agents.1.problem.value=[1.0, 2.0]", "agents.4.problem.value=[1.0, 2.0, 3.0]"],
            [
                "agents.1.problem: components of a decision: expected 1, as agent 2 has, not 2",
                "agents.4.problem: components of a decision: expected 1, as agent 2 has, not 3",
            ],
        ),
    ],
)
def test_all_agents_decide_on_as_many_components(fleet: str, changes: list[str], said: list[str]) -> None:
    assert found(*changes, source=fleet) == said


def test_error_is_reported_once() -> None:
    assert [each.partition(":")[0] for each in found("plants.twin.mass=heavy", "agents.1.start=[1.0, 0.0]")] == [
        "agents.3.start",
        "plants.twin.mass",
    ]


def test_agents_may_start_on_the_edge_of_a_safety_region() -> None:
    load("position_swap", changes=["agents.2.start=[0.35, 0.925]"])  # h = 0.7 + 0.3 - 1
    load("position_swap", changes=["agents.2.start=[0.1, 0.9]", "problem.barrier.radii=[0.1, 0.1]"])


def test_a_start_has_at_least_two_components_in_the_plane() -> None:
    changes = [f"agents.{i}.start=[{i}.0]" for i in range(1, 5)]
    with pytest.raises(ConfigurationError) as caught:
        load("position_swap", changes=changes)
    assert caught.value.problems[0] == "agents.1.start: expected [x, y], in m, not [1.0]"


OWN = """
class Meet:
    def __init__(self, agent, *, target: tuple[float, ...], radius: float = 1.0):
        self.radius = radius
    def check_starts(self, starts):
        far = [i for i, start in starts.items() if abs(start).max() > self.radius]
        return {i: f"expected within {self.radius:g} m" for i in far}
def descend(problem, me, *, step: float = 0.05, relax: float = 1.0):
    yield
"""


def test_third_party_problem_can_check_all_starts(file: Path) -> None:
    (file.parent / "mine.py").write_text(OWN)
    edit(file, "start = [1.0, 0.0]", "start = [1.5, 0.0]")
    assert found("agents.1.problem.radius=1.2", source=file) == ["agents.3.start: expected within 1.2 m"]
    load(file, run_plugins=False)  # which runs no third-party code


@pytest.mark.parametrize("key", ["plant", "agents.2.plant"])
def test_without_a_plant_of_that_name_nothing_is_made(key: str) -> None:
    assert found(f"{key}=mine") == [f"{key}: there is no [plants.mine]; there are: point, twin, hardware, emulated"]


BAD_ANSWERS = [
    ("return 1 / 0", "Meet.{method}() failed: ZeroDivisionError: division by zero (mine.py:5)"),
    ("return 7", "Meet.{method}() returned 7; expected "),
    ("return {'a': 1}", "Meet.{method}() returned {{'a': 1}}; expected "),
]


@pytest.mark.parametrize(("body", "text"), BAD_ANSWERS)
@pytest.mark.parametrize(("method", "arguments"), [("check_starts", "starts"), ("deadlock", "starts, targets")])
def test_failing_method_of_a_third_party_problem_is_reported_with_its_line(
    file: Path, method: str, arguments: str, body: str, text: str
) -> None:
    lines = [
        "class Meet:",
        "    def __init__(self, *, target: tuple[float, ...], radius: float = 1.0):",
        "        pass",
    ]
    lines += [f"    def {method}(self, {arguments}):", f"        {body}", *OWN[OWN.index("def descend") :].splitlines()]
    (file.parent / "mine.py").write_text("\n".join(lines))
    (problem,) = found(source=file)
    assert problem.startswith("problem: " + text.format(method=method))


def test_method_with_another_signature_is_reported(file: Path) -> None:
    signature = "def check_starts(self):"
    (file.parent / "mine.py").write_text(OWN.replace("def check_starts(self, starts):", signature))
    (problem,) = found(source=file)
    assert problem.startswith("problem: Meet.check_starts() failed: TypeError: ")
