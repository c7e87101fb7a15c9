"""What is read of a log that is damaged, cut off or somebody else's."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dcf_zenoh
from dcf_zenoh.analysis.link_health import link_health
from dcf_zenoh.config import load
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import StepRecord, length_of_complete, log_name, packed, read_stream
from dcf_zenoh.records.run import Run
from dcf_zenoh.spec import FleetSpec
from tests.support.faulty_runs import named

STEPS = 10
FIELDS = StepRecord._fields


@pytest.fixture(scope="module")
def lossy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory: ten steps with losses, and a log of rounds."""
    folder = tmp_path_factory.mktemp("lossy")
    named(folder, "[faults]\nloss = 0.2\n", "log.rounds=true", "exchange.max_rounds=6", out=folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def data(lossy: Path) -> bytes:
    """The log of agent 2."""
    return (lossy / log_name(2)).read_bytes()


@pytest.fixture(scope="module")
def fleet(lossy: Path) -> FleetSpec:
    """Its fleet."""
    return load(lossy / "fleet.toml", run_plugins=False).spec


def repacked(items: list[Any]) -> bytes:
    return b"".join(map(packed, items))


def items_of(data: bytes) -> list[Any]:
    return [item for item, _ in read_stream(data)]


def with_step(data: bytes, row: int, **values: object) -> bytes:
    """The log with some fields of one step replaced."""
    items = items_of(data)
    for name, value in values.items():
        items[row + 1][FIELDS.index(name)] = value
    return repacked(items)


def told(data: bytes, fleet: FleetSpec) -> AgentLog | RecordingError:
    """What reading comes to."""
    try:
        return AgentLog.read(data, "a log", (2, fleet))
    except RecordingError as error:
        return error


@settings(max_examples=400, derandomize=True, deadline=None)
@given(st.data())
def test_whatever_bytes_are_flipped_there_is_a_log_or_an_error(
    data: bytes, fleet: FleetSpec, draw: st.DataObject
) -> None:
    bad = bytearray(data)
    for at in draw.draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=3)):
        bad[at] ^= draw.draw(st.integers(1, 255))
    found = told(bytes(bad), fleet)
    if isinstance(found, RecordingError):
        lines = str(found).splitlines()
    else:
        assert found.step.tolist() == list(range(len(found.step)))
        assert {len(found.rounds), len(found.state), len(found.rounds_log)} == {len(found.step)}
        assert len(found.step) == STEPS or found.end is None
        assert not (found.damage and found.end)
        lines = found.damage.splitlines() or ["a log: "]
    assert len(lines) == 1
    assert lines[0].startswith("a log: ")


def test_no_changed_byte_alters_what_is_read_without_a_word(data: bytes, fleet: FleetSpec) -> None:
    """Without checksums 83 of 1,060 changes did."""
    dice = Random(1)
    for _ in range(1060):
        bad = bytearray(data)
        bad[dice.randrange(len(data))] ^= dice.randrange(1, 256)
        log = told(bytes(bad), fleet)
        if not isinstance(log, RecordingError):
            assert log.end is None  # at least it breaks off
        readable: list[Any] = []
        with suppress(ValueError):
            for item, _ in read_stream(bytes(bad)):
                readable.append(item)
        assert data.startswith(repacked(readable))


def test_log_of_schema_3_has_no_checksums_and_is_read(data: bytes) -> None:
    header, *others = items_of(data)
    old = b"".join(map(msgpack.packb, [{**header, "schema": 3}, *others]))
    now, before = AgentLog.read(data, "a log"), AgentLog.read(old, "a log")
    assert (before.damage, before.end, before.lives) == ("", now.end, 1)
    assert np.array_equal(before.state, now.state)
    assert length_of_complete(old) == len(old)


