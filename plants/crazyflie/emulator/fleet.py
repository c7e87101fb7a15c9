"""Composition of emulated drones."""

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.drone import Drone
from plants.crazyflie.emulator.endpoint import Endpoint, Tcp, Udp
from plants.crazyflie.emulator.firmware import Firmware
from plants.crazyflie.emulator.radio import Radio, RadioConditions
from plants.crazyflie.emulator.truth import Truth
from plants.crazyflie.model.vehicle import read
from plants.sensing import LIGHTHOUSE

PORT = 19850  # default UDP port of the first drone


class Place(NamedTuple):
    """Initial pose and endpoint of a drone.

    Attributes:
        position: Initial position, shape (2,), m.
        yaw: Initial heading, rad.
        host: Address to listen on.
        port: Port to listen on; 0 takes a free one.
        tcp: Listen for TCP instead of UDP.
    """

    position: Array
    yaw: float = 0.0
    host: str = "127.0.0.1"
    port: int = 0
    tcp: bool = False

    @property
    def endpoint(self) -> Endpoint:
        """Endpoint, not open yet."""
        return Tcp(self.host, self.port) if self.tcp else Udp(self.host, self.port)


class Emulation:
    """Emulated drones, ready for `serve`.

    Args:
        places: Number -> initial pose and endpoint.
        parameters: Name of a file in `plants/crazyflie/parameters`.
        sensing: "lighthouse" or "perfect".
        conditions: Properties of the radio links.
        truth: Folder for records of the true flights, ``drone-N.jsonl``; None: nothing is recorded.
        seed: Seed of all errors and delays.

    Attributes:
        drones: Number -> drone.
        begin: Instant of the monotonic clock, s, that is time 0 of the drones.

    Raises:
        ValueError: There are no such parameters.
        OSError: A port is taken; the `filename` of the error is the URI.
    """

    def __init__(
        self,
        places: Mapping[int, Place],
        *,
        parameters: str = "forster2015",
        sensing: str = "lighthouse",
        conditions: RadioConditions | None = None,
        truth: Path | None = None,
        seed: int = 0,
    ) -> None:
        vehicle = read(parameters)
        self._stack = ExitStack()
        self.drones: dict[int, Drone] = {}
        self.begin = 0.0
        with ExitStack() as failing:
            failing.push(self._stack)
            made = {}
            for number, place in places.items():
                rng, radio_rng = np.random.default_rng((seed, number)).spawn(2)
                kept = self._stack.enter_context(Truth(truth / f"drone-{number}.jsonl" if truth else None))
                sensor = LIGHTHOUSE if sensing == "lighthouse" else None
                firmware = Firmware(vehicle, place.position, place.yaw, sensor=sensor, rng=rng, truth=kept)
                firmware.step()  # compiles, or loads the compiled functions
                made[number] = firmware, Radio(conditions or RadioConditions(), radio_rng), place.endpoint
            self.begin = time.monotonic()
            for number, (firmware, radio, endpoint) in made.items():
                self._stack.callback(endpoint.close)
                try:
                    self.drones[number] = Drone(firmware, radio, endpoint, self.begin)
                except OSError as error:
                    raise OSError(error.errno, error.strerror, endpoint.uri) from error
            failing.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()


def default_positions(count: int) -> Sequence[Array]:
    """Return default positions, m: (0, 1), (0, -1), (1, 0), (-1, 0), and further ones on a circle of radius 2 m."""
    cross = [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)][:count]
    more = max(0, count - len(cross))
    circle = [(2 * np.cos(2 * np.pi * k / more), 2 * np.sin(2 * np.pi * k / more)) for k in range(more)]
    return [np.array(place) for place in [*cross, *circle]]
