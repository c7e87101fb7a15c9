"""One word for one thing: no two public classes of one name, and no words that a reader has to look up."""

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("agentd", "dcf_zenoh", "plants", "topologies")
UNUSUAL = re.compile(r"\b(whoever|whomever|shall|gravest|plight|farewell|mourn)\b")


def classes(root: Path) -> dict[str, list[str]]:
    """Public class name -> where it is defined."""
    found = defaultdict(list)
    for path in (each for package in PACKAGES for each in sorted((root / package).rglob("*.py"))):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(f"{path.relative_to(root)}:{node.lineno}")
    return found


def test_public_class_names_are_unique() -> None:
    found = classes(ROOT)
    assert len(found) > 150
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_class_name_that_is_taken_is_found(tmp_path: Path) -> None:
    (tmp_path / "plants").mkdir()
    for name in ("one", "two"):
        (tmp_path / "plants" / f"{name}.py").write_text("class Agent:\n    pass\n")
    assert classes(tmp_path) == {"Agent": ["plants/one.py:1", "plants/two.py:1"]}


def test_prose_is_free_of_unusual_words() -> None:
    sources = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    documents = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in sorted([*sources, *documents])
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if UNUSUAL.search(line)
    ]
    assert found == []
