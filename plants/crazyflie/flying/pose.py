"""Pose of a Crazyflie measured by an external system, forwarded from Zenoh to the drone."""

import json
import math
import re
import struct
import time
from typing import Any, NamedTuple

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import LOCALISATION, Link

DISTANCE_MAX = 1000.0  # m; farther, infinite and NaN coordinates are errors of the measuring system
POSITION, GENERIC, POSE = 0, 1, 8  # channels, and the type of the packet on the second


class Sample(NamedTuple):
    """Received pose: instant, monotonic clock, in s; position, in m, optionally followed by a quaternion x, y, z, w."""

    at: float
    values: tuple[float, ...]


class PoseFeed:
    """Subscriber of a key that forwards the newest pose to the drone's estimator.

    A pose is a JSON list: ``[x, y, z]``, in m, or ``[x, y, z, qx, qy, qz, qw]``. With positions alone the drone
    estimates its heading from its gyroscope only: then it must point along the x axis when its estimator is reset.

    Args:
        key: Zenoh key.
        endpoint: Zenoh endpoint to connect to; empty for Zenoh's default scouting.
    """

    def __init__(self, key: str, endpoint: str) -> None:
        self._key = key
        self._endpoint = endpoint
        self._session: Any = None
        self._newest: Sample | None = None  # replaced as a whole, by Zenoh's thread
        self._sent: Sample | None = None
        self._problem = ""

    def open(self) -> None:
        """Subscribe to the key.

        Raises:
            PlantError: The session cannot be opened, or the key is invalid.
        """
        import zenoh  # noqa: PLC0415 - most drones need no external pose

        config = zenoh.Config()
        try:
            if self._endpoint:
                config.insert_json5("connect/endpoints", json.dumps([self._endpoint]))
                config.insert_json5("scouting/multicast/enabled", "false")
                config.insert_json5("scouting/gossip/enabled", "false")
                config.insert_json5("listen/endpoints", "[]")
            self._session = zenoh.open(config)
            self._session.declare_subscriber(self._key, self._receive)
        except zenoh.ZError as error:
            plain = re.sub(r"\s*\bat \S+\.rs:\d+\.?", "", str(error))  # without positions in Zenoh's source
            raise PlantError(f"pose {self._key!r} at {self._endpoint or 'no endpoint'}: {plain}") from error

    @property
    def age(self) -> float:
        """Time since the last pose was received, in s; infinite before the first."""
        return math.inf if self._newest is None else time.monotonic() - self._newest.at

    @property
    def problem(self) -> str:
        """Reason why the last message was not a pose; empty if it was one."""
        return self._problem

    def forward(self, link: Link) -> None:
        """Send the newest pose to the drone, unless it has been sent already."""
        sample = self._newest
        if sample is None or sample is self._sent:
            return
        self._sent = sample
        if len(sample.values) == 3:
            link.send(LOCALISATION, POSITION, struct.pack("<3f", *sample.values))
        else:
            link.send(LOCALISATION, GENERIC, struct.pack("<B7f", POSE, *sample.values))

    def close(self) -> None:
        """Close the session."""
        if self._session is not None:
            self._session.close()
            self._session = None

    def _receive(self, sample: Any) -> None:
        try:
            self._newest, self._problem = Sample(time.monotonic(), decode(sample.payload.to_bytes())), ""
        except ValueError as error:
            self._problem = str(error)


def decode(payload: bytes) -> tuple[float, ...]:
    """Return the numbers of a pose, 3 or 7.

    Raises:
        ValueError: The payload is not a pose.
    """
    try:
        values = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"expected a JSON list of 3 or 7 numbers, not {payload[:40]!r}") from error
    numbers = isinstance(values, list) and all(type(value) in (int, float) for value in values)
    if not numbers or len(values) not in (3, 7) or not all(abs(value) <= DISTANCE_MAX for value in values):
        raise ValueError(f"expected a JSON list of 3 or 7 numbers within {DISTANCE_MAX:g} m, not {payload[:40]!r}")
    if len(values) == 7 and abs(math.hypot(*values[3:]) - 1) > 0.01:
        raise ValueError(f"expected a quaternion of length 1, not {values[3:]}")
    return tuple(float(value) for value in values)
