"""A graph that changes from round to round."""

from collections.abc import Iterable, Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import probability as checked
from dcf_zenoh.messaging.delivery import Delivery

Pairs = tuple[tuple[int, int], ...]


class Switching(Fault):
    """Links come and go, both directions of a pair alike: the topology is the union of all graphs that there are.

    So what a neighbour does not hear, the agent itself does not hear either: weights that are symmetric stay so, and
    sums over the fleet are kept, if what is missing is nothing (``exchange.missing = "absent"``) and not held.

    Args:
        sender: Id.
        receiver: Id.
        probability: Of a pair's being linked in a round, drawn anew in each.
        graphs: In place of that, the graphs that follow each other, each a list of pairs; together they must connect
            all agents. In control step k and round p it is number k + p // rounds; after the last comes the first.
        rounds: How long each graph, or draw, lasts.
        seed: Of the draws.

    Raises:
        ValueError: There are both or neither of `probability` and `graphs`, or an agent is in no graph, or they do not
            connect all agents, or a number is out of its range.
    """

    STAGE = Stage.CUT
    AGENTS = ("graphs",)

    def __init__(
        self,
        sender: int,
        receiver: int,
        *,
        probability: float | None = None,
        graphs: tuple[Pairs, ...] | None = None,
        rounds: int = 1,
        seed: int = 0,
    ) -> None:
        if (probability is None) == (graphs is None):
            raise ValueError("expected one of probability and graphs")
        if rounds < 1:
            raise ValueError(f"rounds must be at least 1, not {rounds}")
        if seed < 0:
            raise ValueError(f"seed must be at least 0, not {seed}")
        self._pair = min(sender, receiver), max(sender, receiver)
        self._probability = None if probability is None else checked("probability", probability)
        self._linked = [self._pair in {(min(pair), max(pair)) for pair in graph} for graph in graphs or ()]
        self._rounds = rounds
        self._seed = seed
        if graphs is not None:
            _check_connected([pair for graph in graphs for pair in graph], self._pair)

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Lose it, where there is no link in the round in which it was sent."""
        step, turn = delivery.message.step, delivery.message.round // self._rounds
        if self._probability is None:
            linked = self._linked[(step + turn) % len(self._linked)]
        else:  # not the link's own random numbers: the opposite link must draw the same
            draw = np.random.Generator(np.random.Philox([self._seed, *self._pair, step, turn]))
            linked = draw.random() < self._probability
        return (delivery,) if linked else ()


def _check_connected(pairs: Iterable[tuple[int, int]], ends: Iterable[int]) -> None:
    """Whether the pairs connect all agents that they name, and the ends of this link are among these."""
    groups: list[set[int]] = []
    for pair in pairs:
        joined = set(pair).union(*(group for group in groups if group & set(pair)))
        groups = [*(group for group in groups if not group & joined), joined]
    if len(groups) > 1:
        one, other = (sorted(group) for group in sorted(groups, key=min)[:2])
        raise ValueError(f"graphs must connect all agents together; nothing joins {one} and {other}")
    for agent in ends:
        if not groups or agent not in groups[0]:
            raise ValueError(f"graphs must have a link of every agent, and have none of agent {agent}")
