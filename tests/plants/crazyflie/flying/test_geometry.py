"""The geometry of Lighthouse's base stations, from a file to the drone."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.connecting import connect
from plants.crazyflie.connection.link import Link
from plants.crazyflie.flying.geometry import install
from tests.support.emulated import Emulated, drive
from tests.support.hardware import hardware

pytestmark = pytest.mark.real_time

# As cfclient writes it, for two base stations; the numbers are made up.
FILE = """
type: lighthouse_system_configuration
version: '1'
systemType: 2
geos:
  0:
    origin: [-2.0, 1.5, 2.25]
    rotation: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
  2:
    origin: [2.0, -1.5, 2.0]
    rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
calibs: {}
"""


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    with Emulated(tmp_path_factory.mktemp("truth")) as drone:
        yield drone


@pytest.fixture
def link(emulator: Emulated, tmp_path: Path) -> Iterator[Link]:
    opening = connect(emulator.uri, tmp_path, timeout=20.0, retries=3)
    opened: list[Link] = []

    def open_it() -> Iterator[float]:
        opened.append((yield from opening))

    drive(open_it())
    yield opened[0]
    opened[0].close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "geometry.yaml"
    path.write_text(FILE, encoding="utf-8")
    return path


def writes(monkeypatch: pytest.MonkeyPatch, link: Link) -> list[int]:
    """Channels of memory that are written to from now on."""
    seen: list[int] = []
    write = link.crazyflie.mem.write

    def noted(memory: object, address: int, *rest: object, **options: object) -> object:
        seen.append(address)
        return write(memory, address, *rest, **options)

    monkeypatch.setattr(link.crazyflie.mem, "write", noted)
    return seen


def test_the_drone_is_made_to_know_it_once(link: Link, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cflib.crazyflie.mem import LighthouseMemHelper  # noqa: PLC0415

    seen = writes(monkeypatch, link)
    drive(install(link, file))
    assert seen
    seen.clear()
    drive(install(link, file))
    assert not seen
    read: list[dict[int, Any]] = []
    LighthouseMemHelper(link.crazyflie).read_all_geos(read.append)
    drive(0.02 for _ in iter(lambda: bool(read), True))
    known = {station: geometry for station, geometry in read[0].items() if geometry.valid}
    assert sorted(known) == [0, 2]
    np.testing.assert_allclose(known[0].origin, [-2.0, 1.5, 2.25])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (None, "cannot be read: "),
        ("type: something_else\nversion: '1'\n", "cannot be read: Unsupported file type"),
        (FILE.partition("geos")[0], "has no base station"),
    ],
)
def test_a_file_that_is_none_is_refused(link: Link, tmp_path: Path, text: str | None, problem: str) -> None:
    path = tmp_path / "other.yaml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(PlantError, match="geometry ") as caught:
        drive(install(link, path))
    assert problem in str(caught.value)


def test_base_stations_without_calibration_do_not_help(emulator: Emulated, file: Path, tmp_path: Path) -> None:
    emulator.renew()
    plant = hardware(uri=emulator.uri, cache=str(tmp_path), geometry=str(file))
    try:
        drive(plant.prepare())
        drive(plant.inspect())
    finally:
        plant.close()
    checks = {check.name: check for check in plant.checks()}
    assert checks["base stations"].value in ("1 base station", "2 base stations")  # it receives 0 and 1, and knows 0, 2
