"""Keys of the Crazyflie's sub-tables, and what became of the earlier ones."""

from typing import Any

import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.plugins import Schema, accepted
from plants.crazyflie.hardware import CrazyflieHardware
from plants.crazyflie.options import LOOP, lead_of, reference_for
from plants.crazyflie.simulated import Crazyflie

HARDWARE = Overrides(plant="hardware", clock="wall")

LATER = {
    f"watchdog.{key}" for key in ("unmeasured_after", "variance_max", "position_lost")
}  # since there are sub-tables


def paths(schema: Schema, prefix: str = "") -> set[str]:
    """The paths of all keys that are not sub-tables."""
    found: set[str] = set()
    for each in schema.parameters:
        found |= paths(each.table, f"{each.name}.") if each.table else {prefix + each.name}
    return found


@pytest.mark.parametrize("plant", [Crazyflie, CrazyflieHardware])
def test_every_earlier_key_has_a_present_one(plant: Any) -> None:
    present = paths(accepted(plant))
    assert set(plant.RENAMED.values()) <= present
    assert set(plant.RENAMED.values()) >= {path for path in present if "." in path} - LATER


@pytest.mark.parametrize(("key", "path"), CrazyflieHardware.RENAMED.items())
def test_earlier_key_of_the_hardware_is_refused_with_its_present_name(key: str, path: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", HARDWARE, changes=[f"plants.hardware.{key}=1.0"])
    text = f"plants.hardware.{key}: CrazyflieHardware has no key {key!r} any more: it is called {path!r}"
    assert text in refused.value.problems


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("flight.rate=5.0", "flight: rate must be 10 to 100 Hz, not 5"),
        ("watchdog.battery_low=3.8", "watchdog: battery_low must be below battery_min, 3.7 V, not 3.8"),
        ("connection.timeout=0.0", "connection: timeout must be 1 to 300 s, not 0"),
    ],
)
def test_value_out_of_range_is_refused_at_its_sub_table(change: str, text: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", HARDWARE, changes=[f"plants.hardware.{change}"])
    assert f"plants.hardware.{text}" in refused.value.problems


@pytest.mark.parametrize(("plant", "clock"), [("twin", "virtual"), ("hardware", "wall")])
@pytest.mark.parametrize("sample_time", [0.02, 0.05, 0.09, 0.31, 0.5])
def test_velocities_are_no_reference_at_sample_times_at_which_they_are_not_followed(
    plant: str, clock: Any, sample_time: float
) -> None:
    horizon = max(3, round(0.6 / sample_time))
    changes = [
        f"time.sample_time={sample_time}",
        f"exchange.budget={sample_time}",
        f"problem.prediction.horizon={horizon}",
    ]
    with pytest.raises(ConfigurationError) as refused:
        load(
            "position_swap",
            Overrides(plant=plant, clock=clock),
            changes=[*changes, f"plants.{plant}.flight.reference=velocity"],
        )
    text = f"flight.reference 'velocity' needs a time.sample_time of 0.1 to 0.3 s, not {sample_time:g} s: "
    assert all(text in problem for problem in refused.value.problems)
    load("position_swap", Overrides(plant=plant, clock=clock), changes=changes)


@pytest.mark.parametrize("sample_time", [0.1, 0.15, 0.2, 0.3])
def test_velocities_are_a_reference_at_sample_times_at_which_they_are_followed(sample_time: float) -> None:
    changes = [f"time.sample_time={sample_time}", f"exchange.budget={sample_time}"]
    load("position_swap", Overrides(plant="twin"), changes=[*changes, "plants.twin.flight.reference=velocity"])


def test_default_reference_is_that_of_the_paper_at_its_sample_time_and_leads_at_others() -> None:
    assert [reference_for(None, sample_time) for sample_time in (0.1, 0.2, 0.3, 0.4)] == [
        "lead",
        "velocity",
        "velocity",
        "lead",
    ]
    assert lead_of("velocity", 0.05) == 0.05
    assert lead_of("lead", 1e-6) == pytest.approx(1 / LOOP, rel=1e-4)
    assert lead_of("lead", 5.0) == pytest.approx(5.0, rel=1e-4)
