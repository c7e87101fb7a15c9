import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.faults.quantisation import Quantisation
from tests.support.deliveries import alone, delivery


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e3))
def test_a_number_becomes_the_nearest_multiple(value: float, step: float) -> None:
    (after,) = alone(Quantisation(step=step), delivery(payload={"x": value}))
    got = float(after.message.payload["x"])
    rounding = 1e-9 * max(1.0, abs(value))
    assert abs(got - value) <= step / 2 + rounding
    assert got / step == pytest.approx(round(got / step), abs=1e-6)


def test_zero_is_a_multiple_and_halves_go_to_the_even_one() -> None:
    given = delivery(payload={"x": np.array([0.1, -0.1, 0.25, 0.75, -1.3]), "f": np.array([0.6], "f4"), "n": 3})
    (after,) = alone(Quantisation(step=0.5), given)
    assert after.message.payload["x"].tolist() == [0.0, 0.0, 0.0, 1.0, -1.5]  # type: ignore[union-attr]
    assert after.message.payload["f"].dtype == np.float32  # type: ignore[union-attr]
    assert after.message.payload["n"] == 3


def test_quantising_again_changes_nothing() -> None:
    fault = Quantisation(step=0.3)
    (once,) = alone(fault, delivery(payload={"x": np.linspace(-5, 5, 101)}))
    (twice,) = alone(fault, once)
    assert np.array_equal(once.message.payload["x"], twice.message.payload["x"])


def test_only_what_is_named_is_quantised() -> None:
    (after,) = alone(Quantisation(step=1.0, names=("y",)), delivery(payload={"x": 0.4, "y": 0.4}))
    assert after.message.payload == {"x": 0.4, "y": 0.0}


def test_a_step_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^step must be positive, not 0.0$"):
        Quantisation(step=0.0)
