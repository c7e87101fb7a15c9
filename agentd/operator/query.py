"""Requests of an operator to the agents of a running fleet, and their answers."""

from collections.abc import Mapping

from agentd.daemon.operator_protocol import Answer, decode_answer
from agentd.operator.session import send_queries
from dcf_zenoh.errors import MessageError
from dcf_zenoh.messaging.address import Address

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
    replies = send_queries(address.prefix, address.entries(), requests, TIMEOUT)
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
