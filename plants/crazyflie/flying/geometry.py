"""Where the base stations of Lighthouse stand: what a Crazyflie knows of it, and what a file says."""

import time
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import LOOK

SAME = 1e-4  # m, and entries of a rotation matrix
READING, WRITING = 15.0, 40.0  # s
SYSTEM_TYPE = "lighthouse.systemType"  # version of the base stations


def install(link: Link, path: Path) -> Iterator[float]:
    """Make the drone know the geometry that a file has; pauses, in s, until it does.

    It is written, and kept over a restart, only where it differs.

    Args:
        link: To the drone.
        path: As cfclient and the library write it: YAML, a "lighthouse_system_configuration".

    Raises:
        PlantError: The file cannot be read, the drone has no Lighthouse deck, or does not take it.
    """
    from cflib.localization import LighthouseConfigFileManager, LighthouseConfigWriter  # noqa: PLC0415

    try:
        geometries, calibrations, system = LighthouseConfigFileManager.read(str(path))
    except Exception as error:  # whatever is wrong with it
        raise PlantError(f"geometry {path} cannot be read: {error}") from error
    if not geometries:
        raise PlantError(f"geometry {path} has no base station")
    has = yield from _read(link)
    if not _difference(geometries, has):
        return
    if (yield from link.read(SYSTEM_TYPE)) != system:
        yield from link.write(SYSTEM_TYPE, system)
        yield 1.0  # it forgets all that it knew of the others
    writer = LighthouseConfigWriter(link.crazyflie)
    yield from _wait_for(
        lambda done: writer.write_and_store_config(done, geos=geometries, calibs=calibrations or None), WRITING, link
    )  # it says that it failed where it writes to more base stations than the firmware has room for: so look
    has = yield from _read(link)
    if difference := _difference(geometries, has):
        raise PlantError(f"geometry {path}: the drone did not take it: {difference}")


def _read(link: Link) -> Generator[float, None, Mapping[int, Any]]:
    """What the drone knows, by channel of the base station."""
    from cflib.crazyflie.mem import LighthouseMemHelper  # noqa: PLC0415

    try:
        helper = LighthouseMemHelper(link.crazyflie)
    except Exception as error:
        raise PlantError("it has no memory for the geometry of base stations: is there a Lighthouse deck?") from error
    found: Mapping[int, Any] = yield from _wait_for(helper.read_all_geos, READING, link)
    return found


def _difference(wanted: Mapping[int, Any], has: Mapping[int, Any]) -> str:
    """The first base station that the drone knows otherwise; empty if there is none."""
    for station in sorted({*wanted, *has}):
        ours, its = wanted.get(station), has.get(station)
        if (ours is not None) != (its is not None and its.valid):
            return f"base station {station + 1} {'is missing' if ours is not None else 'is not in the file'}"
        if ours is not None and its is not None:
            apart = max(
                float(np.abs(np.subtract(ours.origin, its.origin)).max()),
                float(np.abs(np.subtract(ours.rotation_matrix, its.rotation_matrix)).max()),
            )
            if apart > SAME:
                return f"base station {station + 1} differs by {apart:.4f}"
    return ""


def _wait_for(
    begin: Callable[[Callable[[Any], None]], object], within: float, link: Link
) -> Generator[float, None, Any]:
    """What a call of cflib's hands over when it is done.

    Raises:
        PlantError: It is not done in time.
    """
    results: list[Any] = []
    begin(results.append)
    deadline = time.monotonic() + within
    while not results:
        if time.monotonic() > deadline or link.lost:
            raise PlantError(f"the geometry of its base stations: {link.lost or f'not done within {within:g} s'}")
        yield LOOK
    return results[0]
