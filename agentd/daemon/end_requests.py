"""Requests that end a flight, in the bytes of `agentd.daemon.operator_protocol`, without its imports."""

import msgpack

LAND: bytes = msgpack.packb({"do": "land"})
STOP: bytes = msgpack.packb({"do": "stop"})
TAKES_NONE = "takes no orders now: it has not started yet, or its run is over"  # the meaning of an empty answer


def error_in(answer: bytes) -> str:
    """Return why an agent has refused; empty if it has not."""
    if not answer:
        return TAKES_NONE
    try:
        return str(msgpack.unpackb(answer).get("error", ""))
    except (ValueError, AttributeError, msgpack.UnpackException) as error:
        return f"not an answer: {error}"
