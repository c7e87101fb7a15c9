from math import sqrt

import pytest

from dcf_zenoh.faults.duplication import Duplication
from tests.support.deliveries import MANY, MS, Z, alone, convey, delivery, link


def test_a_certain_duplicate_comes_after_the_first() -> None:
    given = delivery(entered=7)._replace(due=20)
    assert alone(Duplication(probability=1.0, delay=0.003), given) == [given, given._replace(due=20 + 3 * MS)]
    assert alone(Duplication(probability=1.0), given) == [given, given]


def test_as_many_messages_come_twice_as_configured() -> None:
    p = 0.2
    twice = sum(len(each.deliveries) == 2 for each in convey(link(duplication=Duplication(probability=p))))
    assert abs(twice / MANY - p) < Z * sqrt(p * (1 - p) / MANY)


def test_a_duplication_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^probability must be a probability, from 0 to 1, not 2$"):
        Duplication(probability=2)
    with pytest.raises(ValueError, match=r"^delay must be at least 0, in s, not -0.1$"):
        Duplication(probability=0.1, delay=-0.1)