def test_life_of_this_version_goes_on_in_a_log_of_schema_3(data: bytes) -> None:
    header, *others = items_of(data)
    old = b"".join(map(msgpack.packb, [{**header, "schema": 3}, *others[:3]]))
    both = old + repacked([header, *others[3:]])
    log = AgentLog.read(both, "a log")
    assert (log.damage, log.lives, log.end) == ("", 2, AgentLog.read(data, "a log").end)
    assert np.array_equal(log.state, AgentLog.read(data, "a log").state)
    assert length_of_complete(both) == len(both)
    bad = bytearray(both)
    bad[-20] ^= 1
    assert AgentLog.read(bytes(bad), "a log").end is None


def test_end_of_an_earlier_life_is_not_that_of_one_that_was_killed(data: bytes) -> None:
    header, *steps, end = items_of(data)
    lives = [header, *steps[:3], end, {**header, "incarnation": 1}, *steps[5:7]]
    assert AgentLog.read(repacked(lives[:5]), "a log").end is not None
    log = AgentLog.read(repacked(lives), "a log")
    assert (log.lives, len(log.step), log.end, log.damage) == (2, 5, None, "")
    assert log.earlier == ((2, end),)
    assert log.counts == end["counts"]


@settings(max_examples=100, derandomize=True, deadline=None)
@given(st.binary(max_size=400))
def test_random_bytes_are_no_log(random: bytes) -> None:
    with pytest.raises(RecordingError, match=r"^a log: not a log of an agent: .*header"):
        AgentLog.read(random, "a log")


