"""How an operator reaches the agents of a fleet that runs: a Zenoh session of his own, one query for each agent."""

import time
from collections.abc import Mapping
from functools import partial
from queue import Empty, SimpleQueue

import zenoh

from dcf_zenoh.errors import NetworkError
from dcf_zenoh.messaging.network import Address


def ask(address: Address, requests: Mapping[int, bytes], timeout: float) -> dict[int, bytes]:
    """Ask each agent once.

    Args:
        address: Keys and endpoints; nobody can connect to the operator.
        requests: Agent -> what to ask it.
        timeout: For all of it, s.

    Returns:
        Agent -> its answer, of those who answered in time.

    Raises:
        NetworkError: A setting or an endpoint is not Zenoh's.
    """
    deadline = time.monotonic() + timeout
    news: SimpleQueue[tuple[int, bytes | None]] = SimpleQueue()  # None: the agent can be reached
    answers: dict[int, bytes] = {}
    config = address.config()
    config.insert_json5("transport/unicast/open_timeout", str(round(timeout * 500)))  # ms; closing waits for it

    def match(agent: int, status: zenoh.MatchingStatus) -> None:
        if status.matching:
            news.put((agent, None))

    def answer(agent: int, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            news.put((agent, reply.ok.payload.to_bytes()))

    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise NetworkError(f"cannot reach {list(address.connect)}: {error}") from error
    with session:
        queriers = {
            agent: session.declare_querier(f"{address.prefix}/control/{agent}", timeout=timeout) for agent in requests
        }
        listeners = [each.declare_matching_listener(partial(match, agent)) for agent, each in queriers.items()]
        asked = set()
        while len(answers) < len(requests):
            try:
                agent, found = news.get(timeout=max(0.0, deadline - time.monotonic()))
            except Empty:
                break
            if found is not None:
                answers[agent] = found
            elif agent not in asked:
                asked.add(agent)
                queriers[agent].get(partial(answer, agent), payload=requests[agent])
        for listener in listeners:  # they listen for as long as they are held
            listener.undeclare()  # type: ignore[no-untyped-call]
    return answers
