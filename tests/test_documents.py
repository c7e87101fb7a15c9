"""The documents tell the truth: their complete examples run, their links lead somewhere."""

import os
import re
import subprocess
import sys
import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tomli_w

from dcf_zenoh import simulate
from dcf_zenoh.config import load

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *ROOT.glob("docs/**/*.md")])

# An example is complete if a comment above it says so: '<!-- file: NAME -->', which others of the same document may
# refer to, or '<!-- run -->'.
FENCE = re.compile(r"(?:<!-- (?P<mark>[^\n]*) -->\n)?^ *```(?P<language>\w*)\n(?P<text>.*?)^ *```$", re.M | re.S)
DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.M | re.S)
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)")

# A fleet in which lossy networks are allowed, for snippets to be put into.
WHOLE = """
name = "whole"
exchange = { max_rounds = 40, round_timeout = 0.003 }
problem = { kind = "position_swap" }
algorithm = { kind = "trades_robust" }
controller = { kind = "receding_horizon", sharing = "piggyback" }
plants = { point = { kind = "point_mass" } }

[agents]
1 = { start = [0.0, 1.0], target = [0.0, -1.0] }
2 = { start = [0.0, -1.0], target = [0.0, 1.0] }
3 = { start = [1.0, 0.0], target = [-1.0, 0.0] }
4 = { start = [-1.0, 0.0], target = [1.0, 0.0] }
"""


class Example(NamedTuple):
    mark: str
    language: str
    text: str


def examples(document: Path) -> list[Example]:
    found = FENCE.finditer(document.read_text(encoding="utf-8"))
    return [Example(each["mark"] or "", each["language"], each["text"]) for each in found]


def files(document: Path) -> dict[str, str]:
    return {mark.removeprefix("file: "): text for mark, _, text in examples(document) if mark.startswith("file: ")}


def anchors(document: Path) -> set[str]:
    """What links into a document can name: its headings, as GitHub spells them."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", document.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def named(document: Path) -> str:
    return document.relative_to(ROOT).as_posix()


@pytest.fixture
def folder(document: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the files of a document."""
    for name, text in files(document).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_examples_are_found() -> None:
    assert {"README.md", "CONTRIBUTING.md", "docs/tutorial.md"} <= set(map(named, DOCUMENTS))
    assert list(files(ROOT / "README.md")) == ["my_consensus.py", "mean.toml"]
    assert [each.mark for each in examples(ROOT / "README.md")].count("run") == 2


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_toml_example_parses(document: Path) -> None:
    for example in examples(document):
        if example.language == "toml":
            tomllib.loads(example.text)


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_python_example_compiles(document: Path) -> None:
    for example in examples(document):
        if example.language == "python":
            lines = example.text.splitlines()
            indent = len(lines[0]) - len(lines[0].lstrip())  # in a list
            compile("\n".join(line[indent:] for line in lines), named(document), "exec")


@pytest.mark.parametrize(
    "document", [each for each in DOCUMENTS if any(name.endswith(".toml") for name in files(each))], ids=named
)
def test_fleet_files_can_be_simulated(document: Path, folder: Path) -> None:
    fleets = sorted(folder.glob("*.toml"))
    assert fleets
    for path in fleets:
        spec = load(path).spec
        assert spec.name == path.stem
        whole = bool(spec.faults.rule)  # faults act at their time
        assert simulate(path, changes=[] if whole else ["time.duration=1.0"]).complete


@pytest.mark.parametrize("document", [ROOT / "docs" / name for name in ("faults.md", "fleet-file.md")], ids=named)
def test_every_snippet_fits_into_a_fleet(document: Path, folder: Path) -> None:
    for number, example in enumerate(examples(document)):
        if example.language == "toml" and not example.mark:
            path = folder / f"snippet_{number}.toml"
            path.write_text(tomli_w.dumps(merged(tomllib.loads(WHOLE), tomllib.loads(example.text))), encoding="utf-8")
            load(path)


def merged(whole: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    """A table with those of another in it; lists are replaced."""
    for key, value in part.items():
        both = isinstance(value, dict) and isinstance(whole.get(key), dict)
        whole[key] = merged(whole[key], value) if both else value
    return whole


@pytest.mark.parametrize(
    "document", [each for each in DOCUMENTS if any(e.mark == "run" for e in examples(each))], ids=named
)
def test_programs_run(document: Path, folder: Path) -> None:
    for number, example in enumerate(each for each in examples(document) if each.mark == "run"):
        program = folder / f"program_{number}.py"
        program.write_text(example.text, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, str(program)],
            env={**os.environ, "MPLBACKEND": "Agg"},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, f"{example.text}\n{done.stderr}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_relative_link_leads_somewhere(document: Path) -> None:
    for target, anchor in LINK.findall(document.read_text(encoding="utf-8")):
        path = document.parent / target if target else document
        assert path.exists(), f"{target} is not there"
        if anchor:
            assert anchor in anchors(path), f"{target} has no heading #{anchor}"


def test_every_diagram_has_a_picture_of_its_present_text() -> None:
    wanted = {
        f"{path.stem}_{sha256(diagram.encode()).hexdigest()[:12]}.svg"
        for path in DOCUMENTS
        for diagram in DIAGRAM.findall(path.read_text(encoding="utf-8"))
    }
    assert wanted
    found = {path.name for path in ROOT.glob("docs/images/*.svg")}
    assert found == wanted, "run python docs/figures/diagrams.py"


def test_every_decision_is_in_the_index() -> None:
    folder = ROOT / "docs" / "decisions"
    listed = [target for target, _ in LINK.findall((folder / "README.md").read_text(encoding="utf-8"))]
    records = sorted(path.name for path in folder.glob("[0-9]*.md"))
    assert [target for target in listed if target[0].isdigit()] == records
    for number, name in enumerate(records, 1):
        assert name.startswith(f"{number:04}-")
        headings = re.findall(r"^## (.*)$", (folder / name).read_text(encoding="utf-8"), re.M)
        assert headings == ["Context", "Decision", "Consequences"], name
