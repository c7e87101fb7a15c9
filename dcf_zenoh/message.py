"""Messages between agents, and their encoding as bytes.

A message is one msgpack array: the version number, then the fields of `Message` in their order. Arrays in a payload are
encoded as ``[dtype, shape, bytes]`` with a dtype from `DTYPES`, C order, little endian. Nothing is unpickled.

`BOUNDS` is the table of what each field may be. Whatever is beyond is refused where the bytes are read; no memory is
allocated in proportion to a number in a message. The payload is finite: real numbers are neither NaN nor infinite,
except that rows of tables of states (`may_be_padded`) may end in NaN.
"""

from collections.abc import Mapping
from enum import IntEnum
from math import inf, isfinite, prod
from sys import float_info
from types import MappingProxyType
from typing import Any, NamedTuple, NoReturn, TypeAlias

import msgpack
import numpy as np
import numpy.typing as npt

from dcf_zenoh.errors import MessageError, NumericalError

VERSION = 1
BYTES_MAX = 4 * 1024 * 1024
PAYLOAD_MAX = BYTES_MAX - 64 * 1024  # room for the header and the names
NAME_MAX = 128
DIMENSIONS_MAX = 8
ITEMS_MAX = 4096  # residuals, and entries of a payload
STEPS_BEFORE = 16  # step numbers below 0, for dialogues before the start
NUMBERS_BEFORE = 2**20  # sequence numbers below 0, for their messages
NEVER = 2**62  # fleet time, ns: later than any run; also the step of a goodbye after a failure
LATEST = 2**61  # fleet time of sending, ns; a delay on top of it is still before `NEVER`
PLACE_MAX = 2**40  # steps, rounds


class FieldBounds(NamedTuple):
    """Bounds of a field that is an integer; of one that is a tuple of floats, bounds of each of them.

    Attributes:
        least: Smallest value.
        most: Largest value.
        length: Largest number of floats; 0 for an integer.
    """

    least: float
    most: float
    length: int = 0


BOUNDS: Mapping[str, FieldBounds] = MappingProxyType(
    {
        "sender": FieldBounds(0, 2**53),
        "incarnation": FieldBounds(0, 2**20),
        "sequence": FieldBounds(-NUMBERS_BEFORE, 2**53),
        "step": FieldBounds(-STEPS_BEFORE, PLACE_MAX),  # or NEVER, in a goodbye
        "round": FieldBounds(0, PLACE_MAX),
        "sent": FieldBounds(-LATEST, LATEST),
        "stop_at": FieldBounds(-1, 2 * PLACE_MAX),
        "arrived_hops": FieldBounds(-1, PLACE_MAX),
        "promise": FieldBounds(0, NEVER),
        "last": FieldBounds(0, 6),
        "residuals": FieldBounds(0, inf, ITEMS_MAX),
        "position": FieldBounds(-float_info.max, float_info.max, 16),
    }
)
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


_LENGTH = 1 + len(Message._fields)  # of a message on the wire: the version comes first
_LAST = tuple(Last)
_REAL = frozenset(np.dtype(code) for code in ("<f8", "<f4"))
_FINITE = float_info.max
_F8 = np.dtype("<f8")
_new = tuple.__new__
_from_bytes = int.from_bytes
_SHORT = 512  # bytes


def _masks(count: int) -> tuple[int, int, int]:
    """Return masks for `count` numbers of 64 bits, each as one integer: exponents, their lowest bits, and signs.

    The exponent of a number that is not finite has all bits set: adding its lowest bit carries into the sign.
    """
    words = 0x7FF0_0000_0000_0000, 0x0010_0000_0000_0000, 0x8000_0000_0000_0000
    exponents, one, signs = [int.from_bytes(word.to_bytes(8, "little") * count, "little") for word in words]
    return exponents, one, signs


