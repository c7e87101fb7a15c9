"""Run directories: what a failed start leaves is no obstacle, and any name will do."""

import json
from pathlib import Path

import pytest

from agentd.run_directory import new_folder
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.messaging.address import prefix_of


def left_behind(folder: Path, **about: str) -> None:
    """Leave what a launch leaves that ends before the first record."""
    (folder / "plugins").mkdir(parents=True)
    for name in ("fleet.toml", "operator.json", "plugins.json", "plugins/mine.py", "agent-1.err", "agent-2.msgpack"):
        (folder / name).write_text("")
    (folder / "run.json").write_text(json.dumps(about))


def test_a_start_that_failed_leaves_nothing_in_the_way(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    left_behind(folder, ended="2026-12-01")
    assert new_folder("fleet", folder) == folder
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("kept", ["a record", "a file of the user", "a launcher"])
def test_what_may_be_of_use_is_kept(tmp_path: Path, kept: str) -> None:
    folder = tmp_path / "run"
    left_behind(folder, **({} if kept == "a launcher" else {"ended": "2026-12-01"}))
    if kept == "a record":
        (folder / "agent-2.msgpack").write_bytes(b"x")
    elif kept == "a file of the user":
        (folder / "notes.txt").write_text("")
    before = sorted(folder.rglob("*"))
    with pytest.raises(RecordingError, match="this directory is not empty; choose another with --out"):
        new_folder("fleet", folder)
    assert sorted(folder.rglob("*")) == before


def test_keys_are_valid_whatever_the_name_of_the_directory() -> None:
    assert prefix_of("swap", "r#1*2$3?4") == "dcf/swap/r_1_2_3_4"
    assert prefix_of("swap", "position_swap-20261201") == "dcf/swap/position_swap-20261201"
