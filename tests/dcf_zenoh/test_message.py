import math
from contextlib import suppress

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dcf_zenoh import message as wire
from dcf_zenoh.errors import MessageError
from dcf_zenoh.message import DTYPES, Last, Message, Payload, canonical, decode, encode

arrays = st.sampled_from(list(DTYPES.values())).flatmap(
    lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5))
)
numbers = st.integers(-(2**63), 2**64 - 1) | st.floats()
names = st.text(min_size=1, max_size=20)
payloads = st.dictionaries(names, arrays | numbers, max_size=5)
naturals = st.integers(0, 2**62)
messages = st.builds(
    Message,
    sender=naturals,
    incarnation=naturals,
    sequence=naturals,
    step=st.integers(-1, 2**62),
    round=naturals,
    sent=st.integers(-(2**62), 2**62),
    residuals=st.lists(st.floats(allow_nan=False), max_size=6).map(tuple),
    position=st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=3).map(tuple),
    stop_at=st.integers(-1, 2**31),
    arrived_hops=st.integers(-1, 100),
    promise=naturals,
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
        (tampered(sender=-1), "sender: expected an integer of at least 0, got -1"),
        (tampered(step=1.5), "step: expected an integer of at least -16, got 1.5"),
        (tampered(round=True), "round: expected an integer of at least 0, got True"),
        (tampered(residuals=[math.nan]), "residuals: expected floats"),
        (tampered(last=9), "last: expected 0 to 6, got 9"),
        (tampered(position=[1]), "position: expected finite floats"),
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
