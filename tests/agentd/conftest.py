from pathlib import Path

import pytest

from agentd.cli import main
from tests.support.command_line import QUICK
from tests.support.daemons import TRIO


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a short simulation of `TRIO`. Tests only read it."""
    folder = tmp_path_factory.mktemp("flown")
    (folder / "trio.toml").write_text(TRIO)
    assert main(["simulate", str(folder / "trio.toml"), *QUICK, "--out", str(folder / "run")]) == 0
    return folder / "run"
