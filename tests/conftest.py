"""What all tests have in common."""

import gc
import signal
from collections.abc import Iterable
from pathlib import Path

import pytest

import agentd  # noqa: F401 - one thread for the linear algebra, as in every run, whatever else is imported first
from tests.support.daemons import TRIO

signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it may be ignored, in all children too


def pytest_collection_finish() -> None:
    """Spare the garbage collector all that is imported by now: simulations are a tenth faster."""
    gc.freeze()


def pytest_collection_modifyitems(items: Iterable[pytest.Item]) -> None:
    """Give tests in real time a second try, where the machine is held up for a second. All others pass at once."""
    for item in items:
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture
def trio(tmp_path: Path) -> Path:
    """The fleet file of `TRIO`, three agents on the wall clock."""
    (tmp_path / "trio.toml").write_text(TRIO)
    return tmp_path / "trio.toml"