@settings(max_examples=50, derandomize=True, deadline=None)
@given(st.data())
def test_random_bytes_after_some_steps_cost_no_step_before_them(data: bytes, draw: st.DataObject) -> None:
    ends = [end for _, end in read_stream(data)]
    row = draw.draw(st.integers(1, STEPS - 1))
    tail = draw.draw(st.binary(max_size=200).map(lambda some: b"\xc1" + some))  # c1 begins no object
    log = AgentLog.read(data[: ends[row]] + tail, "a log")
    assert len(log.step) == row
    assert log.damage.startswith(f"a log: damaged after step {row - 1} (byte {ends[row]} of {ends[row] + len(tail)}): ")


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "a list where a number was": ({"rounds": [3]}, "rounds: Input should be a valid integer"),
    "a number that is too large": ({"compute": 2**63}, "compute: Input should be less than 9223372036854775808"),
    "a half message": ({"passed": [[1, 2, 3]]}, "passed.0.3: Field required"),
    "an unknown end": ({"stopped_by": "agreeb"}, "stopped_by: Input should be 'agreed', 'rounds', 'budget', "),
    "a link without counts": ({"links": [[1]]}, "links.0.1: Field required"),
    "a round that is none": ({"log": [[{}, 0.0, {}]]}, "log.0.3: Field required"),
    "a stranger": ({"links": [[9, 1, 0, 0, 0]], "passed": []}, "links: there is no agent 9"),
    "a message of nobody": ({"links": []}, "passed: a message of nobody that is heard"),
    "a message before it was sent": ({"passed": [[1, 0, 0, 0, 5, 4, ""]]}, "passed: a message of nobody"),
    "a message of another time": ({"passed": [[1, 0, 99, 0, 4, 4, ""]]}, "step 99 of 10"),
    "another step": ({"step": 7}, "step 7 instead of 4"),
    "a step that was": ({"step": 3}, "step 3 instead of 4"),
    "acting first": ({"sensed": 1000, "acted": 999}, "acted before sensing"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_step_that_is_none_ends_the_reading_and_is_named(case: str, data: bytes, fleet: FleetSpec) -> None:
    values, said = WRONG[case]
    log = AgentLog.read(with_step(data, 4, **values), "a log", (2, fleet))
    assert log.step.tolist() == [0, 1, 2, 3]
    assert log.end is None
    assert log.damage.startswith("a log: damaged after step 3 (byte ")
    assert f"): {said}" in log.damage


@pytest.mark.parametrize(
    "item",
    [7, None, {}, {"end": "done"}, {"event": "alarm", "time": 3}, {"event": "crashed"}, {"schema": 3, "agent": "two"}],
)
def test_an_object_that_is_none_of_a_log_ends_the_reading(item: object, data: bytes) -> None:
    items = items_of(data)
    log = AgentLog.read(repacked([*items[:3], item, *items[3:]]), "a log")
    assert (len(log.step), log.events, log.end) == (2, (), None)
    assert log.damage.startswith("a log: damaged after step 1 ")


def test_a_length_that_nothing_can_have_takes_no_memory(data: bytes) -> None:
    ends = [end for _, end in read_stream(data)]
    log = AgentLog.read(data[: ends[2]] + b"\xdd\xff\xff\xff\xff" + data[ends[2] :], "a log")
    assert (len(log.step), bool(log.damage)) == (2, True)


def test_a_log_that_is_whole_or_cut_off_is_not_damaged(data: bytes) -> None:
    ends = [end for _, end in read_stream(data)]
    assert AgentLog.read(data, "a log").damage == ""
    cut = AgentLog.read(data[: ends[5] - 3], "a log")
    assert (len(cut.step), cut.end, cut.damage) == (4, None, "")


def test_zeros_after_a_loss_of_power_are_an_end_and_can_be_written_over(data: bytes) -> None:
    ends = [end for _, end in read_stream(data)]
    cut = data[: ends[5]] + bytes(4096)
    log = AgentLog.read(cut, "a log")
    assert (len(log.step), log.end, log.damage) == (5, None, "")
    assert length_of_complete(cut) == ends[5]


def test_a_second_life_is_read_and_that_of_another_agent_is_damage(data: bytes) -> None:
    header, *steps, end = items_of(data)
    lives = [header, *steps[:3], {**header, "incarnation": 1}, *steps[6:], end]
    log = AgentLog.read(repacked(lives), "a log")
    assert (log.lives, log.step.tolist(), log.damage) == (2, [0, 1, 2, 6, 7, 8, 9], "")
    assert log.earlier == ((2, None),)
    lives[4] = {**header, "agent": 3}
    log = AgentLog.read(repacked(lives), "a log")
    assert (log.lives, len(log.step), log.end) == (1, 3, None)
    assert (
        "a header of agent 3, fleet 'position_swap', seed 1 in the log of agent 2, fleet 'position_swap', seed 1"
        in log.damage
    )


@pytest.mark.parametrize(("name", "value"), [("agent", 1), ("fleet", "other"), ("seed", 7)])
def test_a_log_of_another_owner_is_refused(name: str, value: object, data: bytes, fleet: FleetSpec) -> None:
    header, *others = items_of(data)
    with pytest.raises(RecordingError) as refused:
        AgentLog.read(repacked([{**header, name: value}, *others]), "a log", (2, fleet))
    own = {"agent": 2, "fleet": fleet.name, "seed": fleet.seed}
    says, expected = (", ".join(f"{k} {v!r}" for k, v in each.items()) for each in ({**own, name: value}, own))
    assert str(refused.value) == f"a log: the log of {says}; expected {expected}"


def test_a_header_that_is_damaged_is_an_error(data: bytes) -> None:
    header, *others = items_of(data)
    for bad, said in (
        ({**header, "agent": [2]}, "not a log of an agent: its header cannot be read: agent: Input should be a valid"),
        ({**header, "schema": 99}, "log schema 99; this version reads 3 and 4"),
        ([], "not a log of an agent: it has no header"),
    ):
        with pytest.raises(RecordingError, match=f"^a log: {said}"):
            AgentLog.read(repacked([bad, *others]), "a log")


def test_a_number_that_jumps_is_no_loss_of_the_network(lossy: Path) -> None:
    run = dcf_zenoh.Run.read(lossy)
    log = run.agents[2]
    jumped = log.passed[-1]._replace(sequence=2**22)
    wall = run.fleet.model_copy(update={"time": run.fleet.time.model_copy(update={"clock": "wall"})})
    agents = {2: replace(log, passed=(*log.passed[:-1], jumped))}
    health = link_health(Run("run", wall, agents))
    assert sum(each.lost.get("the network", 0) for each in health) == 0
