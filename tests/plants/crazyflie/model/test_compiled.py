from pathlib import Path

import pytest

from plants.crazyflie.model import compiled


def test_machine_code_is_kept_apart_for_other_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    inner = tmp_path / "inner.py"
    folders: list[str] = []
    for text in ("gain = 1.0", "gain = 2.0", "gain = 1.0"):
        inner.write_text(text)
        folders.append(compiled._folder())
    assert folders[0] == folders[2] != folders[1]
    assert Path(folders[0]).is_dir()
    inner.rename(tmp_path / "renamed.py")
    assert compiled._folder() not in folders


def test_all_that_is_compiled_is_in_the_package_whose_sources_name_the_folder() -> None:
    """Else the machine code of a caller would outlive a change of what it calls, as after a rename of files."""
    plants = Path(compiled.__file__).parents[2]
    users = [path for path in plants.rglob("*.py") if "import compiled" in path.read_text(encoding="utf-8")]
    assert {path.name for path in users} == {"cascade.py", "dynamics.py", "stepping.py"}
    assert {path.parent for path in users} == {Path(compiled.__file__).parent}


def test_an_installation_that_cannot_be_written_has_its_code_in_the_users_cache_or_nowhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "__pycache__").write_text("in the way")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert Path(compiled._folder()).parent == tmp_path / "cache" / "dcf-zenoh"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "__pycache__"))
    assert compiled._folder() == ""
    monkeypatch.setattr(compiled, "FOLDER", "")

    def double(a: float) -> float:
        return 2 * a

    assert compiled.compiled(double)(1.5) == 3.0


def test_what_is_compiled_does_as_written() -> None:
    def mean(a: float, b: float) -> float:
        return (a + b) / 2

    assert compiled.compiled(mean)(1.0, 2.0) == mean(1.0, 2.0)
