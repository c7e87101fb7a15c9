import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import CONTEXT, bind, check_options, check_signature, create, known, load, peek
from dcf_zenoh.schema import REQUIRED, accepted

ALL_KINDS = [(group, kind) for group in CONTEXT for kind in sorted(known(group))]

BLIMP = """
from __future__ import annotations
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal
import numpy as np
import numpy.typing as npt
from pydantic import Field
if TYPE_CHECKING:
    from nowhere import Start

class Blimp:
    def __init__(
        self, start: Start, agent: int, *,
        mass: Annotated[float, Field(gt=0)], drag: npt.NDArray[np.float64] | None = None,
        box: tuple[float, float] = (1.0, 1.0), mode: Literal["float", "sink"] = "float", names: list[str] = [],
        gain=0.5, count=3, quiet=False, sizes=(1, 2), free=None,
    ) -> None:
        self.given = (start, agent, mass, drag, box, mode, names, gain, count, quiet, sizes, free)
        if mass > 100:
            raise ValueError("mass must be at most 100 kg, not %g" % mass)
        if mass > 50:
            raise KeyError("oops")

class Odd:
    def __init__(self, altitude): pass

def tracking(problem, me, *, step=0.05, relax: float = 0.6, dual: float): yield

def short(problem): yield

@dataclass
class Data:
    size: int = 3

number = 3
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "blimp.py").write_text(BLIMP)
    return tmp_path


def refusal(group: str, kind: str, folder: Path) -> str:
    with pytest.raises(PluginError) as caught:
        load(group, kind, folder)
    return str(caught.value)


@pytest.mark.parametrize(("group", "kind"), ALL_KINDS)
def test_every_installed_kind_loads_and_fits_its_group(group: str, kind: str) -> None:
    plugin = load(group, kind, Path())
    assert check_signature(group, plugin) == []
    assert accepted(plugin).plugin == plugin.__name__


def test_kind_of_a_module_is_its_attribute() -> None:
    assert load("topologies", "topologies.ring:ring", Path()) is load("topologies", "ring", Path())


def test_unknown_kind_lists_the_known_ones_and_the_nearest() -> None:
    assert refusal("topologies", "rign", Path()) == (
        "unknown kind 'rign'; did you mean 'ring'? known topologies: complete, edges, grid, path, ring, star;"
        " or 'package.module:Name', './file.py:Name'"
    )


def test_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    text = refusal("plants", "./blimp.py:Blimp", tmp_path)
    assert text == f"./blimp.py:Blimp: cannot read {tmp_path / 'blimp.py'}: No such file or directory"


def test_name_that_is_not_in_the_file_gets_the_nearest_spelling(folder: Path) -> None:
    text = refusal("plants", "./blimp.py:Blmp", folder)
    assert "blimp.py has no 'Blmp'; did you mean 'Blimp'? it defines: Blimp, Odd, tracking, short, Data" in text


def test_what_cannot_be_called_is_refused(folder: Path) -> None:
    assert refusal("plants", "./blimp.py:number", folder) == "./blimp.py:number is int, not a class or function"


def test_failing_import_of_a_file_is_reported_with_its_line_and_not_kept(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("x = 1\nimport no_such_library\n")
    before = set(sys.modules)
    text = refusal("plants", "./bad.py:Bad", tmp_path)
    assert "bad.py, line 2 failed: ModuleNotFoundError: No module named 'no_such_library'" in text
    assert set(sys.modules) == before


def test_file_that_exits_is_refused(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text("import sys\nsys.exit(3)")
    assert refusal("plants", "./script.py:Bad", tmp_path).endswith("script.py, line 2 failed: SystemExit: 3")


def test_failing_import_of_a_module_is_reported() -> None:
    text = refusal("plants", "no_such_lab.blimp:Blimp", Path())
    assert text == (
        "no_such_lab.blimp:Blimp: importing no_such_lab.blimp failed:"
        " ModuleNotFoundError: No module named 'no_such_lab'"
    )


def test_file_is_imported_once_until_it_changes(folder: Path) -> None:
    first = load("plants", "./blimp.py:Blimp", folder)
    assert load("plants", f"{folder}/blimp.py:Blimp", Path("elsewhere")) is first
    (folder / "blimp.py").write_text(BLIMP.replace("3", "4"))  # same length, within the same second
    assert load("plants", "./blimp.py:Data", folder)().size == 4
    assert not (folder / "__pycache__").exists()
    assert str(folder) not in sys.path


def test_files_of_one_name_in_two_folders_are_two_modules(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "same.py").write_text("class Same: pass")
    first, second = (load("plants", "./same.py:Same", tmp_path / name) for name in ("a", "b"))
    assert first is not second


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


def test_values_become_what_the_signature_says(folder: Path) -> None:
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


def test_positional_parameters_are_filled_by_name(folder: Path) -> None:
    context = {"agent": 3, "rng": None, "start": "here", "sample_time": 0.2}
    made = create(load("plants", "./blimp.py:Blimp", folder), context, {"mass": 2}, "agents.3: plant")
    assert made.given[:3] == ("here", 3, 2.0)


def test_positional_parameter_that_nobody_fills_is_refused(folder: Path) -> None:
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


def test_peeking_finds_the_keys_without_running_the_file(tmp_path: Path) -> None:
    (tmp_path / "boom.py").write_text("1 / 0\nclass Boom:\n    def __init__(self, start, *, size, drag=None): pass")
    schema = peek("./boom.py:Boom", tmp_path)
    assert schema is not None
    assert [parameter.name for parameter in schema.parameters] == ["size", "drag"]
    assert schema.missing([]).keys() == {"size"}


def test_peeking_cannot_tell_the_keys_of_what_is_made_elsewhere(folder: Path) -> None:
    assert peek("./blimp.py:Data", folder) is None
    assert peek("./blimp.py:number", folder) is None
    assert peek("./blimp.py:dataclass", folder) is None


def test_peeking_names_what_a_file_defines(folder: Path) -> None:
    with pytest.raises(PluginError, match=r"has no 'Blmp'; did you mean 'Blimp'\? it defines: Blimp, Odd, tracking"):
        peek("./blimp.py:Blmp", folder)


def test_peeking_refuses_what_is_not_python(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("def (")
    with pytest.raises(PluginError, match=r"bad.py is not Python: SyntaxError: invalid syntax \(bad.py, line 1\)"):
        peek("./bad.py:bad", tmp_path)
