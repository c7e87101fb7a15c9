"""Address of an agent on the network: prefix of its keys, endpoints, and the settings of its Zenoh session."""

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import zenoh

from dcf_zenoh.errors import NetworkError


@dataclass(frozen=True)
class Address:
    """Address of an agent on the network.

    Attributes:
        prefix: Start of all keys, ``dcf/<fleet>/<run>``.
        listen: Endpoint on which the agent listens; empty: no other agent connects to it.
        connect: Endpoints to which it connects.
        settings: Zenoh configuration keys as paths, with their values; they override those set here.
        send_timeout: Longest wait for room on the way to one neighbour, s; then that link is given up.
        lease: Silence after which a neighbour gives its link to this agent up, s. Zenoh itself sends at least four
            times as often.
        lossy: Whether messages of rounds may be lost, where an endpoint is one of UDP.
    """

    prefix: str
    listen: str
    connect: tuple[str, ...]
    settings: Mapping[str, Any]
    send_timeout: float = 5.0
    lease: float = 10.0
    lossy: bool = True

    @property
    def over_udp(self) -> bool:
        """Whether there is a link over UDP, next to one over TCP."""
        return any(len(_links(endpoint)) > 1 for endpoint in (self.listen, *self.connect))

    def config(self) -> zenoh.Config:
        """Return the session's configuration: direct links by explicit endpoints, no scouting of any kind.

        Raises:
            NetworkError: Zenoh does not accept one of the settings.
        """
        config = zenoh.Config()
        for key, value in self.entries().items():
            _set(config, key, value)
        return config

    def entries(self) -> dict[str, Any]:
        """Return the configuration of the session as keys, which are paths, with their values."""
        defaults: dict[str, Any] = {
            "mode": "peer",
            "listen/endpoints": _links(self.listen) if self.listen else [],
            "connect/endpoints": [link for endpoint in self.connect for link in _links(endpoint)],
            "connect/retry": {"period_init_ms": 20, "period_max_ms": 200, "period_increase_factor": 1.5},
            "open/return_conditions": {"connect_scouted": False, "declares": False},
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "transport/link/tx/lease": round(self.lease * 1e3),
            "transport/link/tx/queue/congestion_control/block/wait_before_close": round(self.send_timeout * 1e6),
            "transport/shared_memory/enabled": False,  # a killed process would leave a file in /dev/shm
        }
        if self.over_udp:
            defaults["transport/unicast/max_links"] = 2
            for side in ("open", "accept"):  # ms; what is lost while a link is being opened is not sent again
                defaults[f"transport/unicast/{side}_timeout"] = 1000
        return {**defaults, **self.settings}


def prefix_of(fleet: str, run: str) -> str:
    """Return the start of all keys of a run; characters of its name that no key may have become underscores."""
    return f"dcf/{fleet}/{re.sub('[*$#?/]', '_', run)}"


def _links(endpoint: str) -> list[str]:
    """Return the Zenoh endpoints of the links that an endpoint stands for; one with metadata stands for itself."""
    protocol, _, rest = endpoint.partition("/")
    if protocol != "udp" or "?" in rest:
        return [endpoint]
    address, hash_, options = rest.partition("#")
    return [f"tcp/{address}?rel=1{hash_}{options}", f"udp/{address}?rel=0{hash_}{options}"]


def check_settings(settings: Mapping[str, Any]) -> None:
    """Check the settings of a fleet file against a configuration of Zenoh.

    Raises:
        NetworkError: Zenoh does not accept one of them.
    """
    config = zenoh.Config()
    for key, value in settings.items():
        _set(config, key, value)


def _set(config: zenoh.Config, key: str, value: Any) -> None:
    try:
        config.insert_json5(key, json.dumps(value))
    except (zenoh.ZError, TypeError) as error:
        raise NetworkError(f"zenoh.settings.{key}: Zenoh does not accept {value!r}: {plain_text(error)}") from error


def plain_text(error: Exception) -> str:
    """Return the text of an error of Zenoh, without the places in its source."""
    return re.sub(r"\s*\bat \S+\.rs:\d+\.?|[\[\]]", "", str(error)).strip(" .")


def endpoints_to_connect(agent: int, linked: Iterable[int], endpoints: Mapping[int, str]) -> tuple[str, ...]:
    """Return the endpoints to which `agent` connects: of two neighbours the one with the higher id connects."""
    return tuple(endpoints[j] for j in linked if j < agent)
