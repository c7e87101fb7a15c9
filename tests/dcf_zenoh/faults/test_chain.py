import zlib
from collections.abc import Callable, Sequence
from itertools import permutations
from math import inf
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.errors import FaultError
from dcf_zenoh.faults.bandwidth import Bandwidth
from dcf_zenoh.faults.bursts import Bursts
from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer
from dcf_zenoh.faults.duplication import Duplication
from dcf_zenoh.faults.fault import Fault, FaultLink
from dcf_zenoh.faults.latency import Latency
from dcf_zenoh.faults.loss import Loss
from dcf_zenoh.faults.noise import Noise
from dcf_zenoh.faults.quantisation import Quantisation
from dcf_zenoh.faults.tampering import Tampering
from dcf_zenoh.messaging.delivery import Delivery
from tests.support.deliveries import HERE, MS, convey, delivery, latencies, link, lost


class Draw(Fault):
    """Keeps what it drew."""

    def __init__(self) -> None:
        self.drawn: list[float] = []

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        self.drawn.append(rng.random())
        return (delivery,)


def jitter() -> Latency:
    return Latency(FaultLink(1, 2, HERE), distribution="normal", mean=0.02, std=0.005)


def drawn(
    key: tuple[int, int, int] = (0, 1, 2), name: str = "draw", others: dict[str, Fault] | None = None, **fields: Any
) -> list[float]:
    """What a fault draws for 50 messages."""
    fault = Draw()
    chain = link(key, **{**(others or {}), name: fault})
    for sequence in range(50):
        chain.convey(delivery(sequence, **fields))
    return fault.drawn


def test_a_name_stands_where_the_fault_stands_that_acts() -> None:
    rounded, noisy = Quantisation(step=0.25), Noise(std=0.01)
    layers = [Layer("noise", [(ALWAYS, noisy)]), Layer("x", [(ALWAYS, rounded), ((10, 20), Tampering(offset=0.1))])]
    chain = FaultChain(0, 1, 2, layers)
    before, within, after = (chain.convey(delivery(n, entered=n)).deliveries[0] for n in (9, 10, 20))
    for each in (before, after):
        assert np.all(np.asarray(each.message.payload["x"]) % 0.25 == 0)
    assert np.all(np.asarray(within.message.payload["x"]) % 0.25 != 0)
    alone = FaultChain(0, 1, 2, [Layer("noise", [(ALWAYS, noisy)]), Layer("x", [(ALWAYS, rounded)])])
    assert np.array_equal(
        alone.convey(delivery(9, entered=9)).deliveries[0].message.payload["x"], before.message.payload["x"]
    )


def test_a_link_without_faults_lets_everything_through() -> None:
    given = delivery()
    assert link().convey(given) == ((given,), "")


def test_random_numbers_are_those_of_philox_at_the_place_of_the_message() -> None:
    seed, sender, receiver, sequence, incarnation = 5, 3, 4, 17, 2
    fault = Draw()
    link((seed, sender, receiver), radio=fault).convey(delivery(sequence, incarnation=incarnation))
    key = np.random.SeedSequence([seed, sender, receiver]).generate_state(2, np.uint64)
    counter = [0, sequence, zlib.crc32(b"radio"), incarnation]
    assert fault.drawn == [np.random.Generator(np.random.Philox(key=key, counter=counter)).random()]


@pytest.mark.parametrize(
    "other",
    [
        {"key": (1, 1, 2)},
        {"key": (0, 7, 2)},
        {"key": (0, 1, 7)},
        {"name": "another"},
        {"incarnation": 1},
    ],
)
def test_seed_link_name_and_incarnation_each_change_all_draws(other: dict[str, Any]) -> None:
    assert not set(drawn()) & set(drawn(**other))


def test_draws_are_those_of_the_message_whatever_came_before_it() -> None:
    every = drawn()
    fault = Draw()
    chain = link(draw=fault)
    for sequence in (30, 7, 7):
        chain.convey(delivery(sequence))
    assert fault.drawn == [every[30], every[7], every[7]]


def test_another_fault_changes_no_draws() -> None:
    assert drawn() == drawn(others={"bursts": Bursts(mean_loss=0.0, mean_length=2.0), "noise": Noise(std=1.0)})
    alone = convey(link(latency=jitter()), 200)
    among = convey(link(loss=Loss(probability=0.5), latency=jitter(), noise=Noise(std=1.0)), 200)
    came = [a for a, b in zip(alone, among, strict=True) if b.deliveries]
    assert 50 < len(came) < 150
    assert latencies(came) == latencies(among)


def test_order_of_creation_changes_nothing() -> None:
    def chain() -> dict[str, Fault]:
        return {
            "loss": Loss(probability=0.1),
            "bandwidth": Bandwidth(rate=1e5),
            "latency": jitter(),
            "duplication": Duplication(probability=0.3),
        }

    outcomes = []
    for names in permutations(chain()):
        faults = chain()
        passages = convey(link(**{name: faults[name] for name in names}), 50)
        outcomes.append([(passage.lost_by, [each.due for each in passage.deliveries]) for passage in passages])
    assert all(each == outcomes[0] for each in outcomes)


def test_faults_act_in_the_order_of_their_stages_then_of_their_names() -> None:
    for name in ("a", "z"):  # a sender tampers with what is then quantised, whatever either is called
        chain = link(quantisation=Quantisation(step=1.0), **{name: Tampering(scale=10.0)})
        (after,) = chain.convey(delivery(payload={"x": 0.14})).deliveries
        assert after.message.payload["x"] == 1.0
    for coarse, fine, value in (("a", "b", 0.0), ("b", "a", 0.8)):
        chain = link(**{coarse: Quantisation(step=0.8), fine: Quantisation(step=0.5)})
        (after,) = chain.convey(delivery(payload={"x": 0.38 if value == 0.0 else 0.41})).deliveries
        assert after.message.payload["x"] == value


