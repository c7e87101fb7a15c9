"""Messages between agents, and their encoding as bytes.

A message is one msgpack array: the version number, then the fields of `Message` in their order. Arrays in a payload are
encoded as ``[dtype, shape, bytes]`` with a dtype from `DTYPES`, C order, little endian. Nothing is unpickled.
"""

from collections.abc import Mapping
from enum import IntEnum
from math import inf
from sys import float_info
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn, TypeAlias

import msgpack
import numpy as np
import numpy.typing as npt

from dcf_zenoh.errors import MessageError

VERSION = 1
BYTES_MAX = 4 * 1024 * 1024
PAYLOAD_MAX = BYTES_MAX - 64 * 1024  # room for the header and the names
NAME_MAX = 128
DIMENSIONS_MAX = 8
STEPS_BEFORE = 16  # step numbers below 0, for dialogues before the start
NUMBERS_BEFORE = 2**20  # sequence numbers below 0, for their messages
EARLIEST = -(2**62)  # fleet time, ns
DTYPES = {
    code: np.dtype(code) for code in ("<f8", "<f4", "<i8", "<i4", "<i2", "|i1", "|u1", "<u2", "<u4", "<u8", "|b1")
}
_SENDABLE = {each: dtype for dtype in DTYPES.values() for each in (dtype, dtype.newbyteorder(">"))}

Value: TypeAlias = npt.NDArray[Any] | float | int
Payload: TypeAlias = Mapping[str, Value]
# id of an array -> the array, kept alive so that its id stays its own, and its copy
Copies: TypeAlias = dict[int, tuple[npt.NDArray[Any], npt.NDArray[Any]]]


class Last(IntEnum):
    """Whether the sender sends more after this message."""

    NO = 0
    OF_STEP = 1  # nothing more in this control step: receivers do not wait for the sender
    AWAY = 2  # nothing before the message's step: in virtual time, for runners alone, never seen by the model
    DONE = 3  # the sender has run to its planned end
    ARRIVED = 4  # the sender has found that the whole fleet has arrived
    LANDED = 5  # the sender has ended its flight early, after an alarm
    FAILED = 6  # the sender stops because of an error


GOODBYE = Last.DONE  # this and all above it: the sender's last message of the run


class Message(NamedTuple):
    """Message from one agent to one or all of its out-neighbours.

    Attributes:
        sender: Id of the sender.
        incarnation: Number of restarts of the sender in this run.
        sequence: Number of the message in this incarnation; the edge messages of one round share a number. Below 0
            before the start, so that the random numbers of faults do not depend on how many messages that takes.
        step: Control step k; below 0 before the start, one number for each phase.
        round: Round p within the step.
        sent: Fleet time of sending, in ns since the start.
        stop_at: Round after which the sender leaves this step, or -1 while that is open.
        arrived_hops: Number of hops around the sender within which all agents have arrived, as of this step; -1: the
            sender, or an agent that it has received from, has not.
        promise: Fleet time before which the sender will send nothing more, in ns (asynchronous mode); else 0.
        last: Whether more follows.
        residuals: Entry d is the largest residual within d hops of the sender, d rounds ago.
        position: Position of the sender, in m; empty unless a fault or a safety rule of the fleet needs it.
        payload: Names to arrays or numbers; read-only, as several receivers may share it.
    """

    sender: int
    incarnation: int
    sequence: int
    step: int
    round: int
    sent: int
    stop_at: int
    arrived_hops: int
    promise: int
    last: Last
    residuals: tuple[float, ...]
    position: tuple[float, ...]
    payload: Payload


_NUMBERS = Message._fields[:10]
_LEAST = (0, 0, -NUMBERS_BEFORE, -STEPS_BEFORE, 0, EARLIEST, -1, -1, 0, 0)  # of `_NUMBERS`
_LENGTH = 1 + len(Message._fields)  # of a message on the wire: the version comes first
_LAST = tuple(Last)
_FINITE = float_info.max
_pack = msgpack.Packer().pack


