"""Checks of the endpoints of a fleet: form, ports, and one endpoint for each agent."""

import re
from collections.abc import Mapping

from dcf_zenoh.diagnostics import Diagnostics, listed, nearest
from dcf_zenoh.spec import FleetSpec

PORT_MAX = 65535
BY_PORT = ("tcp", "udp", "tls", "quic", "ws")  # protocols whose addresses are HOST:PORT
PROTOCOLS = (*BY_PORT, "unixsock-stream", "unixpipe", "vsock", "serial")  # as Zenoh names them


def check_endpoints(spec: FleetSpec, diagnostics: Diagnostics, notes: list[str]) -> None:
    """Check that each endpoint is one that Zenoh can listen on, and that no two agents have the same."""
    owners: dict[str, int] = {}
    for agent, own in spec.agents.items():
        if own.endpoint is None:
            continue
        key = f"agents.{agent}.endpoint"
        if problem := _form_problem(own.endpoint):
            diagnostics.add(key, problem)
        elif own.endpoint in owners:
            diagnostics.add(key, f"{own.endpoint} is taken by agent {owners[own.endpoint]}; each needs its own")
        owners.setdefault(own.endpoint, agent)
    _check_default_ports(spec, owners, diagnostics, notes)


def host_of(endpoint: str) -> str:
    """Return the host of an endpoint, without protocol and port."""
    return endpoint.partition("/")[2].rpartition(":")[0]


def _form_problem(endpoint: str) -> str:
    """Return what is wrong with the form of an endpoint; empty if nothing is."""
    protocol, _, rest = endpoint.partition("/")
    if protocol not in PROTOCOLS:
        return f"unknown protocol {protocol!r}{nearest(protocol, PROTOCOLS)} allowed: {listed(PROTOCOLS)}"
    if protocol not in BY_PORT:
        return ""
    found = re.fullmatch(r"(?:\[[^\]]+\]|[^:\[\]]+):([0-9]+)", re.split("[?#]", rest)[0])
    if found is None:
        return f"expected {protocol}/HOST:PORT, not {endpoint!r}"
    port = int(found[1])
    return "" if 0 < port <= PORT_MAX else f"expected a port from 1 to {PORT_MAX}, not {port}"


def _check_default_ports(
    spec: FleetSpec, owners: Mapping[str, int], diagnostics: Diagnostics, notes: list[str]
) -> None:
    """Check the endpoints of agents that name none, which only `agentd run` uses: a launcher chooses free ports."""
    base = spec.zenoh.base_port
    for agent in (each for each in spec.ids if spec.agents[each].endpoint is None):
        endpoint = f"tcp/127.0.0.1:{base + agent}"
        if base + agent > PORT_MAX:
            notes.append(
                f"zenoh.base_port: {base} + {agent} is no port, so agent {agent} has no endpoint unless `agentd launch`"
                f" starts it: set agents.{agent}.endpoint, or give it a smaller id"
            )
            return
        if (owner := owners.get(endpoint)) is not None:
            diagnostics.add(
                f"agents.{owner}.endpoint",
                f"{endpoint} is the default endpoint of agent {agent} (zenoh.base_port + id); each needs its own",
            )
