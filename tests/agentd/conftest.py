from collections.abc import Callable
from pathlib import Path

import pytest

from agentd.cli import main
from tests.support.command_line import Answer


@pytest.fixture
def agentd(capfd: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """Run a command line in this process."""

    def run(*words: str | Path) -> Answer:
        capfd.readouterr()
        code = main([str(word) for word in words])
        return Answer(code, *capfd.readouterr())

    return run
