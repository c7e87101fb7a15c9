from pathlib import Path
from typing import Any

import pytest

from dcf_zenoh.config import LoadedFleet, Overrides, graph_of, load
from dcf_zenoh.configuration.building.fault_links import can_lose, fault_of, links_to, margin_of, needs_positions
from dcf_zenoh.errors import PluginError
from dcf_zenoh.faults.bursts import Bursts
from dcf_zenoh.faults.chain import FaultChain
from dcf_zenoh.faults.fault import Fault, FaultLink
from dcf_zenoh.faults.latency import Latency
from dcf_zenoh.faults.loss import Loss
from dcf_zenoh.faults.partition import Partition
from dcf_zenoh.spec import FaultTable, FleetSpec
from tests.support.deliveries import delivery
from tests.support.lossy_fleets import lossy

S = 1_000_000_000  # ns


def links(fleet: LoadedFleet, receiver: int) -> dict[int, FaultChain]:
    return links_to(fleet.spec, fleet.folder, graph_of(fleet), receiver)


def acting(link: FaultChain, seconds: float) -> dict[str, type[Fault]]:
    layers = {layer.name: layer.acting(round(seconds * S)) for layer in link._chain}
    return {name: type(fault) for name, fault in layers.items() if fault is not None}


def table(kind: str, **options: Any) -> FaultTable:
    return FaultTable.model_validate({"kind": kind, **options})


def test_every_link_has_the_faults_of_all_and_of_its_rules(tmp_path: Path) -> None:
    fleet = load(lossy(tmp_path))
    into = {receiver: links(fleet, receiver) for receiver in fleet.spec.ids}
    assert {i: sorted(each) for i, each in into.items()} == {1: [2, 4], 2: [1, 3], 3: [2, 4], 4: [1, 3]}  # the ring
    for receiver, own in into.items():
        for sender, link in own.items():
            bad = {"bursts": Bursts} if (sender, receiver) == (2, 3) else {}
            for seconds in (-1.0, 0.0, 3.999, 4.5, 24.0):
                assert acting(link, seconds) == {"latency": Latency, **bad}
            for seconds in (4.0, 4.499):
                assert acting(link, seconds) == {"latency": Latency, "partition": Partition, **bad}


def test_fault_is_of_its_link(tmp_path: Path) -> None:
    fleet = load(lossy(tmp_path))
    cut = {
        (i, j)
        for j in fleet.spec.ids
        for i, link in links(fleet, j).items()
        if link.convey(delivery(sender=i, entered=round(4.2 * S))).lost_by == "partition"
    }
    assert cut == {(1, 4), (4, 1), (2, 3), (3, 2)}


LINKED = """
from dcf_zenoh.faults.fault import Fault

class Linked(Fault):
    def __init__(self, receiver, link, *, often: int = 1):
        self.receiver, self.link = receiver, link
    def apply(self, delivery, rng):
        return (delivery,)
"""


def test_fault_can_have_its_link_as_one_object_or_any_part_of_it(tmp_path: Path) -> None:
    (tmp_path / "linked.py").write_text(LINKED)
    fault: Any = fault_of("odd", table("./linked.py:Linked"), 3, 4, tmp_path)
    assert fault.link == FaultLink(sender=3, receiver=4, folder=tmp_path)
    assert fault.receiver == 4
    into = links(load(lossy(tmp_path, '[faults]\nodd = { kind = "./linked.py:Linked" }')), 1)
    layers = {sender: layer for sender, link in into.items() for layer in link._chain}
    assert {sender: layer.acting(0).link[:2] for sender, layer in layers.items()} == {2: (2, 1), 4: (4, 1)}  # type: ignore[union-attr]


def test_link_without_faults_costs_nothing(tmp_path: Path) -> None:
    fleet = load(lossy(tmp_path, "[[faults.rule]]\nfrom = 2\nto = [1, 3]\nloss = 0.1"))
    assert {j: sorted(links(fleet, j)) for j in fleet.spec.ids} == {1: [2], 2: [], 3: [2], 4: []}
    off = load(lossy(tmp_path, "[[faults.rule]]\nfrom = 2\nloss = false"))
    assert links(off, 1) == {}
    assert links(load(lossy(tmp_path, "")), 1) == {}


def test_later_rule_wins_name_by_name(tmp_path: Path) -> None:
    text = """
        [faults]
        loss = 1.0
        noise = 0.1
        [[faults.rule]]
        to = 1
        loss = false
        [[faults.rule]]
        from = 2
        during = [5.0, 6.0]
        loss = { kind = "bursts", mean_loss = 0.1, mean_length = 2 }
    """
    fleet = load(lossy(tmp_path, text))
    first, second = links(fleet, 1)[2], links(fleet, 3)[2]
    assert [set(acting(first, t)) for t in (1, 5, 6)] == [{"noise"}, {"noise", "loss"}, {"noise"}]
    assert [acting(second, t)["loss"] for t in (1, 5, 6)] == [Loss, Bursts, Loss]
    assert set(acting(links(fleet, 1)[4], 5)) == {"noise"}


