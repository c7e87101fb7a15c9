from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import REQUIRED, accepted, check_options, load


def test_signature_is_the_schema(folder: Path) -> None:
    schema = accepted(load("algorithms", "./blimp.py:tracking", folder))
    assert [(p.name, p.type, p.default) for p in schema.parameters] == [
        ("step", float, 0.05),
        ("relax", float, 0.6),
        ("dual", float, REQUIRED),
    ]


def test_type_that_is_not_there_at_run_time_is_named(tmp_path: Path) -> None:
    (tmp_path / "f.py").write_text("def f(agents, *, size: 'Size' = 3): return []")
    with pytest.raises(PluginError, match="f: type 'Size' of size cannot be resolved: name 'Size' is not defined"):
        accepted(load("topologies", "./f.py:f", tmp_path))


def test_values_get_the_types_of_the_signature(folder: Path) -> None:
    blimp = load("plants", "./blimp.py:Blimp", folder)
    options = {"mass": 1, "drag": [[1, 2.5], [3, 4]], "box": [1, 2], "sizes": [3], "names": ["a"], "free": {"x": [1]}}
    values, problems = check_options(blimp, options, "plants.blimp")
    assert problems == []
    drag = values.pop("drag")
    assert np.array_equal(drag, [[1.0, 2.5], [3.0, 4.0]])
    assert not drag.flags.writeable
    assert values == {"mass": 1.0, "box": (1.0, 2.0), "sizes": (3,), "names": ["a"], "free": {"x": [1]}}
    assert isinstance(values["mass"], float)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("mass", "heavy", "expected a number > 0, not 'heavy'"),
        ("mass", -1, "expected a number > 0, not -1"),
        ("mass", True, "expected a number > 0, not true"),
        ("box", [1.0], "expected a list of 2 numbers, not [1.0]"),
        ("mode", "swim", "expected 'float' or 'sink', not 'swim'"),
        ("names", [1], "expected a list of strings, not [1]"),
        ("gain", False, "expected a number, not false"),
        ("gain", "1", "expected a number, not '1'"),
        ("count", 0.5, "expected a whole number, not 0.5"),
        ("count", True, "expected a whole number, not true"),
        ("quiet", 1, "expected true or false, not 1"),
        ("sizes", 3, "expected a list, not 3"),
        (
            "drag",
            [True],
            "expected an array of numbers, not [True]; its items must be numbers, its rows of equal length",
        ),
        ("drag", [[1], [1, 2]], "expected an array of numbers, not [[1], [1, 2]]; its items must be"),
    ],
)
def test_value_of_another_type_is_refused(folder: Path, key: str, value: Any, text: str) -> None:
    _, problems = check_options(load("plants", "./blimp.py:Blimp", folder), {"mass": 1.0, key: value}, "plants.b")
    assert len(problems) == 1
    assert problems[0].startswith(f"plants.b.{key}: {text}")


def test_unknown_key_gets_the_nearest_spelling_and_the_accepted_ones(folder: Path) -> None:
    tracking = load("algorithms", "./blimp.py:tracking", folder)
    assert check_options(tracking, {"stpe": 1.0}, "algorithm")[1] == [
        "algorithm.stpe: tracking has no key 'stpe'; did you mean 'step'? accepted: step, relax, dual",
        "algorithm.dual: missing; tracking needs a number",
    ]
