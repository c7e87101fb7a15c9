import pytest

from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.faults.range import Range
from tests.support.deliveries import alone, delivery


@pytest.mark.parametrize(
    ("there", "here", "cut"),
    [
        ((0.0, 0.0), (3.0, 4.0), False),
        ((0.0, 0.0), (3.0, 4.001), True),
        ((1.0, 2.0, 3.0), (1.0, 2.0, 8.1), True),
        ((), (100.0, 0.0), False),
        ((100.0, 0.0), (), False),
        ((), (), False),
    ],
)
def test_messages_from_farther_away_are_cut(there: tuple[float, ...], here: tuple[float, ...], *, cut: bool) -> None:
    given = delivery(position=there, here=here)
    assert alone(Range(distance=5.0), given) == ([] if cut else [given])


def test_a_negative_distance_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^distance must be at least 0, in m, not -1$"):
        Range(distance=-1)


def test_positions_of_different_dimensions_are_an_error() -> None:
    text = r"^range: the position of agent 1 has 2 components, that of its receiver 3; "
    with pytest.raises(ConfigurationError, match=text):
        alone(Range(distance=1.0), delivery(position=(0.0, 0.0), here=(0.0, 0.0, 1.0)))
