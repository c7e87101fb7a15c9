"""What all tests have in common."""

import gc
import signal
from collections.abc import Iterable
from pathlib import Path

import pytest

import agentd  # noqa: F401 - one thread for the linear algebra, as in every run, whatever else is imported first

signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background it may be ignored, in all children too
HERE = Path(__file__).parent
# Tests of processes in real time. Where the machine is held up for a second, and what they show is not so, they get a
# second try. All others have to pass at once. Those of a whole fleet run one by one (`make test`).
IN_REAL_TIME = (
    "agentd/test_compare.py",
    "agentd/test_daemon.py",
    "agentd/test_deaths.py",
    "agentd/test_emulate.py",
    "agentd/test_failures.py",
    "agentd/test_fault.py",
    "agentd/test_frozen.py",
    "agentd/test_landing.py",
    "agentd/test_links.py",
    "agentd/test_rejoin.py",
    "agentd/test_sweep_interrupted.py",
    "dcf_zenoh/messaging/test_network.py",
    "dcf_zenoh/messaging/test_waker.py",
    "plants/emulator",
    "plants/test_crazyflie_hardware.py",
    "plants/test_crazyflie_hardware_flight.py",
    "plants/test_crazyflie_outbox.py",
    "plants/test_crazyflie_pose.py",
    "test_hardware_fleet.py",
    "test_kernel.py",
    "test_lossy_flight.py",
)


OF_ONE = (  # one body or session at a time, or what waits long enough for others: four of these get along
    "agentd/test_compare.py",
    "agentd/test_emulate.py",
    "agentd/test_links.py",
    "agentd/test_sweep_interrupted.py",
    "dcf_zenoh/messaging",
    "plants",
)


def pytest_collection_finish() -> None:
    """Spare the garbage collector all that is imported by now: simulations are a tenth faster."""
    gc.freeze()


def pytest_collection_modifyitems(items: Iterable[pytest.Item]) -> None:
    """Mark tests in real time, and give them a second try."""
    for item in items:
        place = item.path.relative_to(HERE).as_posix()
        if place.startswith(IN_REAL_TIME):
            item.add_marker(pytest.mark.real_time)
            item.add_marker(pytest.mark.flaky(reruns=1))
            if not place.startswith(OF_ONE):
                item.add_marker(pytest.mark.alone)
