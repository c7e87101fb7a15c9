"""Tests that real time could disturb are marked ``real_time``, in their own file."""

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
HELPERS = {"Launch", "Emulated", "Relay", "Swarm", "Client", "client", "Cable", "until", "drive"}  # of tests.support
NAMES = {"sleep", "kill", "killpg", "fork", "Thread", "Timer", "ThreadPoolExecutor"}
MODULES = ("cflib", "tests.support.kills")  # imported, or run with python -m
FIXTURES = {"emulator": {"drone", "connection", "cf"}}  # of the conftest.py in a folder of this name


def is_marked(node: ast.AST) -> bool:
    """Whether a decorator or an assignment to ``pytestmark`` names the marker."""
    return any(isinstance(each, ast.Attribute) and each.attr == "real_time" for each in ast.walk(node))


def names_in(function: ast.AST) -> Iterator[str]:
    """Yield what a function uses: names, attributes, imported modules and whole strings."""
    for node in ast.walk(function):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name) | ast.alias(name=name):
                yield name
            case ast.ImportFrom(module=str(name)):
                yield name.partition(".")[0]
            case ast.Constant(value=str(name)):
                yield name


def unmarked(source: str, fixtures: Iterable[str] = ()) -> list[str]:
    """Return the tests of a module that use real time, directly or through its functions, and are not marked."""
    tree = ast.parse(source)
    if any(isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark" and is_marked(node)
           for node in tree.body):  # fmt: skip
        return []
    uses = {
        node.name: (node, set(names_in(node))) for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }
    imported = {
        alias.asname or alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("tests.support")
        for alias in node.names
        if alias.name in HELPERS
    }
    real = imported | NAMES | set(MODULES) | set(fixtures)
    while found := {name for name, (_, used) in uses.items() if name not in real and used & real}:
        real |= found
    return [
        name
        for name, (node, _) in uses.items()
        if name.startswith("test_") and name in real and not any(map(is_marked, node.decorator_list))
    ]


@pytest.mark.parametrize("path", sorted(TESTS.rglob("test_*.py")), ids=lambda path: str(path.relative_to(TESTS)))
def test_whatever_uses_real_time_is_marked(path: Path) -> None:
    assert unmarked(path.read_text(encoding="utf-8"), FIXTURES.get(path.parent.name, ())) == []


MADE_UP = """
import os, signal, subprocess, sys, pytest
from tests.support.daemons import Launch, launch_virtual

@pytest.fixture
def fleet(tmp_path):
    with Launch("position_swap", tmp_path) as launch:
        yield launch

def flown(drone): return drone

def test_virtual_time(tmp_path): launch_virtual("average", tmp_path)
def test_a_fixture(fleet): assert fleet
def test_a_drone(emulated): assert flown(emulated)
def test_a_kill(): os.kill(1, signal.SIGKILL)
def test_kills(): subprocess.run([sys.executable, "-m", "tests.support.kills"])
def test_a_library():
    from cflib.crazyflie import Crazyflie
@pytest.mark.real_time
def test_marked(fleet): assert fleet
"""


def test_a_made_up_module_without_markers_is_found() -> None:
    found = ["test_a_fixture", "test_a_kill", "test_kills", "test_a_library"]
    assert unmarked(MADE_UP) == found
    assert unmarked(MADE_UP, {"drone"}) == sorted([*found, "test_a_drone"], key=MADE_UP.index)
    assert unmarked(f"{MADE_UP}\npytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]\n") == []
