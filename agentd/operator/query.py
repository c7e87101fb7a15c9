"""Requests of an operator to the agents of a running fleet: one Zenoh session, one query for each agent."""

import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from queue import Empty, SimpleQueue

import zenoh

from agentd.daemon.operator_protocol import Answer, decode_answer
from dcf_zenoh.errors import MessageError, NetworkError
from dcf_zenoh.messaging.network import Address

TIMEOUT = 3.0  # s for the answers of all agents


def query_agents(address: Address, requests: Mapping[int, bytes]) -> tuple[dict[int, Answer], list[str]]:
    """Send each agent its request and wait for the answers, at most `TIMEOUT`.

    Args:
        address: Keys and endpoints of the fleet.
        requests: Agent -> encoded request.

    Returns:
        Agent -> answer, for the agents that did what they were asked to do, and a complaint about every other agent: it
        refused, did not answer in time, or sent something else than an answer.

    Raises:
        NetworkError: Zenoh rejects a setting or an endpoint.
    """
    answers, complaints = {}, []
    replies = send_queries(address, requests, TIMEOUT)
    for agent in sorted(requests):
        if agent not in replies:
            complaints.append(f"agent {agent} did not answer within {TIMEOUT:g} s")
            continue
        try:
            answer = decode_answer(replies[agent], agent)
        except MessageError as error:
            complaints.append(f"agent {agent}: {error}")
            continue
        if answer.error:
            complaints += [f"agent {agent}: {line}" for line in answer.error.splitlines()]
        else:
            answers[agent] = answer
    return answers, complaints


def print_complaints(complaints: Sequence[str]) -> int:
    """Print complaints on standard error; return the exit code, 1 if there are any."""
    for line in complaints:
        print(f"agentd: {line}", file=sys.stderr)
    return 1 if complaints else 0


def send_queries(address: Address, requests: Mapping[int, bytes], timeout: float) -> dict[int, bytes]:
    """Query each agent once, as soon as it can be reached.

    Args:
        address: Keys and endpoints of the fleet. The operator's session accepts no connections.
        requests: Agent -> payload of its query.
        timeout: Limit for all queries together, in s.

    Returns:
        Agent -> payload of its reply, for the agents that replied in time.

    Raises:
        NetworkError: Zenoh rejects a setting or an endpoint.
    """
    deadline = time.monotonic() + timeout
    events: SimpleQueue[tuple[int, bytes | None]] = SimpleQueue()  # None: the agent can be reached
    replies: dict[int, bytes] = {}
    config = address.config()
    config.insert_json5("transport/unicast/open_timeout", str(round(timeout * 500)))  # ms; closing waits for it

    def on_match(agent: int, status: zenoh.MatchingStatus) -> None:
        if status.matching:
            events.put((agent, None))

    def on_reply(agent: int, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            events.put((agent, reply.ok.payload.to_bytes()))

    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise NetworkError(f"cannot reach {list(address.connect)}: {error}") from error
    with session:
        queriers = {
            agent: session.declare_querier(f"{address.prefix}/control/{agent}", timeout=timeout) for agent in requests
        }
        listeners = [each.declare_matching_listener(partial(on_match, agent)) for agent, each in queriers.items()]
        sent = set()
        while len(replies) < len(requests):
            try:
                agent, payload = events.get(timeout=max(0.0, deadline - time.monotonic()))
            except Empty:
                break
            if payload is not None:
                replies[agent] = payload
            elif agent not in sent:
                sent.add(agent)
                queriers[agent].get(partial(on_reply, agent), payload=requests[agent])
        for listener in listeners:  # kept until here, because a listener ends with its last reference
            listener.undeclare()  # type: ignore[no-untyped-call]
    return replies
