import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.faults.profile import SCHEMA, LinkProfile, read_profile, write_profile

ONE = LinkProfile(1, 2, 1000, 3, 1.0, (0.001, 0.002, 0.004), 0.0001)
TWO = replace(ONE, sender=2, receiver=1, latency=(0.0, 0.5))
LINK = {
    "from": 1, "to": 2, "messages": 1000, "lost": 3, "mean_burst": 1.0, "latency": [0.001, 0.002, 0.004],
    "offset_error": 0.0001,
}  # fmt: skip

seconds = st.floats(0, 1e6)
profiles = st.builds(
    LinkProfile,
    sender=st.integers(0, 9),
    receiver=st.integers(0, 9),
    messages=st.integers(0, 10**9),
    lost=st.integers(0, 10**9),
    mean_burst=seconds,
    latency=st.lists(seconds, min_size=2, max_size=20).map(lambda values: tuple(sorted(values))),
    offset_error=seconds,
)


@given(st.lists(profiles, min_size=1, max_size=9, unique_by=lambda each: (each.sender, each.receiver)))
def test_what_is_read_is_what_was_written(tmp_path_factory: pytest.TempPathFactory, links: list[LinkProfile]) -> None:
    path = tmp_path_factory.mktemp("profile") / "links.json"
    write_profile(path, links)
    assert read_profile(path) == tuple(links)


def test_the_file_is_as_documented(tmp_path: Path) -> None:
    write_profile(tmp_path / "links.json", [ONE])
    assert json.loads((tmp_path / "links.json").read_text()) == {"schema": "dcf-zenoh link profile 1", "links": [LINK]}


def test_a_file_that_changed_is_read_again(tmp_path: Path) -> None:
    for links in [(ONE,), (ONE, TWO)]:
        write_profile(tmp_path / "links.json", links)
        assert read_profile(tmp_path / "links.json") == links


def refusal(path: Path) -> str:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole text is compared
        read_profile(path)
    return str(caught.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "links.json"
    assert refusal(path) == f"cannot read {path}: No such file or directory"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "it is empty"),
        (b"from,to\n", "it is not JSON: Expecting value: line 1 column 1 (char 0)"),
        (b"\xff\xfe\xfa", "it is not JSON: "),
        (b"[" * 100_000, "its JSON is nested too deeply"),
        (b"[1]", f"its schema must be '{SCHEMA}', not [1]"),
        (b'{"links": []}', f"its schema must be '{SCHEMA}', not 'missing'"),
        (b'{"schema": "dcf-zenoh link profile 2"}', f"its schema must be '{SCHEMA}', not 'dcf-zenoh link profile 2'"),
    ],
)
def test_a_file_that_is_no_profile_is_refused(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "links.json"
    path.write_bytes(content)
    line = refusal(path)
    assert line.startswith(f"{path} is not a link profile: {text}")
    assert "\n" not in line


@pytest.mark.parametrize(
    ("links", "text"),
    [
        ({}, "links must be a list, not {}"),
        ([], "links must not be empty"),
        ([LINK, LINK], "links must have one entry from 1 to 2, not 2"),
        (
            [LINK, {"from": 1}],
            "links[1] must have the keys from, to, messages, lost, mean_burst, latency, offset_error, and no others",
        ),
        ([LINK | {"from": True}], "links[0]: from must be a whole number of at least 0, not True"),
        ([LINK | {"to": -2}], "links[0]: to must be a whole number of at least 0, not -2"),
        ([LINK | {"lost": 1.5}], "links[0]: lost must be a whole number of at least 0, not 1.5"),
        ([LINK | {"mean_burst": -1}], "links[0]: mean_burst must be at least 0, not -1"),
        ([LINK | {"offset_error": "small"}], "links[0]: offset_error must be a number, not 'small'"),
        ([LINK | {"latency": 3}], "links[0]: latency must be a list of at least two quantiles, in s, not 3"),
        ([LINK | {"latency": [1]}], "links[0]: latency must be a list of at least two quantiles, in s, not (1,)"),
        ([LINK | {"latency": [0.0, "1"]}], "links[0]: latency[1] must be a number, not '1'"),
        ([LINK | {"latency": [0.0, float("nan")]}], "links[0]: latency[1] must be a number, not nan"),
        ([LINK | {"latency": [0, 10**400]}], f"links[0]: latency[1] must be a number, not {'1' + 39 * '0'}"),
        ([LINK | {"latency": [-0.1, 1.0]}], "links[0]: latency[0] must be at least 0, in s, not -0.1"),
        ([LINK | {"latency": [0.2, 0.1]}], "links[0]: latency must not descend, as it does from 0.2 to 0.1"),
    ],
)
def test_links_that_cannot_be_are_refused(tmp_path: Path, links: Any, text: str) -> None:
    path = tmp_path / "links.json"
    path.write_text(json.dumps({"schema": SCHEMA, "links": links}))
    assert refusal(path) == f"{path} is not a link profile: {text}"


def test_a_profile_of_nothing_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^links must not be empty$"):
        write_profile(tmp_path / "links.json", [])
    with pytest.raises(ValueError, match=r"^links must have one entry from 1 to 2, not 2$"):
        write_profile(tmp_path / "links.json", [ONE, ONE])
    assert not (tmp_path / "links.json").exists()
