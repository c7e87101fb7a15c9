import io
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agentd.daemon.operator_protocol import (
    HALT,
    Answer,
    AppliedChange,
    Change,
    Clear,
    Control,
    Halt,
    Land,
    OperatorRequest,
    Show,
    changes_in,
    decode_answer,
    decode_request,
    encode,
)
from dcf_zenoh.config import load
from dcf_zenoh.errors import MessageError
from dcf_zenoh.faults.chain import FaultChain
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import Recorder
from dcf_zenoh.spec import FaultTable, Table
from tests.support.deliveries import MS, S, convey, delivery
from tests.support.lossy_fleets import lossy

LOSS = FaultTable.model_validate({"kind": "loss", "probability": 1.0})
SET = {"do": "set", "senders": [1], "name": "loss", "fault": {"kind": "loss", "probability": 1.0}}


class Daemon:
    """Agent 2 of a ring of four, as its operators see it."""

    def __init__(self, folder: Path, faults: str = "", **changes: Any) -> None:
        self.fleet = load(lossy(folder, faults), changes=[f"{key}={value}" for key, value in changes.items()])
        self.links: dict[int, FaultChain] = {}
        self.stream = io.BytesIO()
        self.ends: list[str] = []
        recorder = Recorder(self.stream, 2, {})
        self.control = Control(2, self.fleet, (1, 3), self.links, recorder, self.ends.append)

    def ask(self, request: Any, now: int = 0) -> Answer:
        data = encode(request) if isinstance(request, Table) else msgpack.packb(request)
        return decode_answer(self.control.handle(data, now), 2)

    @property
    def log(self) -> AgentLog:
        return AgentLog.read(self.stream.getvalue(), "log")

    def lost(self, sender: int, instant: int) -> bool:
        return not self.links[sender].convey(delivery(sender=sender, entered=instant)).deliveries


@pytest.fixture
def daemon(tmp_path: Path) -> Daemon:
    return Daemon(tmp_path)


@pytest.mark.parametrize(
    "request_",
    [
        Change(senders=(1, 2), name="loss", fault=LOSS),
        Change(senders=(0,), name="loss", fault=False),
        Clear(senders=(3,)),
        Show(),
        Land(),
        Halt(),
    ],
)
def test_decoding_a_request_is_the_inverse_of_encoding(request_: OperatorRequest) -> None:
    assert decode_request(encode(request_)) == request_


def test_decoding_an_answer_is_the_inverse_of_encoding() -> None:
    done = (
        AppliedChange(time=5, change=Change(senders=(1,), name="loss", fault=LOSS)),
        AppliedChange(time=7, change=Clear(senders=(1,))),
    )
    answer = Answer(agent=2, time=9, senders=(1,), changes=done)
    assert decode_answer(encode(answer), 2) == answer


def test_empty_answer_means_that_no_requests_are_taken() -> None:
    assert decode_answer(b"", 3) == Answer(
        agent=3, error="takes no orders now: it has not started yet, or its run is over"
    )


MALFORMED = {
    "not msgpack": b"\xc1",
    "nothing": b"",
    "more than one": msgpack.packb(SET) * 2,
    "half of one": msgpack.packb(SET)[:-3],
    "not a map": msgpack.packb([1]),
    "unknown order": msgpack.packb({"do": "dance"}),
    "no order": msgpack.packb({"senders": [1]}),
    "number in a string": msgpack.packb({**SET, "senders": ["1"]}),
    "nobody": msgpack.packb({**SET, "senders": []}),
    "negative id": msgpack.packb({**SET, "senders": [-1]}),
    "key too many": msgpack.packb({**SET, "until": 3}),
    "key missing": msgpack.packb({key: SET[key] for key in ("do", "senders", "name")}),
    "no kind": msgpack.packb({**SET, "fault": {"probability": 1.0}}),
    "true": msgpack.packb({**SET, "fault": True}),
    "bytes": msgpack.packb({**SET, "fault": {"kind": "loss", "probability": b"\x80\x04."}}),
    "no number": msgpack.packb({**SET, "fault": {"kind": "loss", "probability": float("nan")}}),
    "too long": msgpack.packb({**SET, "fault": {"kind": "loss", "probability": "x" * 70_000}}),
    "too deep": b"\x81\xa2do" + b"\x91" * 5000 + b"\x01",
}


@pytest.mark.parametrize("data", MALFORMED.values(), ids=MALFORMED.keys())
def test_malformed_request_gets_an_error_and_changes_nothing(data: bytes, daemon: Daemon) -> None:
    with pytest.raises(MessageError, match=r"^not a request: "):
        decode_request(data)
    before = daemon.stream.getvalue()
    answer = decode_answer(daemon.control.handle(data, 3), 2)
    assert answer.error.startswith("not a request: ")
    assert (answer.senders, daemon.links, daemon.stream.getvalue()) == ((), {}, before)


def test_no_number_of_changes_fills_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agentd.daemon.operator_protocol.CHANGES_MAX", 3)
    daemon = Daemon(tmp_path)
    assert [daemon.ask(SET).error for _ in range(5)] == [
        *[""] * 3,
        *["agent 2 has changed its faults 3 times, and no more"] * 2,
    ]
    assert daemon.ask(Land()).error == ""


@given(st.binary(max_size=60))
def test_bytes_are_a_request_or_a_message_error(data: bytes) -> None:
    with suppress(MessageError):
        assert isinstance(decode_request(data), Change | Clear | Show)


def test_operators_end_the_flight_and_get_an_answer(daemon: Daemon) -> None:
    assert daemon.ask(Land(), 4 * S) == Answer(agent=2, time=4 * S)
    assert daemon.ends == ["landed by an operator"]
    assert decode_answer(daemon.control.handle(HALT, 5 * S), 2) == Answer(agent=2, time=5 * S)
    assert daemon.ends[1:] == ["emergency stop by an operator"]


