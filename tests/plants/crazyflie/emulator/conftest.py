"""Software Crazyflies, and cflib connected to them."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.cflib_client import Client, client
from tests.support.emulated import Emulated


@pytest.fixture(scope="package")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """For cflib's tables."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="package")
def drone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    """A drone that knows its state exactly."""
    with Emulated(tmp_path_factory.mktemp("truth"), "--sensing", "perfect") as running:
        yield running


@pytest.fixture(scope="module")
def connection(drone: Emulated, cache: Path) -> Iterator[Client]:
    """cflib, connected to the drone; silent until it is used."""
    drone.renew()
    with client(drone.uri, cache) as connected:
        connected.stop_pinging()
        yield connected


@pytest.fixture
def cf(drone: Emulated, connection: Client) -> Client:
    """cflib, connected to the drone, which has been switched off and on."""
    drone.renew()
    connection.renew()
    return connection
