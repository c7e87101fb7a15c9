"""Endpoints of a fleet's agents: the Zenoh address at which each of them listens."""

import errno
import random
import re
import socket

from dcf_zenoh.errors import NetworkError
from dcf_zenoh.spec import FleetSpec

PORTS = range(20000, 32000)  # below the ports that operating systems give to outgoing connections


def free_endpoints(fleet: FleetSpec) -> dict[int, str]:
    """Choose an endpoint for every agent: that of the fleet file, or a free port of the loopback interface.

    Raises:
        NetworkError: There are not enough free ports, or an agent cannot listen at its endpoint of the fleet file.
    """
    given = {i: fleet.agents[i].endpoint for i in fleet.ids}
    for i, endpoint in given.items():
        if endpoint is not None and (reason := _taken(endpoint)):
            raise NetworkError(f"agents.{i}.endpoint: cannot listen on {endpoint}: {reason}")
    ports = filter(_is_free, random.sample(PORTS, len(PORTS)))
    candidates = (endpoint for port in ports if (endpoint := f"tcp/127.0.0.1:{port}") not in given.values())
    try:
        return {i: endpoint or next(candidates) for i, endpoint in given.items()}
    except StopIteration:
        raise NetworkError(f"no free port on the loopback interface between {PORTS.start} and {PORTS.stop}") from None


def default_endpoints(fleet: FleetSpec) -> dict[int, str]:
    """Return the endpoints of agents that no launcher has started: those of the fleet file, or ports by id."""
    return {i: fleet.agents[i].endpoint or f"tcp/127.0.0.1:{fleet.zenoh.base_port + i}" for i in fleet.ids}


def _taken(endpoint: str) -> str:
    """Return why no program of this machine can listen on a TCP endpoint now; empty if one can, or that is unknown."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = re.split("[?#]", rest)[0].rpartition(":")
    if protocol not in ("tcp", "tls", "ws"):
        return ""
    try:
        family, kind, number, _, address = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, number) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # of a run that has just ended
            probe.bind(address)
    except OSError as error:
        here = "; launch starts all agents on this machine" if error.errno == errno.EADDRNOTAVAIL else ""
        return f"{error.strerror}{here}"
    return ""


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