def test_change_acts_on_the_links_named_from_now_on(daemon: Daemon) -> None:
    answer = daemon.ask(SET, 5 * S)
    assert (answer.agent, answer.time, answer.error, answer.senders) == (2, 5 * S, "", (1,))
    assert daemon.links.keys() == {1}
    assert [daemon.lost(1, instant) for instant in (5 * S - 1, 5 * S, 99 * S)] == [False, True, True]


def test_faults_of_the_fleet_file_stay(daemon: Daemon) -> None:
    link = daemon.links[1] = FaultChain(0, 1, 2)
    link.add("partition", (0, inf), None)
    daemon.ask(SET)
    assert daemon.links[1] is link
    assert daemon.lost(1, 0)


def test_clear_ends_the_changes_of_the_named_links_alone(daemon: Daemon) -> None:
    daemon.ask({**SET, "senders": [1, 3]}, 1 * S)
    assert daemon.ask(Clear(senders=(3,)), 2 * S).senders == (3,)
    assert [daemon.lost(j, 3 * S) for j in (1, 3)] == [True, False]
    assert daemon.lost(3, 2 * S - 1)
    assert daemon.ask(Clear(senders=(1, 3)), 4 * S).error == ""
    assert [daemon.lost(j, 4 * S) for j in (1, 3)] == [False, False]


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ({**SET, "senders": [1, 4]}, "agent 2 does not hear 4; it hears 1, 3"),
        ({"do": "clear", "senders": [2]}, "agent 2 does not hear 2; it hears 1, 3"),
        ({**SET, "fault": {"kind": "loss", "probability": 2.0}}, "must be a probability, from 0 to 1, not 2.0"),
        ({**SET, "fault": {"kind": "loss", "chance": 0.1}}, "Loss has no key 'chance'"),
        (
            {**SET, "fault": {"kind": "los"}},
            "loss.kind: expected a kind that is installed or that the fleet file names",
        ),
        ({**SET, "fault": {"kind": "subprocess:Popen"}}, "a fleet loads no other code while it runs"),
        ({**SET, "fault": {"kind": "./mine.py:Dull"}}, "not './mine.py:Dull'"),
        ({**SET, "fault": {"kind": "range", "distance": 1.0}}, "loss: needs the positions of the agents"),
    ],
)
def test_impossible_request_is_refused_as_a_whole(request_: dict[str, Any], said: str, daemon: Daemon) -> None:
    before = daemon.stream.getvalue()
    assert said in daemon.ask(request_).error
    assert (daemon.links, daemon.stream.getvalue()) == ({}, before)
    assert daemon.ask(Show()).changes == ()


def test_kind_of_the_fleet_file_can_be_used(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, "[[faults.rule]]\nto = 3\ndull = { kind = './mine.py:Dull', often = 2 }")
    assert daemon.ask({**SET, "name": "dull", "fault": {"kind": "./mine.py:Dull", "often": 3}}).error == ""
    assert "often must be at least" not in daemon.ask({**SET, "fault": {"kind": "./mine.py:Dull"}}).error


def test_loss_needs_a_time_out_of_rounds(tmp_path: Path) -> None:
    text = lossy(tmp_path, "").read_text().replace("round_timeout = 0.003\n", "")
    daemon = Daemon(tmp_path)
    (tmp_path / "lossy.toml").write_text(text)
    fleet = load(tmp_path / "lossy.toml")
    daemon.control = Control(2, fleet, (1, 3), daemon.links, Recorder(io.BytesIO(), 2, {}), daemon.ends.append)
    assert daemon.ask(SET).error.startswith("exchange.round_timeout: missing; loss can lose messages, and a round ")
    assert daemon.ask({**SET, "name": "latency", "fault": {"kind": "latency", "mean": 0.1}}).error == ""


def test_log_has_all_changes_and_they_can_be_applied_again(daemon: Daemon, tmp_path: Path) -> None:
    daemon.ask({**SET, "senders": [1, 3]}, 1 * S)
    daemon.ask({**SET, "name": "latency", "fault": {"kind": "latency", "mean": 0.5}}, 2 * S)
    daemon.ask({**SET, "fault": False}, 3 * S)
    daemon.ask(Clear(senders=(3,)), 4 * S)
    daemon.ask({**SET, "senders": [9]}, 5 * S)
    done = changes_in(daemon.log)
    assert [(each.time // S, each.change.do, each.change.senders) for each in done] == [
        (1, "set", (1, 3)),
        (2, "set", (1,)),
        (3, "set", (1,)),
        (4, "clear", (3,)),
    ]
    assert daemon.ask(Show(), 6 * S).changes == done
    again = Daemon(tmp_path)
    again.control.restore(done)
    assert changes_in(again.log) == ()  # the log has them already
    assert again.ask(Show()).changes == done
    for sender in (1, 3):
        ours, theirs = (convey(each.links[sender], 7, S) for each in (daemon, again))
        assert ours == theirs
    assert [len(each.deliveries) for each in convey(again.links[1], 7, S)] == [1, 0, 0, 1, 1, 1, 1]


def test_faults_of_a_link_draw_as_those_of_a_fleet_file(daemon: Daemon) -> None:
    daemon.ask({**SET, "fault": {"kind": "loss", "probability": 0.5}})
    same = FaultChain(daemon.fleet.spec.seed, 1, 2)
    same.add("loss", (-inf, inf), daemon.links[1]._layers["loss"].entries[0][1])
    outcome = convey(daemon.links[1], 50, MS)
    assert outcome == convey(same, 50, MS)
    assert {len(each.deliveries) for each in outcome} == {0, 1}
