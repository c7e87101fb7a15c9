"""A parameter that is a frozen dataclass is a sub-table, its fields are the keys."""

from pathlib import Path
from typing import Any

import pytest

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import REQUIRED, accepted, check_options, create, load, peek
from tests.support.glider import GLIDER


@pytest.fixture
def gliders(tmp_path: Path) -> Path:
    """The folder that ``glider.py`` is in."""
    (tmp_path / "glider.py").write_text(GLIDER)
    return tmp_path


def made(folder: Path, **options: Any) -> Any:
    plugin = load("problems", "./glider.py:Glide", folder)
    return create(plugin, {"agent": 1}, {"limits": {"low": 0}, **options}, "problem")


def refused(folder: Path, **options: Any) -> list[str]:
    plugin = load("problems", "./glider.py:Glide", folder)
    return check_options(plugin, {"limits": {"low": 0}, **options}, "problem")[1]


def test_fields_of_the_dataclass_are_keys(gliders: Path) -> None:
    _, weights, limits, noise, _ = accepted(load("problems", "./glider.py:Glide", gliders)).parameters
    assert weights.table is not None
    assert limits.table is not None
    assert noise.table is not None
    assert [(p.name, p.default) for p in weights.table.parameters] == [
        ("state", (1.0, 0.1)),
        ("input", 0.5),  # of the default of the parameter, not of the class
        ("inner", weights.default.inner),
        ("unit", None),
    ]
    assert [(p.name, p.default) for p in limits.table.parameters] == [("low", REQUIRED), ("high", 9.0)]
    assert [(p.name, p.default) for p in noise.table.parameters] == [("seed", 3)]


def test_plugin_gets_an_object_with_defaults_for_the_keys_not_given(gliders: Path) -> None:
    problem = made(gliders, weights={"state": [2, 3], "inner": {"gain": 4}})
    assert problem.weights.state == (2.0, 3.0)
    assert problem.weights.input == 0.5
    assert (problem.weights.inner.gain, problem.weights.inner.names) == (4.0, ("a",))
    assert (problem.limits.low, problem.limits.high) == (0.0, 9.0)
    assert made(gliders).weights.input == 0.5


def test_earlier_key_is_refused_with_its_present_path(gliders: Path) -> None:
    text = "problem.input: Glide has no key 'input' any more: it is called 'weights.input'"
    assert refused(gliders, input=1.0) == [text]
    text = "problem.limits: expected a table, not 2.0; that value is called 'limits.low' now"
    assert refused(gliders, limits=2.0) == [text]


def test_complete_values_have_the_objects_of_all_tables(gliders: Path) -> None:
    values = accepted(load("problems", "./glider.py:Glide", gliders)).complete({"limits": {"low": 2}})
    assert (values["limits"].low, values["weights"].input, values["noise"]) == (2.0, 0.5, None)


def test_optional_table_is_made_only_if_it_is_given(gliders: Path) -> None:
    assert made(gliders).noise is None
    assert made(gliders, noise={}).noise.seed == 3


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (
            {"weights": {"inptu": 2.0}},
            "problem.weights.inptu: weights has no key 'inptu'; did you mean 'input'? accepted: state, input, inner,",
        ),
        ({"weights": {"input": "much"}}, "problem.weights.input: expected a number > 0, not 'much'"),
        ({"weights": {"input": 0}}, "problem.weights.input: expected a number > 0, not 0"),
        ({"weights": {"state": [1]}}, "problem.weights.state: expected a list of 2 numbers, not [1]"),
        (
            {"weights": {"inner": {"gain": float("nan")}}},
            "problem.weights.inner.gain: expected a finite number, not nan",
        ),
        (
            {"weights": {"inner": {"gian": 1.0}}},
            "problem.weights.inner.gian: inner has no key 'gian'; did you mean 'gain'? accepted: gain, names",
        ),
        ({"weights": {"total": 1.0}}, "problem.weights.total: weights has no key 'total'; accepted: state, input,"),
        ({"weights": 3.0}, "problem.weights: expected a table, not 3.0"),
        ({"weights": {"input": 90}}, "problem.weights: input must be at most ten times the sum of state, not 90"),
        ({"limits": {}}, "problem.limits.low: missing; limits needs a number"),
        ({"limits": {"high": 1.0}}, "problem.limits.low: missing; limits needs a number"),
        ({"limits": {"low": True}}, "problem.limits.low: expected a number, not true"),
    ],
)
def test_error_in_a_table_is_reported_with_the_path_of_the_key(
    gliders: Path, options: dict[str, Any], text: str
) -> None:
    (line,) = refused(gliders, **options)
    assert line.startswith(text)


def test_required_table_that_is_missing_is_reported_with_its_keys(gliders: Path) -> None:
    plugin = load("problems", "./glider.py:Glide", gliders)
    assert check_options(plugin, {}, "problem")[1] == [
        "problem.limits: missing; Glide needs a table with the keys low, high"
    ]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("loose", "loose: the dataclass Loose of weights must be frozen: agents share its default"),
        ("broken", "broken.weights: the types of Broken cannot be resolved: name 'Missing' is not defined"),
    ],
)
def test_dataclass_that_cannot_be_a_table_is_refused(gliders: Path, name: str, text: str) -> None:
    with pytest.raises(PluginError) as caught:
        accepted(load("topologies", f"./glider.py:{name}", gliders))
    assert str(caught.value) == text


def test_peeking_finds_the_keys_of_tables_without_running_the_file(gliders: Path) -> None:
    (gliders / "glider.py").write_text("1 / 0\n" + GLIDER)
    schema = peek("./glider.py:Glide", gliders)
    assert schema is not None
    options = {"weights": {"inptu": 2.0, "state": "any"}, "limits": {"high": 1}, "noise": {"sed": 1}}
    assert schema.convert(options)[1] == {
        "weights.inptu": "weights has no key 'inptu'; did you mean 'input'? accepted: state, input, inner, unit"
    }
    assert schema.missing({"weights": {}, "limits": {"high": 1}}) == {"limits.low": "missing; limits needs a value"}
