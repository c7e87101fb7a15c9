import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.controllers.padding import unstacked
from dcf_zenoh.controllers.piggyback import TABLES_ONLY, Piggyback, PiggybackTable
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.message import canonical


def table(*rows: tuple[int, int, float]) -> PiggybackTable:
    made = PiggybackTable("t")
    for agent, step, value in rows:
        made.put((agent,), step, np.array([value]))
    return made


def values(of: PiggybackTable) -> dict[int, tuple[int, float]]:
    return {agent: (entry.step, float(entry.value[0])) for (agent,), entry in of.rows.items()}


def test_the_newest_value_of_each_key_wins() -> None:
    here = table((1, 5, 0.1), (2, 4, 0.2), (3, 4, 0.3))
    here.merge(table((2, 5, 0.9), (3, 3, 0.9), (4, 0, 0.4)).payload)
    assert values(here) == {1: (5, 0.1), 2: (5, 0.9), 3: (4, 0.3), 4: (0, 0.4)}


def test_of_two_values_of_one_step_the_first_stays() -> None:
    here = table((1, 5, 0.1))
    here.merge(table((1, 5, 0.9)).payload)
    assert values(here) == {1: (5, 0.1)}


def test_a_table_survives_a_payload_and_an_empty_one_adds_nothing() -> None:
    here, there = table((2, 7, 0.5), (1, 6, -0.5)), PiggybackTable("t")
    assert there.payload == {}
    there.merge({})
    there.merge(canonical(here.payload))
    assert values(there) == values(here)
    np.testing.assert_array_equal(there.payload["riding.t.index"], [[1, 6], [2, 7]])


def test_values_of_different_length_share_a_table() -> None:
    here, there = PiggybackTable("t"), PiggybackTable("t")
    here.put((1,), 0, np.array([1.0, 2.0]))
    here.put((2,), 0, np.array([1.0, 2.0, 3.0]))
    there.merge(canonical(here.payload))
    there.put((3,), 0, np.array([1.0]))
    here.merge(canonical(there.payload))
    rows = {key: unstacked(entry.value).tolist() for key, entry in here.rows.items()}
    assert rows == {(1,): [1.0, 2.0], (2,): [1.0, 2.0, 3.0], (3,): [1.0]}


def record(yielded: object, inboxes: list[Inbox]) -> Dialogue[str]:
    while True:
        inbox = yield yielded, 0.5  # type: ignore[misc]
        inboxes.append(inbox)
        if inbox.stop:
            return "result"


@pytest.mark.parametrize("edges", [False, True])
def test_the_dialogue_is_unaware_of_the_tables(edges: bool) -> None:
    mine, inboxes = table((1, 3, 0.1)), list[Inbox]()
    yielded = PerNeighbour({2: {"x": 2.0}, 3: {"x": 3.0}}) if edges else {"x": 1.0}
    wrapped = Piggyback(mine).wrap(record(yielded, inboxes))
    payload, residual = next(wrapped)
    sent = payload.payloads if isinstance(payload, PerNeighbour) else {2: payload, 3: payload}
    for each in sent.values():
        assert values(mine) == {1: (3, 0.1)}
        assert set(each) == {"x", *mine.payload}
    assert residual == 0.5

    own = sent if edges else sent[2]
    others = {2: {"x": 8.0, **table((2, 3, 0.2)).payload}, 3: {"x": 9.0, **table((3, 2, 0.3)).payload}}
    full = Inbox(own, others, stop=False, ages={3: 4}, news=[2], missing=(4,))  # type: ignore[arg-type]
    wrapped.send(full)
    inbox = inboxes[0]
    assert inbox.own == ({2: {"x": 2.0}, 3: {"x": 3.0}} if edges else {"x": 1.0})
    assert dict(inbox) == {2: {"x": 8.0}, 3: {"x": 9.0}}
    assert (inbox.age(2), inbox.age(3), inbox.fresh(3)) == (0, 4, False)
    assert (inbox.new(2), inbox.new(3), inbox.missing, inbox.stop) == (True, False, (4,), False)
    assert values(mine) == {1: (3, 0.1), 2: (3, 0.2)}  # a held value was merged when it was new

    with pytest.raises(StopIteration) as finished:
        wrapped.send(Inbox(own, {}, stop=True, missing=(2, 3, 4)))  # type: ignore[arg-type]
    assert finished.value.value == "result"
    assert inboxes[1].stop


def test_neighbours_that_have_sent_nothing_but_tables_are_missing_to_the_dialogue() -> None:
    mine, inboxes = table((1, 3, 0.1)), list[Inbox]()
    wrapped = Piggyback(mine).wrap(record({"x": 1.0}, inboxes))
    payload, _ = next(wrapped)
    alone = {TABLES_ONLY: 1, **table((2, 3, 0.2)).payload}
    wrapped.send(Inbox(payload, {2: alone}, stop=False, missing=(4,)))  # type: ignore[arg-type]
    assert (dict(inboxes[0]), inboxes[0].missing) == ({}, (2, 4))
    assert values(mine)[2] == (3, 0.2)


def test_a_name_that_is_taken_is_refused() -> None:
    with pytest.raises(AlgorithmError, match=r"payload names that begin with 'riding\.' are taken"):
        next(Piggyback().wrap(record({"riding.x": 1.0}, [])))


@pytest.mark.parametrize("yielded", [None, 3.0, [1, 2]])
def test_what_breaks_the_contract_is_left_to_the_exchange(yielded: object) -> None:
    payload, _ = next(Piggyback(table((1, 1, 1.0))).wrap(record(yielded, [])))
    assert payload is yielded
