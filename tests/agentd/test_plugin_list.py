import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from agentd.cli import main
from dcf_zenoh.plugins import GROUPS, known
from dcf_zenoh.plugins.loading import installed

ENTRY_POINTS = """
[dcf_zenoh.plants]
airship = my_lab:Airship
broken = my_lab_broken:Broken
kite = my_lab:Kite
nameless = my_lab
odd = my_lab:Odd
quitter = my_lab_quitter:Quitter
silent = my_lab:silent
"""

MY_LAB = '''
from dataclasses import dataclass
from typing import Annotated
from pydantic import Field

class Airship:
    """Lighter than air.

    And slower than all others.
    """
    def __init__(self, start, *, mass: Annotated[float, Field(gt=0)], drag: float | None = None, size=(1.0, 2.0),
                 quiet=False, names: list[str] = ["a"], label="x"):
        raise AssertionError("nothing is constructed")

@dataclass(frozen=True)
class Inner:
    gain: float
@dataclass(frozen=True)
class Weights:
    state: tuple[float, float] = (1.0, 0.1)
    inner: Inner = Inner(2.0)

class Kite:
    """Tied to the ground."""
    def __init__(self, *, weights: Weights = Weights(), limits: Inner, wind: Inner | None = None, mass=1.0): ...

class Odd:
    def __init__(self, start, *, size: "Missing" = 3): ...

def silent(start): ...
'''


@pytest.fixture
def _my_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install a third-party distribution with plug-ins."""
    info = tmp_path / "my_lab-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-lab\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    (tmp_path / "my_lab.py").write_text(MY_LAB)
    (tmp_path / "my_lab_broken.py").write_text("import no_such_driver")
    (tmp_path / "my_lab_quitter.py").write_text("raise SystemExit('no robot here')")
    monkeypatch.syspath_prepend(tmp_path)
    forget()
    yield
    forget()


def forget() -> None:
    """What was read of installed distributions."""
    installed.cache_clear()
    known.cache_clear()


def listing(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["plugins", *arguments]) == 0
    return capsys.readouterr().out


def test_every_kind_of_every_group_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    lines = listing(capsys).splitlines()
    assert [line for line in lines if not line.startswith(" ")] == list(GROUPS)
    kinds = [line.split()[0] for line in lines if line.startswith("  ") and not line.startswith("    ")]
    assert kinds == [kind for group in GROUPS for kind in sorted(known(group))]
    assert "cannot be used" not in "".join(lines)


def test_kind_has_its_summary_and_its_keys(capsys: pytest.CaptureFixture[str]) -> None:
    text = listing(capsys, "problems")
    assert text.startswith("problems\n  absolute_value        Each agent holds weight |x - value| and bounds; all want")
    for part in (
        """\
          average               Each agent holds a value; all want the mean.
            value: number or list of numbers, required
        """,
        """\
          position_swap         The aggregative game of the paper, posed anew at every control step.
            target: list of numbers, required
            prediction.horizon: whole number = 3
        """,
    ):
        assert textwrap.indent(textwrap.dedent(part), "  ") in text


def test_group_is_one_that_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["plugins", "plant"])
    assert caught.value.code == 2
    assert "argument GROUP: invalid choice: 'plant' (choose from " in capsys.readouterr().err


@pytest.mark.usefixtures("_my_lab")
def test_third_party_kinds_are_listed_and_broken_ones_with_the_reason(capsys: pytest.CaptureFixture[str]) -> None:
    text = listing(capsys, "plants")
    width = max(map(len, known("plants")))
    assert (
        f"  {'airship':<{width}}   Lighter than air.\n"
        "    mass: number > 0, required\n"
        "    drag: number, optional\n"
        "    size: list = [1.0, 2.0]\n"
        "    quiet: true or false = false\n"
        "    names: list of strings = ['a']\n"
        "    label: string = 'x'\n"
        f"  {'broken':<{width}}   cannot be used: broken: importing my_lab_broken failed:"
        " ModuleNotFoundError: No module named 'no_such_driver'\n"
    ) in text
    assert (
        f"  {'kite':<{width}}   Tied to the ground.\n"
        "    weights.state: list of 2 numbers = [1.0, 0.1]\n"
        "    weights.inner.gain: number = 2.0\n"
        "    limits: table, required\n"
        "    limits.gain: number, required\n"
        "    wind: table, optional\n"
        "    wind.gain: number, required\n"
        "    mass: number = 1.0\n"
    ) in text
    assert f"  {'nameless':<{width}}   cannot be used: nameless: " in text
    assert f"  {'odd':<{width}}   cannot be used: Odd: type 'Missing' of size cannot be resolved: " in text
    assert f"  {'point_mass':<{width}}   Point mass whose acceleration is held constant" in text
    assert (
        f"  {'quitter':<{width}}   cannot be used: quitter: importing my_lab_quitter failed:"
        " SystemExit: no robot here\n"
    ) in text
    assert f"  {'silent':<{width}}   (undocumented)\n" in text
