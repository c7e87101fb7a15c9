"""The version of the package is that of the installed distribution."""

import tomllib
from pathlib import Path

import pytest

import dcf_zenoh
from agentd.cli import main

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def test_package_and_command_line_name_the_version_of_the_project(capsys: pytest.CaptureFixture[str]) -> None:
    version = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["version"]
    assert dcf_zenoh.__version__ == version
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"dcf-zenoh {version}\n"


def test_package_has_no_other_attributes_than_its_own() -> None:
    assert not hasattr(dcf_zenoh, "__versions__")
