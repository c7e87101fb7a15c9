from collections.abc import Callable
from pathlib import Path

import pytest

from agentd.cli import main
from tests.support.command_line import Answer
from tests.support.daemons import TRIO


@pytest.fixture
def agentd(capfd: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """Run a command line in this process."""

    def run(*words: str | Path) -> Answer:
        capfd.readouterr()
        code = main([str(word) for word in words])
        return Answer(code, *capfd.readouterr())

    return run


@pytest.fixture
def trio(tmp_path: Path) -> Path:
    """A small fleet file, `TRIO`."""
    (tmp_path / "trio.toml").write_text(TRIO)
    return tmp_path / "trio.toml"
