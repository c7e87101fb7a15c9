import math
import tracemalloc
from contextlib import suppress
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dcf_zenoh import message as wire
from dcf_zenoh.errors import MessageError, NumericalError
from dcf_zenoh.message import BOUNDS, BYTES_MAX, DTYPES, NEVER, Last, Message, Payload, canonical, decode, encode


def finite(dtype: np.dtype[Any]) -> dict[str, Any] | None:
    """Return the options of arrays whose real numbers are finite."""
    return {"allow_nan": False, "allow_infinity": False} if dtype.kind == "f" else None


def bounded(name: str) -> st.SearchStrategy[int]:
    """Return integers within the bounds of a field, the bounds themselves among them."""
    least, most, _ = BOUNDS[name]
    return st.sampled_from([int(least), int(most)]) | st.integers(int(least), int(most))


arrays = st.sampled_from(list(DTYPES.values())).flatmap(
    lambda dtype: hnp.arrays(
        dtype, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5), elements=finite(dtype)
    )
)
numbers = st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False)
names = st.text(min_size=1, max_size=20)
payloads = st.dictionaries(names, arrays | numbers, max_size=5)
messages = st.builds(
    Message,
    **{name: bounded(name) for name in Message._fields[:9]},
    residuals=st.lists(st.floats(0), max_size=6).map(tuple),
    position=st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=3).map(tuple),
    last=st.sampled_from(Last),
    payload=payloads.map(canonical),
)
PAYLOAD = canonical({"x": np.arange(3.0), "n": 2})
PLAIN = Message(1, 0, 7, 3, 2, 600, -1, 0, 0, Last.NO, (0.5, math.inf), (1.5, -2.0), PAYLOAD)


def same(a: Payload, b: Payload) -> bool:
    return list(a) == list(b) and all(
        type(a[k]) is type(b[k]) and np.array_equal(a[k], b[k], equal_nan=np.asarray(a[k]).dtype.kind == "f") for k in a
    )


@given(messages)
def test_decoding_is_the_inverse_of_encoding(message: Message) -> None:
    back = decode(encode(message))
    assert back[:-1] == message[:-1]
    assert same(back.payload, message.payload)


@given(messages, st.data())
def test_truncated_message_is_refused(message: Message, data: st.DataObject) -> None:
    whole = encode(message)
    with pytest.raises(MessageError):
        decode(whole[: data.draw(st.integers(0, len(whole) - 1))])


@given(messages, st.data())
def test_corrupted_message_is_refused_or_decoded_but_never_crashes(message: Message, data: st.DataObject) -> None:
    raw = bytearray(encode(message))
    raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    with suppress(MessageError):
        decode(bytes(raw))


@given(st.binary(max_size=200))
def test_foreign_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(MessageError):
        decode(data)


def tampered(**fields: object) -> bytes:
    header = dict(zip(Message._fields, PLAIN, strict=True)) | {"payload": {"x": 1.0}} | fields
    return bytes(msgpack.packb([wire.VERSION, *header.values()]))


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (msgpack.packb([99, 1, 2]), "version 99 is not spoken here; expected 1"),
        (msgpack.packb([True, *PLAIN[:-1], {}]), "version True is not spoken here; expected 1"),
        (msgpack.packb([1, 2]), "expected 13 fields after the version, got 1"),
        (msgpack.packb({"a": 1}), "expected a msgpack array, got dict"),
        (b"\xc1", "not a msgpack message"),
        (tampered(sender=-1), "sender: expected an integer of 0 to 9007199254740992, got -1"),
        (tampered(step=1.5), "step: expected an integer of -16 to 1099511627776, got 1.5"),
        (tampered(round=True), "round: expected an integer of 0 to 1099511627776, got True"),
        (tampered(residuals=[math.nan]), r"residuals: expected at most 4096 floats of 0 to inf, got \(nan,\)"),
        (tampered(last=9), "last: expected an integer of 0 to 6, got 9"),
        (tampered(position=[1]), "position: expected at most 16 finite floats of"),
        (tampered(payload=[1]), "payload: expected a map, got tuple"),
        (tampered(payload={"x": "text"}), r"payload 'x': expected a number or \(dtype, shape, bytes\)"),
        (tampered(payload={"x": ["<f16", [1], b"0" * 16]}), "payload 'x': dtype '<f16' is not accepted"),
        (tampered(payload={"x": ["O", [1], b"0" * 8]}), "payload 'x': dtype 'O' is not accepted"),
        (tampered(payload={"x": ["<f8", [2], b"0" * 8]}), r"its bytes do not fill shape \(2,\) of <f8"),
        (tampered(payload={"x": ["<f8", [-1], b"0" * 8]}), "is not a shape of at most 8 dimensions"),
        (tampered(payload={"": 1}), "payload name ''"),
    ],
)
def test_each_malformation_is_named(data: bytes, text: str) -> None:
    with pytest.raises(MessageError, match=text):
        decode(data)


