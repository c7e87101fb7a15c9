"""Geometry of Lighthouse base stations: comparing a file with the drone's memory, and writing it."""

import time
from collections.abc import Callable, Generator, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import POLL

SAME = 1e-4  # m, and entries of a rotation matrix
READING, WRITING = 15.0, 40.0  # s
SYSTEM_TYPE = "lighthouse.systemType"  # version of the base stations


def install(link: Link, path: Path) -> Iterator[float]:
    """Write the geometry of a file to the drone; pauses, in s, until that is done.

    It is written, and stored over a restart, only if it differs from what the drone has.

    Args:
        link: Link to the drone.
        path: File as cfclient and cflib write it: YAML of type "lighthouse_system_configuration".

    Raises:
        PlantError: The file cannot be read, the drone has no Lighthouse deck, or does not store the geometry.
    """
    from cflib.localization import LighthouseConfigFileManager, LighthouseConfigWriter  # noqa: PLC0415

    try:
        geometries, calibrations, system = LighthouseConfigFileManager.read(str(path))
    except Exception as error:  # cflib raises many kinds for a malformed file
        raise PlantError(f"geometry {path} cannot be read: {error}") from error
    if not geometries:
        raise PlantError(f"geometry {path} has no base station")
    on_drone = yield from _read(link)
    if not _difference(geometries, on_drone):
        return
    if (yield from link.read(SYSTEM_TYPE)) != system:
        yield from link.write(SYSTEM_TYPE, system)
        yield 1.0  # the firmware clears the base stations of the other type
    writer = LighthouseConfigWriter(link.crazyflie)
    yield from _wait_for(
        lambda done: writer.write_and_store_config(done, geos=geometries, calibs=calibrations or None), WRITING, link
    )  # its result is False also if only base stations beyond the firmware's memory failed, so read back instead
    on_drone = yield from _read(link)
    if difference := _difference(geometries, on_drone):
        raise PlantError(f"geometry {path}: the drone did not take it: {difference}")


def _read(link: Link) -> Generator[float, None, Mapping[int, Any]]:
    """Read the drone's geometry: channel of the base station (from 0) -> geometry."""
    from cflib.crazyflie.mem import LighthouseMemHelper  # noqa: PLC0415

    try:
        helper = LighthouseMemHelper(link.crazyflie)
    except Exception as error:
        raise PlantError("it has no memory for the geometry of base stations: is there a Lighthouse deck?") from error
    found: Mapping[int, Any] = yield from _wait_for(helper.read_all_geos, READING, link)
    return found


def _difference(wanted: Mapping[int, Any], on_drone: Mapping[int, Any]) -> str:
    """Describe the first base station that differs; empty if none does."""
    for station in sorted({*wanted, *on_drone}):
        ours, its = wanted.get(station), on_drone.get(station)
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
    """Start an operation of cflib and return what it passes to its callback; pauses, in s, until then.

    Raises:
        PlantError: The callback is not called in time.
    """
    results: list[Any] = []
    begin(results.append)
    deadline = time.monotonic() + within
    while not results:
        if time.monotonic() > deadline or link.lost:
            raise PlantError(f"the geometry of its base stations: {link.lost or f'not done within {within:g} s'}")
        yield POLL
    return results[0]
