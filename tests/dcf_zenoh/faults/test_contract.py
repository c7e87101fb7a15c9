"""Every built-in fault keeps the contract, is known by its name, and can be written in a fleet file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.faults.fault import Fault, FaultLink, Stage
from dcf_zenoh.faults.profile import LinkProfile, write_profile
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.plugins import accepted, create, is_built_in, known, load
from dcf_zenoh.testing import check_fault

BARE = {  # kind -> what stands for it in a fleet file without a table
    "bandwidth": 20_000,
    "duplication": 0.3,
    "latency": 0.03,
    "loss": 0.2,
    "noise": 0.01,
    "partition": [[1], [2]],
    "quantisation": 0.1,
    "range": 1.5,
    "switching": 0.5,
    "tampering": -1.0,
}
TABLES: list[tuple[str, dict[str, Any]]] = [
    ("bandwidth", {"rate": 5_000, "burst": 400, "queue": 800}),
    ("bursts", {"mean_loss": 0.2, "mean_length": 3}),
    ("bursts", {"good_to_bad": 0.1, "bad_to_good": 0.5, "loss_good": 0.1, "loss_bad": 0.9}),
    ("duplication", {"probability": 0.5, "delay": 0.01}),
    ("latency", {"distribution": "uniform", "low": 0, "high": 0.1, "reorder": False}),
    ("latency", {"distribution": "normal", "mean": 0.01, "std": 0.02}),
    ("latency", {"distribution": "gamma", "mean": 0.01, "std": 0.02}),
    ("latency", {"distribution": "empirical", "file": "links.json"}),
    ("noise", {"std": 0.1, "names": ["x", "map"]}),
    ("partition", {"groups": [[1, 2], [3]]}),
    ("quantisation", {"step": 0.1, "names": ["gain"]}),
    ("switching", {"graphs": [[[1, 2]], [[2, 3]]], "rounds": 2}),
    ("tampering", {"offset": 3, "freeze": True, "names": ["x", "ids"]}),
]


def of_file(kind: str, options: dict[str, Any], folder: Path) -> Fault:
    """The fault that a fleet file in `folder` asks for, on the link from 1 to 2."""
    link = FaultLink(1, 2, folder)
    fault = create(load("faults", kind, folder), {"link": link, **link._asdict()}, options, "faults")
    assert isinstance(fault, Fault)
    return fault


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_profile(tmp_path / "links.json", [LinkProfile(1, 2, 100, 0, 0.0, (0.01, 0.02, 0.1), 0.0)])
    return tmp_path


def test_every_built_in_kind_is_tried() -> None:
    built_in = {kind for kind in known("faults") if is_built_in("faults", kind)}
    assert built_in == {*BARE, *(kind for kind, _ in TABLES)}


@pytest.mark.parametrize("kind", BARE)
def test_every_kind_keeps_the_contract_with_a_bare_value(kind: str, folder: Path) -> None:
    first = accepted(load("faults", kind, folder)).parameters[0].name
    check_fault(lambda: of_file(kind, {first: BARE[kind]}, folder))


@pytest.mark.parametrize(("kind", "options"), TABLES)
def test_every_kind_keeps_the_contract_with_a_table(kind: str, options: dict[str, Any], folder: Path) -> None:
    check_fault(lambda: of_file(kind, options, folder))


@pytest.mark.parametrize("kind", [*BARE, "bursts"])
def test_every_kind_declares_which_keys_name_files_and_whether_it_loses(kind: str, folder: Path) -> None:
    plugin = load("faults", kind, folder)
    keys = [parameter.name for parameter in accepted(plugin).parameters]
    assert {key for key in keys if "file" in key} == set(plugin.FILES)  # type: ignore[attr-defined]
    lossless = {"latency", "duplication", "noise", "quantisation", "tampering"}
    assert plugin.LOSES is (kind not in lossless)  # type: ignore[attr-defined]


class Passing(Fault):
    LOSES = False

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return (delivery,)


class Fickle(Passing):
    seen = 0

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        Fickle.seen += 1
        return (delivery._replace(due=delivery.due + Fickle.seen),)


class Hoarding(Passing):
    kept: np.random.Generator | None = None

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        self.kept = self.kept or rng
        return (delivery._replace(due=delivery.due + int(self.kept.integers(1000))),)


class Losing(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return ()


class Broken(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return (delivery._replace(due=delivery.due + 0.5),)  # type: ignore[arg-type]


class Early(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return (delivery._replace(due=delivery.entered - 1),)


class Moving(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return (delivery._replace(here=(0.0, 0.0)),)


class Rewriting(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        for value in delivery.message.payload.values():
            if isinstance(value, np.ndarray) and value.dtype == float:
                value.setflags(write=True)
                value[...] = 0.0
        return (delivery,)


class Open(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return (delivery._replace(message=delivery.message._replace(payload={"x": np.zeros(3)})),)


class Bare(Passing):
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        return (delivery.message,)  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (Fickle, "message 0: it is not repeatable"),
        (Hoarding, "message 1: it is not repeatable"),
        (Losing, "message 0: it lost it, although LOSES is False"),
        (Broken, r"message 0: due at \d+\.5, expected a whole number of ns"),
        (Early, r"message 0: due at -?\d+ ns, before it entered at \d+ ns"),
        (Moving, "message 0: it changed where the receiver is"),
        (Rewriting, "message 2: it changed the payload that it got"),
        (Open, "message 0: its payload 'x' can be changed"),
        (Bare, "message 0: it returned Message"),
    ],
)
def test_a_broken_fault_is_found_out(kind: type[Fault], text: str) -> None:
    with pytest.raises(AssertionError, match=f"^{text}"):
        check_fault(kind)


def test_a_fault_that_does_nothing_keeps_the_contract() -> None:
    check_fault(Passing)
    assert Passing.STAGE is Stage.LOSS
