"""The sending half of an exchange: from what an algorithm yields to numbered messages."""

from collections.abc import Mapping, Set
from types import MappingProxyType
from typing import Any, NamedTuple

from dcf_zenoh.algorithms.algorithm import PerNeighbour
from dcf_zenoh.errors import MessageError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Copies, Last, Message, Payload, canonical
from dcf_zenoh.requests import Publish
from dcf_zenoh.rounds.agreement import Header

_AWAY = Last.AWAY  # to look it up takes long
_NO_HEADER = Header()
_NO_PAYLOAD: Payload = MappingProxyType({})


class Sent(NamedTuple):
    """What one agent says in one round.

    Attributes:
        own: The payload as receivers decode it; of edge payloads, neighbour -> payload.
        names: Of the entries of the payload.
        publications: One message per out-neighbour, or one for all.
    """

    own: Mapping[Any, Any]
    names: Set[str]
    publications: list[Publish]


class Sender:
    """Numbers the messages of one agent.

    Args:
        agent: Id.
        incarnation: How often this agent was started again in this run.
        first: Number of its first message.

    Attributes:
        published: Messages of control steps so far, edge messages one by one.
        position: Where the agent is, to be told; empty if nobody asks.
    """

    def __init__(self, agent: int, incarnation: int = 0, first: int = 0) -> None:
        self._agent = agent
        self._incarnation = incarnation
        self._sequence = first
        self.published = 0
        self.position: tuple[float, ...] = ()

    def round(
        self,
        payload: Payload | PerNeighbour,
        hood: Neighbourhood,
        step: int,
        round: int,
        now: int,
        header: Header,
        promise: int = 0,
    ) -> Sent:
        """One round's messages: every out-neighbour gets exactly one of this number.

        Raises:
            MessageError: The payload cannot be sent, or does not name exactly the out-neighbours.
        """
        if not isinstance(payload, PerNeighbour):
            own = canonical(payload)
            message = self.message(now, step, round, header, payload=own, promise=promise)
            return Sent(own, own.keys(), [Publish(message)])
        if set(payload.payloads) != set(hood.sends_to):
            raise MessageError(
                f"PerNeighbour names {sorted(payload.payloads)}; expected exactly its out-neighbours"
                f" {list(hood.sends_to)}"
            )
        shared: Copies = {}
        edges = {j: canonical(payload.payloads[j], shared) for j in hood.sends_to}
        message = self.message(now, step, round, header, promise=promise)
        self.published += len(edges) - 1
        names = frozenset(name for edge in edges.values() for name in edge)
        return Sent(edges, names, [Publish(Message(*message[:-1], edge), j) for j, edge in edges.items()])

    def message(
        self,
        now: int,
        step: int,
        round: int = 0,
        header: Header = _NO_HEADER,
        last: Last = Last.NO,
        payload: Payload = _NO_PAYLOAD,
        promise: int = 0,
    ) -> Message:
        """The next message of this agent."""
        sequence = self._sequence
        self._sequence += 1
        self.published += step >= 0 and last < _AWAY  # what the links of the steps carry
        return Message(
            self._agent, self._incarnation, sequence, step, round, now, header.stop_at, header.arrived_hops, promise,
            last, header.residuals, self.position, payload,
        )  # fmt: skip
