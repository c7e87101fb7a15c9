"""Programs that are not part of a fleet."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh


@contextmanager
def bare_session(*endpoints: str) -> Iterator[zenoh.Session]:
    """Open a session outside of the fleet, with a direct link to some agents."""
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "connect/endpoints": list(endpoints),
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 20, "period_increase_factor": 1.0},
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    session = zenoh.open(config)
    try:
        yield session
    finally:
        session.close()  # type: ignore[no-untyped-call]
