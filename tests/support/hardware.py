"""A real Crazyflie as a plant, made from keys without their sub-tables."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from plants.crazyflie.hardware import CrazyflieHardware
from plants.crazyflie.options import ConnectionOptions, HardwareFlightOptions, LocalisationOptions, WatchdogOptions

TABLES: Mapping[str, Any] = {
    "flight": HardwareFlightOptions,
    "watchdog": WatchdogOptions,
    "connection": ConnectionOptions,
    "localisation": LocalisationOptions,
}


def hardware(start: tuple[float, ...] = (0.0, 0.0), *, uri: str, agent: int = 2, **keys: Any) -> CrazyflieHardware:
    """Return the plant of an agent with a sample time of 0.2 s; `keys` are those of all sub-tables."""
    tables = {
        name: table(**{each.name: keys.pop(each.name) for each in fields(table) if each.name in keys})
        for name, table in TABLES.items()
    }
    return CrazyflieHardware(agent, np.array(start), 0.2, uri=uri, **tables, **keys)
