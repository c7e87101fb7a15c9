import msgpack
import pytest

from dcf_zenoh.errors import MessageError, NetworkError
from dcf_zenoh.messaging.handshake import ClockOffset, Handshake, Hello

MS = 1_000_000


def exchange(a: Handshake, b: Handshake, *, ahead: int = 0, there: int = MS, back: int = MS) -> tuple[Hello, Hello]:
    """Agent 1 says hello, agent 2 answers; 2's clock is `ahead` of 1's, the trips take `there` and `back` ns."""
    sent, stay = 100 * MS, 5 * MS
    question = Hello.read(a.hello(2, sent), 1, sent + there + ahead)
    b.receive(question)
    answer = Hello.read(b.hello(1, sent + there + stay + ahead), 2, sent + there + stay + back)
    return question, answer


def test_handshake_is_complete_when_the_neighbour_has_answered() -> None:
    a, b = Handshake(1, [2], "f"), Handshake(2, [1], "f")
    first, answer = exchange(a, b)
    assert first.echo == 0
    assert not b.complete  # it has not received an answer yet
    assert a.receive(answer)
    assert a.complete
    assert not b.receive(Hello.read(a.hello(2, 109 * MS), 1, 110 * MS))  # not its first
    assert b.complete


@pytest.mark.parametrize(("there", "back"), [(MS, MS), (3 * MS, MS)])
def test_clock_offset_is_found_within_its_stated_error(there: int, back: int) -> None:
    a, b = Handshake(1, [2], "f"), Handshake(2, [1], "f")
    shift = 50 * MS
    a.receive(exchange(a, b, ahead=shift, there=there, back=back)[1])
    offset = a.offsets[2]
    assert abs(offset.ahead - shift) <= offset.error == (there + back) // 2


def test_most_certain_offset_is_kept() -> None:
    a = Handshake(1, [2], "f")
    for error in (5, 1, 9):
        a.receive(Hello(2, "f", 10, 10, 10, 10 + 2 * error))
    assert a.offsets[2] == ClockOffset(-1, 1)


def test_neighbour_that_left_has_to_answer_again() -> None:
    a = Handshake(1, [2, 3], "f")
    a.receive(Hello(2, "f", 1, 1, 1, 1))
    assert a.status == "nothing heard of agent 3"
    a.forget(2)
    assert a.status == "nothing heard of agents 2, 3"
    a.receive(Hello(2, "f", 1, 0, 0, 1))
    assert a.status == "nothing heard of agent 3, no answer from agent 2"


def test_another_fleet_is_refused() -> None:
    with pytest.raises(NetworkError, match=r"agent 2 runs another fleet file.*fingerprint g, expected f"):
        Handshake(1, [2], "f").receive(Hello(2, "g", 1, 0, 0, 1))


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\xc1", "not a hello"),
        (b"", "not a hello"),
        (msgpack.packb([2, "f"]), "not a hello: "),
        (msgpack.packb([2, "f", 1.5, 0, 0, 0, 0]), "not a hello: "),
        (msgpack.packb([3, "f", 1, 0, 0, 0, 0]), "it claims to come from agent 3"),
    ],
)
def test_bytes_that_are_no_hello_are_refused(data: bytes, text: str) -> None:
    with pytest.raises(MessageError, match=text):
        Hello.read(data, 2, 0)