_MASKS = [_masks(count) for count in range(_SHORT // 8 + 1)]
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
    if dtype in _REAL and not _all_finite(value) and (text := _not_finite(name, value)):
        raise NumericalError(text)
    if not value.size and _volume(value.shape, dtype) > PAYLOAD_MAX:
        raise MessageError(f"payload {name!r}: shape {value.shape} is too large, although it is empty")
    return value


def _all_finite(array: npt.NDArray[Any]) -> bool:
    """Return whether a contiguous array of real numbers is finite; false too if the sum of its squares overflows."""
    if array.nbytes <= _SHORT and array.dtype is _F8:
        return _finite_bytes(array.tobytes())
    flat = array if array.ndim == 1 else array.ravel()
    with np.errstate(all="ignore"):
        return isfinite(flat.dot(flat))


def _finite_bytes(raw: bytes) -> bool:
    """Return whether the numbers of float64 in `raw` are finite; false too if the sum of their squares overflows."""
    if len(raw) > _SHORT:
        return _all_finite(np.frombuffer(raw))
    exponents, one, signs = _MASKS[len(raw) >> 3]  # 0.4 µs less than with numpy (CPython 3.11)
    return not ((_from_bytes(raw, "little") & exponents) + one) & signs


def may_be_padded(name: str) -> bool:
    """Return whether an entry of this name is a table of states, whose rows may end in NaN (`controllers.padding`)."""
    return name == "states" or name.startswith("riding.")


def _not_finite(name: str, array: npt.NDArray[Any]) -> str:
    """Describe the first number of a payload entry that is not finite; empty if there is none, apart from padding."""
    bad = ~np.isfinite(array)
    if array.ndim == 2 and may_be_padded(name):
        padding = np.isnan(array)[:, ::-1].cumprod(axis=1)[:, ::-1].astype(bool)
        padding[:, :1] = False  # a row has a first number
        bad &= ~padding
    if not bad.any():
        return ""
    place = np.argwhere(bad)[0].tolist()
    return f"payload {name!r} is not finite: {array[tuple(place)]} at {place}"


def not_finite(payload: Payload) -> str:
    """Describe the first number of a payload that is neither finite nor padding; empty if there is none."""
    for name, value in payload.items():
        if isinstance(value, np.ndarray):
            text = _not_finite(name, value) if value.dtype.kind == "f" and not _all_finite(value) else ""
        else:
            text = "" if value - value == 0 else f"payload {name!r} is not finite: {value}"
        if text:
            return text
    return ""


def _volume(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    """Return the bytes of an array of this shape if sides of length 0 had length 1: numpy limits these, too."""
    return prod(side or 1 for side in shape) * dtype.itemsize


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
        MessageError: A name is not a short string, or a value is neither an array of a known dtype nor a number; or
            there are too many entries or bytes.
        NumericalError: A value is NaN or infinite.
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
            if value - value != 0.0:
                raise NumericalError(f"payload {name!r} is not finite: {value}")
            copy[name] = float(value)
        elif isinstance(value, int) and -(2**63) <= value < 2**64:
            copy[name] = value
        else:
            raise MessageError(
                f"payload {name!r}: expected an array or a number, not {type(value).__name__} {value!r:.40}"
            )
    if len(copy) > ITEMS_MAX:
        raise MessageError(f"a payload of {len(copy)} entries is too large; at most {ITEMS_MAX} can be sent")
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
        MessageError: `data` is not a whole, well-formed message of this version, or a field is out of its bounds.
    """
    if len(data) > BYTES_MAX:
        raise MessageError(f"{len(data)} bytes are too many for a message; at most {BYTES_MAX} are accepted")
    try:  # lengths are limited: the decoder allocates an array of the length that its header states
        fields = msgpack.unpackb(data, use_list=False, max_array_len=ITEMS_MAX, max_map_len=ITEMS_MAX)
    except (ValueError, TypeError, OverflowError, msgpack.UnpackException, RecursionError) as error:
        raise MessageError(f"not a msgpack message: {type(error).__name__} {error!s:.100}") from error
    if type(fields) is not tuple or len(fields) != _LENGTH:
        _refuse(fields)
    (
        version, sender, incarnation, sequence, step, round, sent, stop_at, arrived_hops, promise,
        last, residuals, position, payload,
    ) = fields  # fmt: skip
    if not (  # `BOUNDS`, as one expression of literals: a loop over it takes 2 µs more per message (CPython 3.11)
        type(version) is int and version == 1
        and type(sender) is int and 0 <= sender <= 0x20_0000_0000_0000
        and type(incarnation) is int and 0 <= incarnation <= 0x10_0000
        and type(sequence) is int and -0x10_0000 <= sequence <= 0x20_0000_0000_0000
        and type(step) is int and (-16 <= step <= 0x100_0000_0000 or step == NEVER)
        and type(round) is int and 0 <= round <= 0x100_0000_0000
        and type(sent) is int and -0x2000_0000_0000_0000 <= sent <= 0x2000_0000_0000_0000
        and type(stop_at) is int and -1 <= stop_at <= 0x200_0000_0000
        and type(arrived_hops) is int and -1 <= arrived_hops <= 0x100_0000_0000
        and type(promise) is int and 0 <= promise <= 0x4000_0000_0000_0000
        and type(last) is int and 0 <= last <= 6 and (step != NEVER or last >= 3)
        and type(residuals) is tuple and _floats(residuals, 0.0, inf)
        and type(position) is tuple and len(position) <= 16 and _floats(position, -_FINITE, _FINITE)
        and type(payload) is dict
    ):  # fmt: skip
        _refuse(fields)
    parts = []  # bytes of real numbers
    for name, value in payload.items():
        if type(value) is tuple:
            array = payload[name] = _array(name, value)
            if array.dtype is _F8:
                parts.append(value[2])
            elif array.dtype.kind == "f" and (text := not_finite({name: array})):
                raise MessageError(text)
        elif not isinstance(value, float | int) or value - value != 0:
            _refuse_number(name, value)
        elif type(name) is not str or not 0 < len(name) <= NAME_MAX:
            _refuse_name(name)
    if parts:
        raw = parts[0] if len(parts) == 1 else b"".join(parts)
        if not _finite_bytes(raw) and (text := not_finite(payload)):
            raise MessageError(text)
    return _new(
        Message,
        (
            sender, incarnation, sequence, step, round, sent, stop_at, arrived_hops, promise, _LAST[last], residuals,
            position, MappingProxyType(payload),
        ),
    )  # fmt: skip


def _refuse(fields: Any) -> NoReturn:
    """Raise the error that describes why `fields` are no message.

    Raises:
        MessageError: Always.
    """
    if type(fields) is not tuple or not fields:
        raise MessageError(f"expected a msgpack array, got {type(fields).__name__}")
    if type(fields[0]) is not int or fields[0] != VERSION:
        raise MessageError(f"version {shown(fields[0])} is not spoken here; expected {VERSION}")
    if len(fields) != _LENGTH:
        raise MessageError(f"expected {_LENGTH - 1} fields after the version, got {len(fields) - 1}")
    named = dict(zip(Message._fields, fields[1:], strict=True))
    for name, (least, most, length) in BOUNDS.items():
        value = named[name]
        if length:
            if type(value) is not tuple or len(value) > length or not _floats(value, least, most):
                what = "finite floats" if least < 0 else "floats"
                raise MessageError(
                    f"{name}: expected at most {length} {what} of {least:g} to {most:g}, got {_listed(value)}"
                )
        elif type(value) is not int or not least <= value <= most:
            if name == "step" and type(value) is int and value == NEVER:
                continue
            raise MessageError(f"{name}: expected an integer of {least} to {most}, got {shown(value)}")
    if named["step"] == NEVER and named["last"] < GOODBYE:
        raise MessageError(f"step: {NEVER} is for goodbyes, not for a message with last = {named['last']}")
    raise MessageError(f"payload: expected a map, got {type(named['payload']).__name__}")


def shown(value: object) -> str:
    """Return a short description of a decoded value: numbers and texts themselves, types of all else."""
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str | bytes):
        return repr(value[:40])
    return type(value).__name__


def _listed(values: object) -> str:
    """Return a short description of what should be a tuple of numbers."""
    if type(values) is not tuple:
        return shown(values)
    return f"({', '.join(map(shown, values[:4]))}{',' * (len(values) == 1)}{', ...' * (len(values) > 4)})"


def _floats(values: tuple[object, ...], least: float, most: float) -> bool:
    """Return whether all values are floats within the bounds; NaN is not."""
    for value in values:  # noqa: SIM110 - all() takes 0.2 µs more, twice per message (CPython 3.11)
        if type(value) is not float or not least <= value <= most:
            return False
    return True


def _refuse_name(name: object) -> NoReturn:
    raise MessageError(f"payload name {shown(name)}: expected a string of 1 to {NAME_MAX} characters")


def _refuse_number(name: object, value: object) -> NoReturn:
    """Raise the error that describes why `value` is no number of a payload.

    Raises:
        MessageError: Always.
    """
    if type(name) is not str or not 0 < len(name) <= NAME_MAX:
        _refuse_name(name)
    if isinstance(value, float):
        raise MessageError(f"payload {name!r} is not finite: {value}")
    raise MessageError(f"payload {name!r}: expected a number or (dtype, shape, bytes), got {shown(value)}")


def _array(name: object, value: tuple[Any, ...]) -> npt.NDArray[Any]:
    """Return one array of a payload, checked and decoded.

    Raises:
        MessageError: The value is not an array that can be sent, or the name is not allowed.
    """
    if type(name) is not str or not 0 < len(name) <= NAME_MAX:
        _refuse_name(name)
    if len(value) != 3:
        raise MessageError(
            f"payload {name!r}: expected a number or (dtype, shape, bytes), got an array of {len(value)} values"
        )
    code, shape, raw = value
    dtype = DTYPES.get(code) if type(code) is str else None
    if dtype is None:
        raise MessageError(f"payload {name!r}: dtype {shown(code)} is not accepted; allowed: {', '.join(DTYPES)}")
    if type(shape) is not tuple or len(shape) > DIMENSIONS_MAX:
        raise MessageError(f"payload {name!r}: {_listed(shape)} is not a shape of at most {DIMENSIONS_MAX} dimensions")
    size = dtype.itemsize
    for side in shape:
        if type(side) is not int or side < 0:
            raise MessageError(
                f"payload {name!r}: {_listed(shape)} is not a shape of at most {DIMENSIONS_MAX} dimensions"
            )
        size *= side
    if type(raw) is not bytes or len(raw) != size:
        raise MessageError(f"payload {name!r}: its bytes do not fill shape {_listed(shape)} of {code}")
    if not size and _volume(shape, dtype) > PAYLOAD_MAX:
        raise MessageError(f"payload {name!r}: shape {_listed(shape)} is too large, although it is empty")
    return np.ndarray(shape, dtype, raw)
