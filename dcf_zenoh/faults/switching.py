"""Switching: a graph that changes from round to round."""

from collections.abc import Iterable, Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import probability as checked
from dcf_zenoh.messaging.delivery import Delivery

Pairs = tuple[tuple[int, int], ...]


class Switching(Fault):
    """Both links of a pair of agents come and go together; the topology is the union of all graphs.

    Two neighbours hear each other in a round, or neither hears the other. So symmetric weights stay symmetric, and sums
    over the fleet are conserved if missing values are left out (``exchange.missing = "absent"``) and not held.

    Args:
        sender: Id of the sending agent.
        receiver: Id of the receiving agent.
        probability: Probability that a pair is linked in a round, drawn anew for each round.
        graphs: Instead of `probability`, a sequence of graphs, each a list of pairs; together they must connect all
            agents. Control step k and round p have graph number k + p // rounds, modulo the number of graphs.
        rounds: Number of rounds for which a graph, or a draw, lasts.
        seed: Seed of the draws.

    Raises:
        ValueError: Both or neither of `probability` and `graphs` are given, the graphs do not connect all agents, an
            agent is in no graph, or a number is out of its range.
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
        """Lose the message if the pair was not linked in the round in which it was sent."""
        step, turn = delivery.message.step, delivery.message.round // self._rounds
        if self._probability is None:
            linked = self._linked[(step + turn) % len(self._linked)]
        else:  # not from `rng`: the opposite link must draw the same
            draw = np.random.Generator(np.random.Philox([self._seed, *self._pair, step, turn]))
            linked = draw.random() < self._probability
        return (delivery,) if linked else ()


def _check_connected(pairs: Iterable[tuple[int, int]], ends: Iterable[int]) -> None:
    """Raise ValueError unless the pairs connect all agents that they name, and name both ends of this link."""
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
