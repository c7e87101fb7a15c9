"""How long tests take, by the JUnit files that ``make quick`` and ``make test`` leave in ``build/durations``.

    python -m tests.support.durations build/durations/*.xml

writes ``tests/durations.json``, from which `tests/conftest.py` knows the long tests, and the table of files in
``docs/testing.md``.
"""

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]
RECORD = ROOT / "tests" / "durations.json"
PAGE = ROOT / "docs" / "testing.md"
BEGIN, END = "<!-- durations -->", "<!-- end of durations -->"
LONG = 0.4  # s, of one test; longer ones are not in make quick
UNTRACED = 0.15  # s; longer ones run the same lines often, and are not traced for the coverage
RECORDED = 0.1  # s; what takes less is not written down
IN_TABLE = 4.0  # s, of a file


class Case(NamedTuple):
    """One test that has been run.

    Attributes:
        key: File and function, as of `key`.
        seconds: Duration with set-up and tear-down.
    """

    key: str
    seconds: float


def key(nodeid: str) -> str:
    """Return file and function of a test, without its parameters."""
    return nodeid.partition("[")[0]


def recorded() -> Mapping[str, float]:
    """Return the duration of the longest test of each function, s; short ones are missing."""
    found: dict[str, float] = json.loads(RECORD.read_text(encoding="utf-8"))
    return found


def read(path: Path) -> list[Case]:
    """Read a JUnit file of pytest."""
    return [
        Case(key(f"{case.attrib['classname'].replace('.', '/')}.py::{case.attrib['name']}"), float(case.attrib["time"]))
        for case in ElementTree.parse(path).iter("testcase")
    ]


def longest(cases: Iterable[Case]) -> dict[str, float]:
    """Return what `recorded` returns, of these cases."""
    found: dict[str, float] = {}
    for case in cases:
        if case.seconds >= RECORDED:
            found[case.key] = max(found.get(case.key, 0.0), round(case.seconds, 2))
    return dict(sorted(found.items()))


def table(parts: Mapping[str, Iterable[Case]]) -> str:
    """Return a table in Markdown: a row for each file of each part, the longest first, and the sums."""
    rows = ["| part | file | tests | seconds |", "| --- | --- | ---: | ---: |"]
    for part, cases in parts.items():
        files: dict[str, list[float]] = {}
        for case in cases:
            files.setdefault(case.key.partition("::")[0], []).append(case.seconds)
        ranked = sorted(files.items(), key=lambda item: -sum(item[1]))
        rows += [
            f"| {part} | `{file}` | {len(seconds)} | {sum(seconds):.0f} |"
            for file, seconds in ranked
            if sum(seconds) >= IN_TABLE
        ]
        rest = [seconds for file, seconds in ranked if sum(seconds) < IN_TABLE]
        every = [each for seconds in files.values() for each in seconds]
        rows.append(f"| {part} | {len(rest)} others | {sum(map(len, rest))} | {sum(map(sum, rest)):.0f} |")
        rows.append(f"| **{part}** | **all** | **{len(every)}** | **{sum(every):.0f}** |")
    return "\n".join(rows)


def main(paths: Iterable[Path]) -> None:
    """Write the record and the table."""
    parts = {path.stem: read(path) for path in sorted(paths)}
    cases = [case for each in parts.values() for case in each]
    RECORD.write_text(json.dumps(longest(cases), indent=0) + "\n", encoding="utf-8")
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(f"{before}{BEGIN}\n\n{table(parts)}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main(map(Path, sys.argv[1:]))
