from pathlib import Path

import pytest

from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import CONTEXT, accepted, check_signature, known, load

ALL_KINDS = [(group, kind) for group in CONTEXT for kind in sorted(known(group))]


def refusal(group: str, kind: str, folder: Path) -> str:
    with pytest.raises(PluginError) as caught:
        load(group, kind, folder)
    return str(caught.value)


@pytest.mark.parametrize(("group", "kind"), ALL_KINDS)
def test_every_installed_kind_loads_and_fits_its_group(group: str, kind: str) -> None:
    plugin = load(group, kind, Path())
    assert check_signature(group, plugin) == []
    assert accepted(plugin).owner == plugin.__name__


def test_kind_of_a_module_is_its_attribute() -> None:
    assert load("topologies", "topologies.ring:ring", Path()) is load("topologies", "ring", Path())


def test_unknown_kind_lists_the_known_ones_and_the_nearest() -> None:
    assert refusal("topologies", "rign", Path()) == (
        f"unknown kind 'rign'; did you mean 'ring'? known topologies: {', '.join(sorted(known('topologies')))};"
        " or 'package.module:Name', './file.py:Name'"
    )


def test_name_that_is_not_in_the_file_gets_the_nearest_spelling(folder: Path) -> None:
    text = refusal("plants", "./blimp.py:Blmp", folder)
    assert "blimp.py has no 'Blmp'; did you mean 'Blimp'? it defines: Blimp, Odd, tracking, short, Data" in text


def test_what_cannot_be_called_is_refused(folder: Path) -> None:
    assert refusal("plants", "./blimp.py:number", folder) == "./blimp.py:number is int, not a class or function"


def test_failing_import_of_a_module_is_reported() -> None:
    text = refusal("plants", "no_such_lab.blimp:Blimp", Path())
    assert text == (
        "no_such_lab.blimp:Blimp: importing no_such_lab.blimp failed:"
        " ModuleNotFoundError: No module named 'no_such_lab'"
    )
