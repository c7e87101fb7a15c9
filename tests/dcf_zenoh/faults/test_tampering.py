from math import inf, nan

import numpy as np
import pytest

from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.faults.tampering import Tampering
from dcf_zenoh.message import Payload
from tests.support.deliveries import alone, delivery


def said(fault: Tampering, **payload: object) -> Payload:
    (after,) = alone(fault, delivery(payload=payload))
    return after.message.payload


def test_values_are_scaled_and_shifted() -> None:
    payload = said(Tampering(scale=-2.0, offset=0.5), x=np.array([1.0, 2.0]), y=3.0, n=4)
    assert payload["x"].tolist() == [-1.5, -3.5]  # type: ignore[union-attr]
    assert payload["y"] == -5.5
    assert payload["n"] == 4


def test_every_receiver_gets_the_same_wrong_value() -> None:
    given = delivery(payload={"x": np.array([1.0, 2.0])})
    told = [alone(Tampering(scale=3.0), given, seed=seed)[0].message.payload["x"] for seed in range(3)]
    assert all(np.array_equal(told[0], each) for each in told)
    assert Tampering.STAGE is Stage.SENDER


def test_a_frozen_sender_repeats_the_first_payload_of_each_phase() -> None:
    fault = Tampering(freeze=True)
    assert said(fault, x=1.0, n=1) == {"x": 1.0, "n": 1}
    assert said(fault, y=5.0) == {"y": 5.0}
    assert said(fault, x=2.0, n=2) == {"x": 1.0, "n": 1}
    assert said(fault, y=6.0) == {"y": 5.0}


def test_what_is_frozen_is_scaled_once() -> None:
    fault = Tampering(freeze=True, scale=2.0)
    assert [said(fault, x=value)["x"] for value in (1.0, 5.0, 7.0)] == [2.0, 2.0, 2.0]


def test_only_what_is_named_is_tampered_with() -> None:
    fault = Tampering(freeze=True, offset=1.0, names=("x",))
    assert said(fault, x=1.0, y=1.0) == {"x": 2.0, "y": 1.0}
    assert said(fault, x=5.0, y=5.0) == {"x": 2.0, "y": 5.0}


def test_what_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^scale must be finite, not inf$"):
        Tampering(scale=inf)
    with pytest.raises(ValueError, match=r"^offset must be finite, not nan$"):
        Tampering(offset=nan)
