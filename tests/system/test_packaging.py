"""What is built from the checkout is complete: a wheel flies a fleet outside of the checkout, with the same bits."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from zipfile import ZipFile

import numpy as np
import pytest

import dcf_zenoh

ROOT = Path(__file__).parents[2]
PACKAGES = ("agentd", "dcf_zenoh", "plants", "topologies")
AROUND = ("benchmarks", "docs", "examples", "tests", ".ci")
LEFTOVERS = (".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "build", "dist", "site", "runs", "*.egg-info")
BUILD = "import sys; from setuptools import build_meta; getattr(build_meta, 'build_' + sys.argv[1])(sys.argv[2])"


class Built(NamedTuple):
    """A source tree without leftovers, and what was built from it."""

    source: Path
    sdist: Path
    wheel: Path
    output: str


def run(command: Sequence[str | Path], folder: Path) -> "subprocess.CompletedProcess[str]":
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """A source distribution and a wheel, built from a copy of the checkout, in which no earlier build left anything."""
    source, dist = tmp_path_factory.mktemp("source") / "tree", tmp_path_factory.mktemp("dist")
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*LEFTOVERS))
    output = ""
    for what in ("sdist", "wheel"):
        done = run([sys.executable, "-c", BUILD, what, dist], source)
        output += done.stdout + done.stderr
    return Built(source, next(dist.glob("*.tar.gz")), next(dist.glob("*.whl")), output)


def files_of(root: Path, *folders: str) -> set[str]:
    """Paths of all files below `folders`, relative to `root`."""
    found = [path for folder in folders for path in (root / folder).rglob("*") if path.is_file()]
    return {path.relative_to(root).as_posix() for path in found if ".egg-info" not in path.as_posix()}


def test_wheel_holds_every_file_of_the_packages(built: Built) -> None:
    wanted = files_of(built.source, *PACKAGES)
    assert len(wanted) > 200
    with ZipFile(built.wheel) as archive:
        assert {name for name in archive.namelist() if ".dist-info/" not in name} == wanted


def test_source_distribution_holds_all_that_the_checks_need(built: Built) -> None:
    wanted = files_of(built.source, *PACKAGES, *AROUND)
    wanted |= {path.name for path in built.source.iterdir() if path.is_file() and path.name != ".gitignore"}
    with tarfile.open(built.sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert wanted - held == set()
    assert [line for line in built.output.splitlines() if "warning" in line.lower()] == []


def test_fleet_of_an_installed_wheel_flies_with_the_same_bits(built: Built, tmp_path: Path) -> None:
    """Dependencies come from the environment that runs the tests; the project itself from the wheel alone."""
    venv.create(tmp_path / "env", with_pip=False)
    base = {"base": str(tmp_path / "env"), "platbase": str(tmp_path / "env")}
    packages = Path(sysconfig.get_path("purelib", "venv", vars=base))
    scripts = Path(sysconfig.get_path("scripts", "venv", vars=base))
    (packages / "dependencies.pth").write_text(str(Path(np.__file__).parents[1]))
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(tmp_path / "env")]
    run([*pip, "install", "--no-deps", "--quiet", str(built.wheel)], tmp_path)
    where = run([scripts / "python", "-c", "import agentd; print(agentd.__file__)"], tmp_path).stdout
    assert Path(where.strip()).is_relative_to(tmp_path)
    flight = [str(scripts / "agentd"), "launch", "position_swap", "--clock", "virtual", "--json", "--no-report"]
    summary = json.loads(run([*flight, "--out", str(tmp_path / "run")], tmp_path).stdout)
    assert summary["digest"] == dcf_zenoh.simulate("position_swap").digest
