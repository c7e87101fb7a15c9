import pytest

from dcf_zenoh.faults.partition import Partition
from tests.support.deliveries import alone, delivery

GROUPS = ((1, 2), (3, 4), (5,))


@pytest.mark.parametrize(
    ("sender", "receiver", "cut"),
    [(1, 2, False), (2, 1, False), (1, 3, True), (4, 2, True), (5, 1, True), (1, 9, False), (9, 3, False)],
)
def test_messages_between_groups_are_cut(sender: int, receiver: int, *, cut: bool) -> None:
    given = delivery()
    assert alone(Partition(sender, receiver, groups=GROUPS), given) == ([] if cut else [given])


@pytest.mark.parametrize("groups", [((1, 2),), ((1, 2), ())])
def test_what_does_not_part_is_refused(groups: tuple[tuple[int, ...], ...]) -> None:
    with pytest.raises(ValueError, match=r"^groups must be at least two, such as .*, none empty, not \(\(1, 2\),"):
        Partition(1, 2, groups=groups)


@pytest.mark.parametrize("groups", [((1, 2), (2, 3)), ((1, 2, 2), (3,))])
def test_an_agent_named_twice_is_refused(groups: tuple[tuple[int, ...], ...]) -> None:
    with pytest.raises(ValueError, match=r"^groups must name an agent once, not agent 2 twice$"):
        Partition(1, 2, groups=groups)
