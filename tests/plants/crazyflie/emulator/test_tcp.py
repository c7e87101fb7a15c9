"""The same over TCP, in frames of CPX."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.cflib_client import client
from tests.support.emulated import Emulated

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def tcp_drone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    with Emulated(tmp_path_factory.mktemp("tcp"), "--tcp", "--sensing", "perfect") as running:
        yield running


def test_drone_is_flown_over_tcp_twice(tcp_drone: Emulated, cache: Path) -> None:
    assert tcp_drone.uri.startswith("tcp://127.0.0.1:")
    for _ in range(2):
        tcp_drone.renew()
        with client(tcp_drone.uri, cache) as cf:
            cf.log("stateEstimate.x", "stateEstimate.z")
            cf.take_off()
            cf.hover(1.5, ahead=0.3)
            assert cf.logged["stateEstimate.x"] > 0.2
            cf.land()
        assert tcp_drone.landed_softly()
