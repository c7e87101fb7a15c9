from pathlib import Path

import pytest

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import bind, check_signature, create, load


def test_positional_parameters_are_filled_by_name(folder: Path) -> None:
    context = {"agent": 3, "rng": None, "start": "here", "sample_time": 0.2}
    made = create(load("plants", "./blimp.py:Blimp", folder), context, {"mass": 2}, "agents.3: plant")
    assert made.given[:3] == ("here", 3, 2.0)


def test_positional_parameter_that_the_framework_cannot_fill_is_refused(folder: Path) -> None:
    with pytest.raises(PluginError) as caught:
        create(load("plants", "./blimp.py:Odd", folder), {"agent": 3, "start": 0}, {}, "plants.odd")
    assert str(caught.value) == (
        "plants.odd: Odd has a positional parameter 'altitude'; allowed: agent, start;"
        " keys of the fleet file go after '*'"
    )


@pytest.mark.parametrize(("mass", "text"), [(101, "mass must be at most 100 kg, not 101"), (51, "KeyError: 'oops'")])
def test_constructor_that_raises_refused_its_options(folder: Path, mass: float, text: str) -> None:
    with pytest.raises(PluginError) as caught:
        create(load("plants", "./blimp.py:Blimp", folder), {"start": 0, "agent": 1}, {"mass": mass}, "plants.b")
    assert str(caught.value) == f"plants.b: Blimp refused its options: {text}"


def test_algorithm_is_bound_to_its_options_alone(folder: Path) -> None:
    bound = bind(load("algorithms", "./blimp.py:tracking", folder), {"dual": 2}, "algorithm")
    assert bound.keywords == {"dual": 2.0}  # type: ignore[attr-defined]
    with pytest.raises(PluginError, match=r"algorithm\.dual: missing; tracking needs a number"):
        bind(load("algorithms", "./blimp.py:tracking", folder), {}, "algorithm")


def test_algorithm_takes_problem_and_me(folder: Path) -> None:
    assert check_signature("algorithms", load("algorithms", "./blimp.py:short", folder)) == [
        "short: an algorithm's signature is (problem, me, *, options), not (problem, ...)"
    ]
