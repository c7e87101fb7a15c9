"""What all tests have in common."""

from collections.abc import Iterable
from pathlib import Path

import pytest

HERE = Path(__file__).parent
# Tests of processes in real time. Where the machine is held up for a second, some of what they show is not so; they get
# a second try. All others have to pass at once.
IN_REAL_TIME = (
    "agentd/test_deaths.py",
    "agentd/test_failures.py",
    "agentd/test_fault.py",
    "agentd/test_landing.py",
    "agentd/test_rejoin.py",
    "plants/emulator",
    "plants/test_crazyflie_hardware.py",
    "plants/test_crazyflie_hardware_flight.py",
    "test_hardware_fleet.py",
    "test_kernel.py",
)


def pytest_collection_modifyitems(items: Iterable[pytest.Item]) -> None:
    """Give tests in real time a second try."""
    for item in items:
        if item.path.relative_to(HERE).as_posix().startswith(IN_REAL_TIME):
            item.add_marker(pytest.mark.flaky(reruns=1))
