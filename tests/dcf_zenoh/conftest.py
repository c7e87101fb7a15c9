from pathlib import Path

import pytest

from tests.support.blimp import BLIMP
from tests.support.fleet_files import FLEET, MINE


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A fleet file, with its plug-ins beside it."""
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "fleet.toml").write_text(FLEET)
    return tmp_path / "fleet.toml"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where ``blimp.py`` is."""
    (tmp_path / "blimp.py").write_text(BLIMP)
    return tmp_path
