"""Modules next to a fleet file mean the same at every level, and names of others break nothing."""

import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import dcf_zenoh
from dcf_zenoh.config import freeze, load
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.plugins.modules_beside import OURS

AVERAGE = "1c36877cabf62c13"  # digest of the built-in fleet
TRACKING = """
from my_lab.shared import gain
from helper_of_my_lab import offset

def consensus(problem, me):
    x = problem.value.copy()
    for _ in range(60):
        inbox = yield {"x": x}, 1.0
        x = x + gain * (sum(inbox[j]["x"] for j in inbox) / len(inbox) - x)
        if inbox.stop:
            break
    return me.result(x + offset)
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """Folder with a fleet file, a package that it names, and a module that the package imports."""
    folder = tmp_path / "lab"
    (folder / "my_lab").mkdir(parents=True)
    (folder / "my_lab" / "__init__.py").write_text("")
    (folder / "my_lab" / "shared.py").write_text("gain = 0.5\n")
    (folder / "my_lab" / "tracking.py").write_text(TRACKING)
    (folder / "helper_of_my_lab.py").write_text("offset = 0.0\n")
    source = Path(load("average").source).read_text(encoding="utf-8")
    kept = [line for line in source.splitlines() if "average_consensus" not in line]
    text = "\n".join(kept).replace("[algorithm]", '[algorithm]\nkind = "my_lab.tracking:consensus"')
    (folder / "lab.toml").write_text(text, encoding="utf-8")
    return folder


def python(where: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python with these arguments in a folder."""
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=where, capture_output=True, text=True, timeout=60, check=False)


def run(where: Path, *words: str) -> str:
    """Run Python in a folder, without an error; return its output."""
    done = python(where, *words)
    assert done.returncode == 0, done.stderr
    return done.stdout


def digest(output: str) -> str:
    return str(json.loads(output)["digest"])[:16]


def test_names_of_any_module_in_the_working_folder_change_nothing(tmp_path: Path) -> None:
    installed = {name for name in metadata.packages_distributions() if name.isidentifier()}
    for name in {*installed, *sys.stdlib_module_names, *OURS, "tests"} - {"agentd"}:
        (tmp_path / f"{name}.py").write_text(f"raise RuntimeError('{name} of the user was imported')")
    simulate = ["simulate", "average", "--no-report", "--json"]
    launch = ["launch", "average", "--clock", "virtual", "--no-report", "--json"]
    assert digest(run(tmp_path, "-m", "agentd", *simulate, "--out", "s")) == AVERAGE
    assert digest(run(tmp_path, "-m", "agentd", *launch, "--out", "l")) == AVERAGE


@pytest.mark.parametrize("name", ["plants", "topologies"])
def test_a_script_whose_neighbour_hides_a_package_of_ours_is_told(tmp_path: Path, name: str) -> None:
    (tmp_path / f"{name}.py").write_text("raise RuntimeError('imported')")
    (tmp_path / "script.py").write_text("import dcf_zenoh\ndcf_zenoh.simulate('position_swap')")
    result = python(tmp_path, "script.py")
    expected = f"{tmp_path / name}.py hides the package {name!r} of dcf-zenoh: rename it, or start Python in another"
    assert expected in result.stderr
    assert "imported" not in result.stderr


def test_a_module_next_to_the_fleet_file_means_the_same_everywhere(lab: Path, tmp_path: Path) -> None:
    fleet = str(lab / "lab.toml")
    (tmp_path / "my_lab.py").write_text("raise RuntimeError('imported')")
    simulated = digest(run(tmp_path, "-m", "agentd", "simulate", fleet, "--no-report", "--json", "--out", "s"))
    launch = ["launch", fleet, "--clock", "virtual", "--no-report", "--json", "--out", "l"]
    assert digest(run(tmp_path, "-m", "agentd", *launch)) == simulated
    program = f"import dcf_zenoh; print(dcf_zenoh.simulate({fleet!r}).digest)"
    assert run(lab, "-c", program)[:16] == simulated


def test_modules_in_use_are_copied_and_the_copies_are_used(lab: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    program = f"import dcf_zenoh; print(dcf_zenoh.simulate({str(lab / 'lab.toml')!r}, out={out!r}).digest)"
    first = run(tmp_path, "-c", program)
    digests = json.loads((tmp_path / "run" / "plugins.json").read_text())
    copies = {each for each in digests if each.startswith("modules/")}
    assert copies == {f"modules/my_lab/{each}.py" for each in ("__init__", "shared", "tracking")} | {
        "modules/helper_of_my_lab.py"
    }
    (lab / "my_lab" / "shared.py").write_text("gain = 0.25\n")
    again = f"import dcf_zenoh; print(dcf_zenoh.simulate({out + '/fleet.toml'!r}).digest)"
    assert run(tmp_path, "-c", again) == first
    assert run(tmp_path, "-c", program.replace("/run'", "/run2'")) != first


def test_a_copy_that_was_changed_is_refused_and_errors_show_the_users_file(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def broken(problem, me):\n    yield 1 / 0, 1.0\n")
    fleet = load("average", changes=[f"algorithm.kind={tmp_path / 'mine.py'}:broken"])
    freeze(fleet, tmp_path / "run")
    program = f"import dcf_zenoh; dcf_zenoh.simulate({str(tmp_path / 'run' / 'fleet.toml')!r})"
    result = python(tmp_path, "-c", program)
    assert f'File "{tmp_path / "mine.py"}", line 2, in broken' in result.stderr
    copy = tmp_path / "run" / "plugins" / "mine.py"
    copy.write_text(copy.read_text() + "# changed")
    with pytest.raises(ConfigurationError, match=r"mine\.py was changed after the run began: its SHA-256"):
        load(tmp_path / "run" / "fleet.toml")
    assert dcf_zenoh.__version__
