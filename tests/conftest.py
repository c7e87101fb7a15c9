"""What all tests have in common."""

import gc
import signal
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import pytest

from agentd.cli import main  # agentd first: one thread for the linear algebra, as in every run
from tests.support.command_line import Answer
from tests.support.daemons import TRIO
from tests.support.durations import LONG, UNTRACED, key, recorded

signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it may be ignored, in all children too
for number in (signal.SIGHUP, signal.SIGQUIT):  # ignored under nohup and in the background
    signal.signal(number, signal.SIG_DFL)


def pytest_collection_finish() -> None:
    """Spare the garbage collector all that is imported by now: simulations are a tenth faster."""
    gc.freeze()


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark long tests and those not to be traced, put the longest files first, give tests in real time a second try.

    The order keeps two processes busy until the end. A second try is for a machine that was held up for a second; tests
    that only compute pass at once.
    """
    seconds = recorded()
    longest: defaultdict[str, float] = defaultdict(float)
    for item in items:
        file, *_ = item.nodeid.partition("::")
        took = seconds.get(key(item.nodeid), 0.0)
        longest[file] = max(longest[file], took)
        if took > LONG:
            item.add_marker(pytest.mark.long)
        elif took > UNTRACED:
            item.add_marker(pytest.mark.no_cover)
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=1))
    items.sort(key=lambda item: -longest[item.nodeid.partition("::")[0]])


@pytest.fixture
def trio(tmp_path: Path) -> Path:
    """The fleet file of `TRIO`, three agents on the wall clock."""
    (tmp_path / "trio.toml").write_text(TRIO)
    return tmp_path / "trio.toml"


@pytest.fixture
def agentd(capfd: pytest.CaptureFixture[str]) -> Callable[..., Answer]:
    """Run a command line in this process."""

    def run(*words: str | Path) -> Answer:
        capfd.readouterr()
        code = main([str(word) for word in words])
        return Answer(code, *capfd.readouterr())

    return run