def test_a_loss_is_put_down_to_the_fault_that_lost() -> None:
    assert link(radio=Loss(probability=1.0), noise=Noise(std=1.0)).convey(delivery()) == ((), "radio")
    both = link(a=Loss(probability=0.0), b=Loss(probability=1.0))
    assert both.convey(delivery()).lost_by == "b"
    mixed = convey(link(loss=Loss(probability=0.3), bursts=Bursts(mean_loss=0.3, mean_length=2.0)), 1000)
    assert {passage.lost_by for passage in mixed} == {"", "loss", "bursts"}
    assert all(bool(passage.lost_by) != bool(passage.deliveries) for passage in mixed)


def test_copies_go_on_by_themselves() -> None:
    chain = link(duplication=Duplication(probability=1.0), noise=Noise(std=1.0))
    first, second = chain.convey(delivery(payload={"x": 0.0})).deliveries
    assert first.message.payload["x"] != second.message.payload["x"]


def test_copies_that_are_all_lost_are_put_down_to_the_fault_that_lost_them() -> None:
    class Twice(Duplication):
        STAGE = Loss.STAGE

    passage = link(a=Twice(probability=1.0), loss=Loss(probability=1.0)).convey(delivery())
    assert passage == ((), "loss")


def test_later_entries_win_within_their_windows() -> None:
    chain = link(latency=Latency(FaultLink(1, 2, HERE), mean=0.01))
    chain.add("latency", (10 * MS, 30 * MS), Latency(FaultLink(1, 2, HERE), mean=0.05))
    chain.add("latency", (20 * MS, 25 * MS), None)
    chain.add("loss", (40 * MS, 41 * MS), Loss(probability=1.0))
    passages = convey(chain, 50)
    assert [round(s * 1000) for s in latencies(passages)] == [*[10] * 10, *[50] * 10, *[0] * 5, *[50] * 5, *[10] * 19]
    assert [number for number, gone in enumerate(lost(passages)) if gone] == [40]


def test_a_window_has_the_draws_of_its_name() -> None:
    inside = Draw()
    chain = FaultChain(0, 1, 2, [Layer("draw", [(ALWAYS, Draw()), ((0, 5 * MS), inside)])])
    convey(chain, 50)
    assert inside.drawn == drawn()[:5]


@given(
    st.lists(st.integers(0, 20 * MS), min_size=1, max_size=40),
    st.integers(0, 2**32),
    st.floats(0, 1),
    st.floats(0, 0.05),
    st.floats(200, 1e6),
)
def test_nothing_is_due_before_it_entered(gaps: list[int], seed: int, p: float, mean: float, rate: float) -> None:
    chain = link(
        (seed, 1, 2),
        bandwidth=Bandwidth(rate=rate),
        latency=Latency(FaultLink(1, 2, HERE), distribution="normal", mean=mean, std=0.01),
        duplication=Duplication(probability=p, delay=mean),
        loss=Loss(probability=p / 2),
    )
    for number, at in enumerate(np.cumsum(gaps).tolist()):
        passage = chain.convey(delivery(number, at))
        assert bool(passage.lost_by) != bool(passage.deliveries)
        for each in passage.deliveries:
            assert type(each.due) is int
            assert each.due >= each.entered == at


def test_clear_ends_what_was_added_and_leaves_what_was_given() -> None:
    chain = link(latency=Latency(FaultLink(1, 2, HERE), mean=0.01))
    chain.add("latency", (10 * MS, inf), Latency(FaultLink(1, 2, HERE), mean=0.05))
    chain.add("loss", (10 * MS, 12 * MS), Loss(probability=1.0))
    chain.add("bursts", (10 * MS, inf), None)
    chain.clear(20 * MS)
    chain.add("loss", (25 * MS, inf), Loss(probability=1.0))
    chain.clear(26 * MS)
    chain.clear(30 * MS)  # what has ended does not go on
    passages = convey(chain, 40)
    assert [number for number, gone in enumerate(lost(passages)) if gone] == [10, 11, 25]
    assert [round(s * 1000) for s in latencies(passages)] == [*[10] * 10, *[50] * 8, *[10] * 19]


class Broken(Fault):
    """Returns what it was told."""

    def __init__(self, make: Callable[[Delivery], Any]) -> None:
        self._make = make

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Any:
        return self._make(delivery)


def fail(_delivery: Delivery) -> Any:
    raise ZeroDivisionError("oops")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (fail, r"link 1 -> 2: fault 'odd': ZeroDivisionError: oops \(test_chain.py:\d+\)"),
        (lambda _: None, "link 1 -> 2: fault 'odd': TypeError: 'NoneType' object is not iterable"),
        (lambda _: ["x"], "link 1 -> 2: fault 'odd' made 'x' of a message; expected deliveries of the same message"),
        (lambda d: [d._replace(due=d.due + 0.5)], "whose due is a whole number of ns"),
        (lambda d: [d._replace(due=d.entered - 1)], "not before they entered"),
        (lambda d: [d._replace(due=2**63)], "fault 'odd' made"),
        (lambda d: [d._replace(entered=d.entered + 1, due=d.due + 1)], "fault 'odd' made"),
        (lambda d: [d._replace(message=d.message._replace(sender=9))], "of the same message"),
    ],
)
def test_a_fault_that_breaks_its_contract_is_named_with_its_link(make: Callable[[Delivery], Any], said: str) -> None:
    chain = FaultChain(0, 1, 2, [Layer("odd", [(ALWAYS, Broken(make))])])
    with pytest.raises(FaultError, match=said):
        chain.convey(delivery(0, 5))
