"""``agentd sweep``: many runs of one fleet, one table."""

from collections.abc import Callable
from pathlib import Path

from tests.support.command_line import Answer

WORDS = ("sweep", "position_swap", "--vary", "exchange.max_rounds=20,40", "--seeds", "2", "--set", "time.duration=0.6")


def test_sweep_that_goes_on_comes_to_the_same_table(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    whole, begun = tmp_path / "whole", tmp_path / "begun"
    assert agentd(*WORDS, "--out", whole).code == 0
    table = (whole / "sweep.csv").read_bytes()
    assert table.count(b"\n") == 5
    assert agentd(*WORDS, "--out", begun).code == 0
    for row in sorted((begun / "rows").iterdir())[::2]:  # as if it had been interrupted before these
        row.unlink()
    (begun / "sweep.csv").unlink()
    answer = agentd(*WORDS, "--out", begun)
    assert answer.code == 0
    assert "2 of 4 runs were there already" in answer.err
    assert (begun / "sweep.csv").read_bytes() == table
    assert (begun / "sweep.png").stat().st_size > 10_000


def test_directory_of_another_sweep_is_refused(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    assert agentd(*WORDS, "--no-oracle", "--out", tmp_path / "one").code == 0
    answer = agentd(*WORDS[:-1], "time.duration=0.4", "--no-oracle", "--out", tmp_path / "one")
    assert answer.code != 0
    assert "another sweep is in it" in answer.err
