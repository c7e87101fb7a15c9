from collections.abc import Callable

import pytest

from dcf_zenoh.faults.noise import Noise
from dcf_zenoh.faults.payload import PayloadFault
from dcf_zenoh.faults.quantisation import Quantisation
from dcf_zenoh.faults.tampering import Tampering
from tests.support.deliveries import alone, delivery, link

Make = Callable[[tuple[str, ...]], PayloadFault]
KINDS: dict[str, Make] = {
    "noise": lambda names: Noise(std=0.1, names=names),
    "quantisation": lambda names: Quantisation(step=0.1, names=names),
    "tampering": lambda names: Tampering(scale=2.0, names=names),
    "freezing": lambda names: Tampering(freeze=True, names=names),
}


@pytest.mark.parametrize("kind", KINDS)
def test_names_that_no_payload_had_are_reported(kind: str) -> None:
    fault = KINDS[kind](("lamda", "x", "mew"))
    alone(fault, delivery(payload={"x": 1.0, "lam": 2.0}))
    assert fault.unmet == "no payload had 'lamda', 'mew'; there were 'lam', 'x'"
    alone(fault, delivery(payload={"mew": 1.0}))
    assert fault.unmet == "no payload had 'lamda'; there were 'lam', 'mew', 'x'"
    alone(fault, delivery(payload={"lamda": 1.0}))
    assert not fault.unmet


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_missed_of_all_names_nor_of_no_message(kind: str) -> None:
    everything, unused = KINDS[kind](()), KINDS[kind](("x",))
    alone(everything, delivery(payload={"y": 1.0}))
    assert not everything.unmet
    assert not unused.unmet


def test_a_link_reports_which_of_its_faults_missed_something() -> None:
    faults = {kind: KINDS[kind](("x" if kind == "noise" else "y",)) for kind in ("noise", "quantisation")}
    given = link(**faults)
    given.convey(delivery(payload={"x": 1.0}))
    assert given.unmet == [("quantisation", "no payload had 'y'; there were 'x'")]