def _canonical_array(name: str, value: npt.NDArray[Any]) -> npt.NDArray[Any]:
    dtype = _SENDABLE.get(value.dtype)
    if dtype is None:
        raise MessageError(f"payload {name!r}: dtype {value.dtype} cannot be sent; allowed: {', '.join(DTYPES)}")
    if value.ndim > DIMENSIONS_MAX:
        raise MessageError(f"payload {name!r}: {value.ndim} dimensions, at most {DIMENSIONS_MAX} can be sent")
    flags = value.flags
    if flags.writeable or not (flags.owndata and flags.c_contiguous and value.dtype == dtype):
        value = np.array(value, dtype, order="C")
        value.setflags(write=False)
    return value


def _shared_copy(name: str, value: npt.NDArray[Any], shared: Copies) -> npt.NDArray[Any]:
    """Return the canonical copy of an array, made once."""
    entry = shared.get(id(value))
    if entry is None:
        entry = shared[id(value)] = value, _canonical_array(name, value)
    return entry[1]


def canonical(payload: Payload, shared: Copies | None = None) -> Payload:
    """Return a private copy of `payload`, exactly as a receiver decodes it: read-only contiguous arrays, plain numbers.

    Arrays that are read-only, contiguous and own their data are not copied. The sender and its receivers all use the
    canonical payload, so no result depends on memory layout and no algorithm can change what it has sent.

    Args:
        payload: Names to arrays or numbers.
        shared: Copies made for other neighbours; added to. An array that goes to several neighbours is copied once.

    Raises:
        MessageError: A name is not a short string, or a value is neither an array of a known dtype nor a number.
    """
    if not isinstance(payload, Mapping):
        raise MessageError(f"a payload is a mapping of names to arrays or numbers, not {type(payload).__name__}")
    copy: dict[str, Value] = {}
    size = 0
    for name, value in payload.items():
        if not isinstance(name, str) or not 0 < len(name) <= NAME_MAX:
            raise MessageError(f"payload name {name!r}: expected a string of 1 to {NAME_MAX} characters")
        if isinstance(value, np.ndarray):
            copy[name] = array = _canonical_array(name, value) if shared is None else _shared_copy(name, value, shared)
            size += array.nbytes
        elif isinstance(value, np.generic):
            copy.update(canonical({name: value.item()}))
        elif isinstance(value, float):
            copy[name] = float(value)
        elif isinstance(value, int) and -(2**63) <= value < 2**64:
            copy[name] = value
        else:
            raise MessageError(
                f"payload {name!r}: expected an array or a number, not {type(value).__name__} {value!r:.40}"
            )
    if size > PAYLOAD_MAX:
        raise MessageError(f"a payload of {size} bytes is too large; at most {PAYLOAD_MAX} can be sent")
    return MappingProxyType(copy)