def test_oversized_messages_are_refused_both_ways() -> None:
    with pytest.raises(MessageError, match="at most 4194304 are accepted"):
        decode(b"\x00" * (wire.BYTES_MAX + 1))
    with pytest.raises(MessageError, match="a payload of 5600000 bytes is too large; at most 4128768 can be sent"):
        canonical({"x": np.zeros(350_000), "y": np.zeros(350_000)})
    crowd = {f"{number:0100}": 0 for number in range(50_000)}  # the names alone
    with pytest.raises(MessageError, match="too large; at most 4194304 can be sent"):
        encode(PLAIN._replace(payload=crowd))
    with pytest.raises(MessageError, match="a payload of 5000 entries is too large; at most 4096 can be sent"):
        canonical(dict(list(crowd.items())[:5000]))


@given(payloads)
def test_canonical_payload_is_the_one_that_a_receiver_decodes(payload: dict[str, wire.Value]) -> None:
    own = canonical(payload)
    assert same(own, decode(encode(PLAIN._replace(payload=own))).payload)
    for value in own.values():
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable
            assert value.flags.c_contiguous


def test_canonical_payload_is_a_copy() -> None:
    x = np.arange(6.0).reshape(2, 3)
    own = canonical({"view": x[:, ::2], "scalar": np.float64(1.5), "big": np.array([1.0], dtype=">f8")})
    x[:] = 0
    np.testing.assert_array_equal(own["view"], [[0, 2], [3, 5]])
    assert own["scalar"] == 1.5
    assert np.asarray(own["big"]).dtype.str == "<f8"


@pytest.mark.parametrize(
    ("payload", "text"),
    [
        ({"x": [1.0]}, r"payload 'x': expected an array or a number, not list \[1.0\]"),
        ({"x": np.array(["a"])}, "payload 'x': dtype <U1 cannot be sent"),
        ({1: 1.0}, "payload name 1: expected a string"),
        ({"x": 2**70}, "payload 'x': expected an array or a number, not int"),
        ([1.0], "a payload is a mapping of names to arrays or numbers, not list"),
    ],
)
def test_value_that_cannot_be_sent_is_named(payload: object, text: str) -> None:
    with pytest.raises(MessageError, match=text):
        canonical(payload)  # type: ignore[arg-type]


def beyond(name: str) -> st.SearchStrategy[int]:
    """Return integers that msgpack can encode, beyond the bounds of a field, most of them near."""
    least, most, _ = BOUNDS[name]
    near = [int(least) - 1, int(most) + 1, 2**63, 2**64 - 1, -(2**63)]
    fits = [each for each in near if not least <= each <= most]
    above = st.integers(int(most) + 1, 2**64 - 1).filter(lambda value: (name, value) != ("step", NEVER))
    return st.sampled_from(fits) | above | st.integers(-(2**63), int(least) - 1)


@given(st.sampled_from(Message._fields[:10]), st.data())
def test_number_beyond_its_bounds_is_refused_by_name(name: str, data: st.DataObject) -> None:
    value = data.draw(beyond(name))
    with pytest.raises(MessageError, match=f"^{name}: expected an integer of .* got {value}$"):
        decode(tampered(**{name: value}))


@pytest.mark.parametrize("name", Message._fields[:10])
def test_number_at_its_bounds_is_accepted(name: str) -> None:
    for value in BOUNDS[name][:2]:
        assert getattr(decode(tampered(**{name: int(value)})), name) == value


def test_step_without_end_is_for_goodbyes_alone() -> None:
    assert decode(tampered(step=NEVER, last=int(Last.FAILED))).step == NEVER
    with pytest.raises(MessageError, match=r"step: .* is for goodbyes, not for a message with last = 1"):
        decode(tampered(step=NEVER, last=int(Last.OF_STEP)))


sides = st.sampled_from([0, 1, 2, 2**22, 2**31, 2**32, 2**62, 2**63, 2**64 - 1])


