import sys
from pathlib import Path

import pytest

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import (
    load,
    peek,
)
from tests.support.blimp import BLIMP


def refusal(group: str, kind: str, folder: Path) -> str:
    with pytest.raises(PluginError) as caught:
        load(group, kind, folder)
    return str(caught.value)


def test_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    text = refusal("plants", "./blimp.py:Blimp", tmp_path)
    assert text == f"./blimp.py:Blimp: cannot read {tmp_path / 'blimp.py'}: No such file or directory"


def test_failing_import_of_a_file_is_reported_with_its_line_and_not_kept(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("x = 1\nimport no_such_library\n")
    before = set(sys.modules)
    text = refusal("plants", "./bad.py:Bad", tmp_path)
    assert "bad.py, line 2 failed: ModuleNotFoundError: No module named 'no_such_library'" in text
    assert set(sys.modules) == before


def test_file_that_exits_is_refused(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text("import sys\nsys.exit(3)")
    assert refusal("plants", "./script.py:Bad", tmp_path).endswith("script.py, line 2 failed: SystemExit: 3")


def test_file_is_imported_once_until_it_changes(folder: Path) -> None:
    before = list(sys.path)
    first = load("plants", "./blimp.py:Blimp", folder)
    assert load("plants", f"{folder}/blimp.py:Blimp", Path("elsewhere")) is first
    (folder / "blimp.py").write_text(BLIMP.replace("3", "4"))  # same length, within the same second
    assert load("plants", "./blimp.py:Data", folder)().size == 4
    assert not (folder / "__pycache__").exists()
    assert sys.path[: len(before)] == before  # what it imports is looked for next to it only if it is nowhere else
    assert str(folder) in sys.path[len(before) :]


def test_files_of_one_name_in_two_folders_are_two_modules(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "same.py").write_text("class Same: pass")
    first, second = (load("plants", "./same.py:Same", tmp_path / name) for name in ("a", "b"))
    assert first is not second


def test_peeking_finds_the_keys_without_running_the_file(tmp_path: Path) -> None:
    (tmp_path / "boom.py").write_text("1 / 0\nclass Boom:\n    def __init__(self, start, *, size, drag=None): pass")
    schema = peek("./boom.py:Boom", tmp_path)
    assert schema is not None
    assert [parameter.name for parameter in schema.parameters] == ["size", "drag"]
    assert schema.missing({}).keys() == {"size"}


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
