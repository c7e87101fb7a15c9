"""The record of durations: what is long, and the table of files."""

from pathlib import Path

from tests.support.durations import Case, key, longest, read, recorded, table

JUNIT = """<testsuites><testsuite>
<testcase classname="tests.plants.test_wind" name="test_gusts[a::b]" time="1.26"/>
<testcase classname="tests.plants.test_wind" name="test_gusts[c]" time="3.0"/>
<testcase classname="tests.test_names" name="test_words" time="0.05"/>
</testsuite></testsuites>
"""


def test_the_longest_of_each_function_is_recorded(tmp_path: Path) -> None:
    (tmp_path / "1-short.xml").write_text(JUNIT)
    cases = read(tmp_path / "1-short.xml")
    assert cases[0] == Case("tests/plants/test_wind.py::test_gusts", 1.26)
    assert longest(cases) == {"tests/plants/test_wind.py::test_gusts": 3.0}
    assert key("tests/plants/test_wind.py::test_gusts[a]") in longest(cases)
    assert table({"1-short": cases}).splitlines()[2:] == [
        "| 1-short | `tests/plants/test_wind.py` | 2 | 4 |",
        "| 1-short | 1 others | 1 | 0 |",
        "| **1-short** | **all** | **3** | **4** |",
    ]


def test_long_tests_are_on_record() -> None:
    assert max(recorded().values()) > 5.0
