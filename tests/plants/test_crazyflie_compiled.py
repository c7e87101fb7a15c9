from pathlib import Path

import pytest

from plants import crazyflie_compiled


def test_machine_code_is_kept_apart_for_other_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crazyflie_compiled, "__file__", str(tmp_path / "crazyflie_compiled.py"))
    inner = tmp_path / "crazyflie_inner.py"
    folders: list[str] = []
    for text in ("@compiled  # 1", "@compiled  # 2", "@compiled  # 1"):
        inner.write_text(text)
        (tmp_path / "crazyflie_link.py").write_text(f"nothing for numba {len(folders)}")
        folders.append(crazyflie_compiled._folder())
    assert folders[0] == folders[2] != folders[1]
    assert Path(folders[0]).is_dir()


def test_an_installation_that_cannot_be_written_leaves_the_place_to_numba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "__pycache__").write_text("in the way")
    monkeypatch.setattr(crazyflie_compiled, "__file__", str(tmp_path / "crazyflie_compiled.py"))
    assert crazyflie_compiled._folder() == ""


def test_what_is_compiled_does_as_written() -> None:
    def mean(a: float, b: float) -> float:
        return (a + b) / 2

    assert crazyflie_compiled.compiled(mean)(1.0, 2.0) == mean(1.0, 2.0)
