from collections.abc import Iterator
from itertools import count

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


PERIOD, TRIP = 20 * MS, 6 * MS  # ns: between two hellos of an agent that has not been confirmed, and on the way


def converse(lost: Iterator[bool]) -> tuple[dict[int, Handshake], int]:
    """Lead agents 1 and 2 through a handshake while hellos get lost; return both, and how many hellos they sent.

    An agent repeats its hello until it is confirmed or, once complete, for ten periods; then it only answers.
    """
    sides = {1: Handshake(1, [2], "f"), 2: Handshake(2, [1], "f")}
    repeats: dict[int, int] = {1: 10, 2: 10}
    on_the_way: list[tuple[int, int, bytes]] = []
    sent = 0

    def send(agent: int, now: int) -> None:
        nonlocal sent
        sent += 1
        data = sides[agent].hello(3 - agent, now)
        if not next(lost):
            on_the_way.append((now + TRIP, 3 - agent, data))

    for now in range(1000 * MS, 1500 * MS, MS):  # instants of a clock are never 0
        for agent, side in sides.items():
            start = (1000 + (agent - 1) * 7) * MS  # agent 2 begins later
            if now >= start and (now - start) % PERIOD == 0 and repeats[agent] and not side.confirmed:
                repeats[agent] -= side.complete
                send(agent, now)
        for delivery in [each for each in on_the_way if each[0] == now]:
            on_the_way.remove(delivery)
            _, agent, data = delivery
            confirmed = sides[agent].confirmed
            if sides[agent].receive(Hello.read(data, 3 - agent, now)) or sides[agent].confirmed > confirmed:
                send(agent, now)
    assert not on_the_way  # nobody answers answers for ever
    return sides, sent


@pytest.mark.parametrize("length", [0, 1, 4, 8])
def test_handshake_completes_on_both_sides_whichever_hellos_are_lost(length: int) -> None:
    for pattern in range(2**length):
        lost = iter((pattern >> k) & 1 for k in range(length))
        sides, sent = converse(bool(next(lost, 0)) for _ in count())
        assert sides[1].complete, f"{pattern:b}"
        assert sides[2].complete, f"{pattern:b}"
        assert sent <= 30, f"{pattern:b}"


@pytest.mark.parametrize("deaf", [1, 2])
def test_side_that_receives_everything_does_not_end_the_handshake_of_the_other(deaf: int) -> None:
    """All but the first hello to one side are lost, for longer than the other side repeats its own."""
    a, b = Handshake(deaf, [9], "f"), Handshake(9, [deaf], "f")
    a.receive(Hello.read(b.hello(deaf, 1 * MS), 9, 2 * MS))
    for now in range(20 * MS, 1020 * MS, PERIOD):
        hello = Hello.read(a.hello(9, now), deaf, now + TRIP)
        assert hello.echo
        assert b.receive(hello)  # it is to be answered, though it is an answer itself
        b.hello(deaf, now + TRIP)
        assert b.complete
        assert not a.complete
        assert not b.confirmed
    a.receive(Hello.read(b.hello(deaf, 1030 * MS), 9, 1040 * MS))
    assert a.complete
    assert not b.receive(Hello.read(a.hello(9, 1040 * MS), deaf, 1050 * MS))
    assert b.confirmed


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
        (msgpack.packb([2, "f", 2**63, 0, 0, 0, 0]), "not a hello: sent 9223372036854775808, expected 0 .. 4.6"),
        (msgpack.packb([2, "f", 0, 0, 0, 2**30, 0]), "not a hello: incarnation 1073741824, expected 0 .. 1.0"),
        (msgpack.packb([2, "f" * 200, 0, 0, 0, 0, 0]), "not a hello: fingerprint 'fff"),
        (msgpack.packb([2, "f" * 600, 0, 0, 0, 0, 0]), "not a hello: 6"),
        (msgpack.packb([2, "f", 0, 0, 0, 0, 2**61]), "not a hello: the fleet would have started -2.67e"),
        (msgpack.packb([3, "f", 1, 0, 0, 0, 0]), "it claims to come from agent 3"),
    ],
)
def test_bytes_that_are_no_hello_are_refused(data: bytes, text: str) -> None:
    with pytest.raises(MessageError, match=text):
        Hello.read(data, 2, 0)
