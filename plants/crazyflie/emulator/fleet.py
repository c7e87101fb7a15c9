"""Emulated drones, put together."""

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
from plants.crazyflie.emulator.radio import Air, Radio
from plants.crazyflie.emulator.truth import Truth
from plants.crazyflie.model.vehicle import read
from plants.sensing import LIGHTHOUSE

PORT = 19850  # where clients look for the first drone over UDP


class Place(NamedTuple):
    """Where a drone stands and listens.

    Attributes:
        position: m, shape (2,).
        yaw: rad.
        host: Its own address.
        port: 0 takes a free one.
        tcp: It listens for TCP instead of UDP.
    """

    position: Array
    yaw: float = 0.0
    host: str = "127.0.0.1"
    port: int = 0
    tcp: bool = False

    @property
    def endpoint(self) -> Endpoint:
        """Where it listens."""
        return Tcp(self.host, self.port) if self.tcp else Udp(self.host, self.port)


class Emulation:
    """Drones that have begun to live; they go on in `serve`.

    Args:
        places: Number -> where each stands and listens.
        parameters: Name of a file in `plants/crazyflie/parameters`.
        sensing: "lighthouse" or "perfect".
        air: How the radio behaves.
        truth: Folder for what they really do: ``drone-N.jsonl``. None: nothing is kept.
        seed: Of all errors and delays.

    Attributes:
        drones: By number.
        begin: Instant of the monotonic clock, s, that is their time 0.

    Raises:
        ValueError: There are no such parameters.
        OSError: A port is taken; the URI is its file name.
    """

    def __init__(
        self,
        places: Mapping[int, Place],
        *,
        parameters: str = "forster2015",
        sensing: str = "lighthouse",
        air: Air | None = None,
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
                firmware.step()  # compiles, or loads what is compiled
                made[number] = firmware, Radio(air or Air(), radio_rng), place.endpoint
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


def around(count: int) -> Sequence[Array]:
    """Where `count` drones stand if nobody says so: (0, 1), (0, -1), (1, 0), (-1, 0), then on a circle of 2 m, m."""
    cross = [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0)][:count]
    more = max(0, count - len(cross))
    circle = [(2 * np.cos(2 * np.pi * k / more), 2 * np.sin(2 * np.pi * k / more)) for k in range(more)]
    return [np.array(place) for place in [*cross, *circle]]
