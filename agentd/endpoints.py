"""Endpoints of a fleet's agents: the Zenoh address at which each of them listens."""

import random
import socket

from dcf_zenoh.errors import NetworkError
from dcf_zenoh.spec import FleetSpec

PORTS = range(20000, 32000)  # below the ports that operating systems give to outgoing connections


def free_endpoints(fleet: FleetSpec) -> dict[int, str]:
    """Choose an endpoint for every agent: that of the fleet file, or a free port of the loopback interface.

    Raises:
        NetworkError: There are not enough free ports.
    """
    given = {i: fleet.agents[i].endpoint for i in fleet.ids}
    ports = filter(_is_free, random.sample(PORTS, len(PORTS)))
    candidates = (endpoint for port in ports if (endpoint := f"tcp/127.0.0.1:{port}") not in given.values())
    try:
        return {i: endpoint or next(candidates) for i, endpoint in given.items()}
    except StopIteration:
        raise NetworkError(f"no free port on the loopback interface between {PORTS.start} and {PORTS.stop}") from None


def default_endpoints(fleet: FleetSpec) -> dict[int, str]:
    """Return the endpoints of agents that no launcher has started: those of the fleet file, or ports by id."""
    return {i: fleet.agents[i].endpoint or f"tcp/127.0.0.1:{fleet.zenoh.base_port + i}" for i in fleet.ids}


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
