"""The sending half of an exchange: numbered messages of what an algorithm yields."""

from collections.abc import Mapping, Set
from types import MappingProxyType
from typing import Any, NamedTuple

from dcf_zenoh.algorithms.algorithm import PerNeighbour
from dcf_zenoh.errors import MessageError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Copies, Last, Message, Payload, canonical
from dcf_zenoh.requests import Publish
from dcf_zenoh.rounds.agreement import Header

_NO_HEADER = Header()
_NO_PAYLOAD: Payload = MappingProxyType({})


class Sent(NamedTuple):
    """Messages of one agent in one round.

    Attributes:
        own: The payload as receivers decode it; of edge payloads, neighbour -> payload.
        names: Names of the entries of the payload.
        publications: One message per out-neighbour, or one for all.
    """

    own: Mapping[Any, Any]
    names: Set[str]
    publications: list[Publish]


class Sender:
    """The sending half of one agent's exchange; it numbers the messages.

    Args:
        agent: Id of the agent.
        incarnation: Number of restarts of this agent in this run.
        first: Number of its first message.

    Attributes:
        published: Messages of control steps so far, edge messages one by one.
        position: Position of the agent, to be sent along; empty: not sent.
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
        neighbourhood: Neighbourhood,
        step: int,
        round: int,
        now: int,
        header: Header,
        promise: int = 0,
    ) -> Sent:
        """Return the messages of one round: exactly one of the same number for every out-neighbour.

        Raises:
            MessageError: The payload cannot be sent, or does not name exactly the out-neighbours.
        """
        if not isinstance(payload, PerNeighbour):
            own = canonical(payload)
            message = self.message(now, step, round, header, payload=own, promise=promise)
            return Sent(own, own.keys(), [Publish(message)])
        receivers = neighbourhood.sends_to
        if set(payload.payloads) != set(receivers):
            raise MessageError(
                f"PerNeighbour names {sorted(payload.payloads)}; expected exactly its out-neighbours {list(receivers)}"
            )
        shared: Copies = {}
        edges = {j: canonical(payload.payloads[j], shared) for j in receivers}
        message = self.message(now, step, round, header, promise=promise)
        self.published += len(edges) - 1
        names = frozenset(name for edge in edges.values() for name in edge)
        return Sent(edges, names, [Publish(Message(*message[:-1], edge), j) for j, edge in edges.items()])

    def away(self, step: int, now: int, until: int) -> Publish:
        """Return the message that nothing follows before `step`, nor before `until`, ns.

        Only the runners of the neighbours read it, in virtual time.
        """
        return Publish(self.message(now, step, last=Last.AWAY, promise=until))

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
        """Return the next message of this agent."""
        sequence = self._sequence
        self._sequence += 1
        self.published += step >= 0 and last < Last.AWAY
        return Message(
            self._agent, self._incarnation, sequence, step, round, now, header.stop_at, header.arrived_hops, promise,
            last, header.residuals, self.position, payload,
        )  # fmt: skip
