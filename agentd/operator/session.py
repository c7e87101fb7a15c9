"""Zenoh session of an operator: one query for each agent of a running fleet.

An emergency stop takes this way, so nothing is imported here that takes time.
"""

import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

import zenoh

from dcf_zenoh.errors import NetworkError


def print_complaints(complaints: Sequence[str]) -> int:
    """Print complaints on standard error; return the exit code, 1 if there are any."""
    for line in complaints:
        print(f"agentd: {line}", file=sys.stderr)
    return 1 if complaints else 0


def send_queries(
    prefix: str, settings: Mapping[str, Any], requests: Mapping[int, bytes], timeout: float
) -> dict[int, bytes]:
    """Query each agent once, as soon as it can be reached.

    Args:
        prefix: Start of all keys of the fleet.
        settings: Configuration of the session: keys as paths, with their values. It accepts no connections.
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
    config = zenoh.Config()
    for key, value in {**settings, "transport/unicast/open_timeout": round(timeout * 500)}.items():  # ms
        try:  # closing waits for the time-out
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise NetworkError(f"{key}: Zenoh does not accept {value!r}: {error}") from error

    def on_match(agent: int, status: zenoh.MatchingStatus) -> None:
        if status.matching:
            events.put((agent, None))

    def on_reply(agent: int, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            events.put((agent, reply.ok.payload.to_bytes()))

    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise NetworkError(f"cannot reach {settings.get('connect/endpoints')}: {error}") from error
    with session:
        try:
            queriers = {i: session.declare_querier(f"{prefix}/control/{i}", timeout=timeout) for i in requests}
        except zenoh.ZError as error:
            raise NetworkError(f"{prefix!r} is no start of a Zenoh key: {error}") from error
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