def encode(message: Message, sent: int | None = None) -> bytes:
    """Encode `message` as bytes.

    Args:
        message: A message with a canonical payload.
        sent: Fleet time of sending, in place of the message's; None: the message's.

    Raises:
        MessageError: The message is larger than `BYTES_MAX`.
    """
    payload = {
        name: (value.dtype.str, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value
        for name, value in message.payload.items()
    }
    stamp = message.sent if sent is None else sent
    data: bytes = _pack((VERSION, *message[:5], stamp, *message[6:-1], payload))
    if len(data) > BYTES_MAX:
        raise MessageError(f"a message of {len(data)} bytes is too large; at most {BYTES_MAX} can be sent")
    return data


def decode(data: bytes) -> Message:
    """Decode a message.

    Raises:
        MessageError: `data` is not a whole, well-formed message of this version.
    """
    if len(data) > BYTES_MAX:
        raise MessageError(f"{len(data)} bytes are too many for a message; at most {BYTES_MAX} are accepted")
    try:
        fields = msgpack.unpackb(data, use_list=False)
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        raise MessageError(f"not a msgpack message: {type(error).__name__} {error}") from error
    if type(fields) is not tuple or len(fields) != _LENGTH:
        _refuse(fields)
    (
        version, sender, incarnation, sequence, step, round, sent, stop_at, arrived_hops, promise,
        last, residuals, position, payload,
    ) = fields  # fmt: skip
    if not (  # one expression: a loop over a table takes 0.6 µs more per message (CPython 3.11)
        type(version) is int and version == VERSION
        and type(sender) is int and sender >= 0
        and type(incarnation) is int and incarnation >= 0
        and type(sequence) is int and sequence >= -NUMBERS_BEFORE
        and type(step) is int and step >= -STEPS_BEFORE
        and type(round) is int and round >= 0
        and type(sent) is int and sent >= EARLIEST
        and type(stop_at) is int and stop_at >= -1
        and type(arrived_hops) is int and arrived_hops >= -1
        and type(promise) is int and promise >= 0
        and type(last) is int and 0 <= last < len(_LAST)
        and type(residuals) is tuple and _floats(residuals, inf)
        and type(position) is tuple and _floats(position, _FINITE)
        and type(payload) is dict
    ):  # fmt: skip
        _refuse(fields)
    entries = MappingProxyType({name: _value(name, value) for name, value in payload.items()})
    return Message(
        sender, incarnation, sequence, step, round, sent, stop_at, arrived_hops, promise, _LAST[last], residuals,
        position, entries,
    )  # fmt: skip


def _refuse(fields: Any) -> NoReturn:
    """Raise the error that describes why `fields` are no message.

    Raises:
        MessageError: Always.
    """
    if type(fields) is not tuple or not fields:
        raise MessageError(f"expected a msgpack array, got {type(fields).__name__}")
    if type(fields[0]) is not int or fields[0] != VERSION:
        raise MessageError(f"version {fields[0]!r:.20} is not spoken here; expected {VERSION}")
    if len(fields) != _LENGTH:
        raise MessageError(f"expected {_LENGTH - 1} fields after the version, got {len(fields) - 1}")
    *numbers, residuals, position, payload = fields[1:]
    for name, least, value in zip(_NUMBERS, _LEAST, numbers, strict=True):
        if type(value) is not int or value < least:
            raise MessageError(f"{name}: expected an integer of at least {least}, got {value!r:.40}")
    if numbers[-1] >= len(_LAST):
        raise MessageError(f"last: expected 0 to {len(_LAST) - 1}, got {numbers[-1]}")
    if type(residuals) is not tuple or not _floats(residuals, inf):
        raise MessageError(f"residuals: expected floats, got {residuals!r:.60}")
    if type(position) is not tuple or not _floats(position, _FINITE):
        raise MessageError(f"position: expected finite floats, got {position!r:.60}")
    raise MessageError(f"payload: expected a map, got {type(payload).__name__}")


def _floats(values: tuple[object, ...], most: float) -> bool:
    """Return whether all values are floats of at most `most` in magnitude; NaN is none."""
    for value in values:  # noqa: SIM110 - all() takes 0.2 µs more, twice per message (CPython 3.11)
        if type(value) is not float or not -most <= value <= most:
            return False
    return True


def _value(name: object, value: object) -> Value:
    """Return one payload entry, checked and decoded."""
    if type(name) is not str or not 0 < len(name) <= NAME_MAX:
        raise MessageError(f"payload name {name!r:.40}: expected a string of 1 to {NAME_MAX} characters")
    if type(value) is tuple and len(value) == 3:
        code, shape, raw = value
        dtype = DTYPES.get(code) if type(code) is str else None
        if dtype is None:
            raise MessageError(f"payload {name!r}: dtype {code!r:.20} is not accepted; allowed: {', '.join(DTYPES)}")
        if type(shape) is not tuple or len(shape) > DIMENSIONS_MAX:
            raise MessageError(f"payload {name!r}: {shape!r:.40} is not a shape of at most {DIMENSIONS_MAX} dimensions")
        size = dtype.itemsize
        for side in shape:
            if type(side) is not int or side < 0:
                raise MessageError(
                    f"payload {name!r}: {shape!r:.40} is not a shape of at most {DIMENSIONS_MAX} dimensions"
                )
            size *= side
        if type(raw) is not bytes or len(raw) != size:
            raise MessageError(f"payload {name!r}: its bytes do not fill shape {shape} of {code}")
        return np.ndarray(shape, dtype, raw)
    if isinstance(value, float | int):
        return value
    raise MessageError(f"payload {name!r}: expected a number or (dtype, shape, bytes), got {value!r:.40}")