@given(st.sampled_from(sorted(DTYPES)), st.lists(sides, max_size=10), st.sampled_from([0, 1, 8, 16]))
def test_no_shape_raises_anything_but_a_refusal(code: str, shape: list[int], size: int) -> None:
    with suppress(MessageError):
        assert np.asarray(decode(tampered(payload={"x": [code, shape, b"\0" * size]})).payload["x"]).nbytes == size


def test_empty_array_of_a_huge_shape_is_refused_both_ways() -> None:
    with pytest.raises(MessageError, match=r"shape \(0, 9223372036854775808\) is too large, although it is empty"):
        decode(tampered(payload={"x": ["<f8", [0, 2**63], b""]}))
    with pytest.raises(MessageError, match=r"shape \(0, 1048576\) is too large, although it is empty"):
        canonical({"x": np.zeros((0, 2**20))})
    assert np.asarray(decode(tampered(payload={"x": ["<f8", [0, 5], b""]})).payload["x"]).shape == (0, 5)


NESTED = b"\x91" * 900 + b"\x00"  # one array within the other; its text would take as many calls


@pytest.mark.parametrize("place", range(1, 14))
def test_nested_values_are_refused_wherever_they_are(place: int) -> None:
    whole = bytearray(b"\x9e\x01")  # an array of 14
    for number, field in enumerate([*PLAIN[:-1], {}], start=1):
        whole += NESTED if number == place else msgpack.packb(field)
    with pytest.raises(MessageError):
        decode(bytes(whole))


@pytest.mark.parametrize("header", [b"\xdd\x00\x3f\xff\x00", b"\xdf\x00\x1f\xff\x00", b"\x91\xdd\x00\x30\x00\x00"])
def test_memory_is_not_allocated_by_the_lengths_in_a_message(header: bytes) -> None:
    data = header * (BYTES_MAX // 2 // len(header))  # arrays of four million, each the first item of the one before
    tracemalloc.start()
    try:
        with pytest.raises(MessageError):
            decode(data)
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()


@given(
    st.sampled_from(["<f8", "<f4"]),
    st.sampled_from([math.nan, math.inf, -math.inf]),
    st.integers(1, 200),
    st.data(),
)
def test_real_number_that_is_not_finite_is_refused_both_ways(
    code: str, value: float, count: int, data: st.DataObject
) -> None:
    place = data.draw(st.integers(0, count - 1))
    array = np.full(
        count, -1.7e308 if code == "<f8" else 3e38, code
    )  # the squares overflow: they are finite all the same
    whole = tampered(payload={"ok": ["<f8", [1], b"\0" * 8], "x": [code, [count], array.tobytes()]})
    assert same(decode(whole).payload, canonical({"ok": np.zeros(1), "x": array}))
    array[place] = value
    text = rf"^payload 'x' is not finite: {value} at \[{place}\]$"
    with pytest.raises(MessageError, match=text):
        decode(tampered(payload={"ok": 1.0, "x": [code, [count], array.tobytes()]}))
    with pytest.raises(NumericalError, match=text):
        canonical({"x": array})
    for single in (float(value), np.float64(value)):
        with pytest.raises(NumericalError, match=f"payload 'x' is not finite: {value}"):
            canonical({"x": single})
    with pytest.raises(MessageError, match=f"payload 'x' is not finite: {value}"):
        decode(tampered(payload={"x": value}))


def test_rows_of_tables_may_end_in_nan_and_in_nothing_else() -> None:
    nan, inf = math.nan, math.inf
    table = np.array([[1.0, 2.0, nan], [1.0, 2.0, 3.0]])
    for name in ("states", "riding.states.values"):
        assert same(decode(encode(PLAIN._replace(payload=canonical({name: table})))).payload, {name: table})
        for row in ([nan, 2.0, 3.0], [nan, nan, nan], [1.0, nan, 3.0], [1.0, 2.0, inf], [1.0, inf, nan]):
            bad = np.array([[1.0, 2.0, 3.0], row])
            with pytest.raises(NumericalError, match=f"payload '{name}' is not finite: .* at "):
                canonical({name: bad})
            with pytest.raises(MessageError, match=f"payload '{name}' is not finite: .* at "):
                decode(tampered(payload={name: ["<f8", [2, 3], bad.tobytes()]}))
    with pytest.raises(NumericalError, match=r"payload 'x' is not finite: nan at \[0, 2\]"):
        canonical({"x": table})