def test_links_and_rules_share_no_instance(tmp_path: Path) -> None:
    text = "[faults]\na = { kind = './mine.py:Dull' }\n[[faults.rule]]\nto = 1\nduring = [1, 2]\na = 3"
    fleet = load(lossy(tmp_path, text))
    found: list[Any] = [fault for i in (2, 4) for _, fault in links(fleet, 1)[i]._layers["a"].entries]
    assert len({id(fault) for fault in found}) == 4
    assert [fault.link for fault in found] == [(2, 1), (2, 1), (4, 1), (4, 1)]
    assert [fault.often for fault in found] == [1, 3, 1, 3]
    assert all(fault.folder == tmp_path for fault in found)


def test_one_fault_is_made_as_a_fleet_file_would(tmp_path: Path) -> None:
    lossy(tmp_path)
    assert isinstance(fault_of("loss", table("loss", probability=0.1), 1, 2, tmp_path), Loss)
    assert isinstance(fault_of("loss", table("loss", value=0.1), 1, 2, tmp_path), Loss)
    assert fault_of("loss", False, 1, 2, tmp_path) is None
    own: Any = fault_of("a", table("./mine.py:Dull"), 1, 2, tmp_path)
    assert (own.link, own.folder) == ((1, 2), tmp_path)


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (table("lsos"), "unknown kind 'lsos'; did you mean 'loss'? "),
        (table("loss"), "a.probability: missing; Loss needs a number"),
        (table("loss", probability="x"), "a.probability: expected a number, not 'x'"),
        (table("loss", value=2), "a: Loss refused its options: probability must be a probability, from 0 to 1, not 2"),
        (table("./mine.py:wrong"), "a: wrong made a str, not a Fault"),
    ],
)
def test_fault_that_cannot_be_made_gives_the_reason(tmp_path: Path, fault: FaultTable, text: str) -> None:
    lossy(tmp_path)
    with pytest.raises(PluginError) as caught:
        fault_of("a", fault, 1, 2, tmp_path)
    assert str(caught.value).startswith(text)


@pytest.mark.parametrize(
    ("changes", "loses"),
    [
        ([], False),
        (["faults.noise=0.1", "faults.loss=false", "agents.1.faults.slow.factor=2"], False),
        (["faults.loss=0.1"], True),
        (["faults.rule=[{to=1,partition=[[1],[2]]}]"], True),
        (["agents.1.faults.crash.at=3"], True),
        (["agents.1.faults.pause=[3,4]"], True),
        (["faults.a.kind=./mine.py:Dull"], False),
    ],
)
def test_margin_follows_from_what_can_be_lost_or_late(tmp_path: Path, changes: list[str], loses: bool) -> None:
    changes = ["time.clock=virtual", *changes]
    fleet = load(lossy(tmp_path, ""), changes=changes)
    assert can_lose(fleet.spec, tmp_path) is loses
    assert margin_of(fleet.spec, tmp_path) == (3 if changes[1:] else 0)  # any fault makes rounds time out
    for margin in (0, 5):
        assert margin_of(load(lossy(tmp_path, ""), changes=[*changes, f"exchange.margin={margin}"]).spec, tmp_path) == (
            margin
        )
    asynchronous = load(lossy(tmp_path, ""), changes=[*changes, "exchange.mode=asynchronous"])
    assert margin_of(asynchronous.spec, tmp_path) == 0


def test_margin_is_there_where_rounds_time_out_on_the_wall_clock(tmp_path: Path) -> None:
    spec = load(lossy(tmp_path, ""), Overrides(clock="wall")).spec  # what is late is lost, and operators can add faults
    assert margin_of(spec, tmp_path) == 3
    patient = spec.model_copy(update={"exchange": spec.exchange.model_copy(update={"round_timeout": None})})
    assert margin_of(patient, tmp_path) == 0


def test_positions_are_needed_by_range_alone(tmp_path: Path) -> None:
    def needed(*changes: str) -> bool:
        spec: FleetSpec = load(lossy(tmp_path), changes=changes).spec
        return needs_positions(spec, tmp_path)

    assert not needed()
    assert needed("faults.range=1.5")
    assert needed("faults.rule.3={from=1,range=1.5}")
    assert needed("faults.a={kind='./mine.py:Jammer',victims=[[1]]}")
