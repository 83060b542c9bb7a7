"""Every field of every message equals what rosbags' own deserialiser says."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from spoofbench_converters.rosbag import definitions, layouts

from spoofbench.errors import ConversionError

_INNER = "uint8 a\nfloat64 b\n"
_OUTER = (
    "bool flag\nchar letter\nint16 short\nstring name\nfloat32[3] three\nuint64 big\nfloat64[] "
    "many\nint8 tail\n"
    "Inner[] inners\nInner[2] pair\nstring[] words\nuint32 last\n"
)
TYPES = {
    **definitions.parse(_INNER, "test/msg/Inner"),
    **definitions.parse(_OUTER, "test/msg/Outer"),
}
STORE = get_typestore(Stores.EMPTY)
STORE.register(TYPES)

INNERS = st.builds(
    STORE.types["test/msg/Inner"], a=st.integers(0, 255), b=st.floats(allow_nan=False)
)
WORDS = st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=9)
OUTERS = st.builds(
    STORE.types["test/msg/Outer"],
    flag=st.booleans(),
    letter=st.integers(0, 255),
    short=st.integers(-(2**15), 2**15 - 1),
    name=WORDS,
    three=st.lists(st.floats(width=32, allow_nan=False), min_size=3, max_size=3).map(
        lambda values: np.array(values, np.float32)
    ),
    big=st.integers(0, 2**64 - 1),
    many=st.lists(st.floats(allow_nan=False), max_size=4).map(np.array),
    tail=st.integers(-128, 127),
    inners=st.lists(INNERS, max_size=3),
    pair=st.lists(INNERS, min_size=2, max_size=2),
    words=st.lists(WORDS, max_size=3),
    last=st.integers(0, 2**32 - 1),
)


def decode(
    messages: list[bytes], name: str = "test/msg/Outer"
) -> tuple[list[dict[str, Any] | None], list[tuple[int, str]]]:
    lengths = np.array([len(message) for message in messages])
    groups, failures = layouts.Decoder(name, TYPES).decode(
        np.frombuffer(b"".join(messages), np.uint8), np.cumsum(lengths) - lengths, lengths
    )
    rows: list[dict[str, Any] | None] = [None] * len(messages)
    for group in groups:
        for place, row in zip(group.index.tolist(), group.rows, strict=True):
            assert rows[place] is None
            rows[place] = {name: row[name] for name in group.rows.dtype.names or ()}
    return rows, failures


def flat(message: Any, prefix: str = "") -> dict[str, Any]:
    """Return a rosbags message's fields by dotted path."""
    if hasattr(message, "__dataclass_fields__"):
        names = [name for name in message.__dataclass_fields__ if not name.startswith("__")]
        return {
            path: value
            for name in names
            for path, value in flat(getattr(message, name), f"{prefix}{name}.").items()
        }
    if isinstance(message, list):
        return {
            path: value
            for i, item in enumerate(message)
            for path, value in flat(item, f"{prefix}{i}.").items()
        }
    return {prefix[:-1]: message}


@given(st.lists(st.tuples(OUTERS, st.booleans()), min_size=1, max_size=30))
@settings(max_examples=60, deadline=None)
def test_equals_rosbags(drawn: list[tuple[Any, bool]]) -> None:
    messages = [
        bytes(STORE.serialize_cdr(message, "test/msg/Outer", little_endian=little))
        for message, little in drawn
    ]
    rows, failures = decode(messages)
    assert not failures
    for message, row in zip(messages, rows, strict=True):
        assert row is not None
        for path, value in flat(STORE.deserialize_cdr(message, "test/msg/Outer")).items():
            if isinstance(value, str):
                assert row[path].decode() == value
            elif np.size(value):
                assert np.array_equal(row[path], value), path


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_arbitrary_bytes_are_decoded_or_refused(junk: bytes) -> None:
    rows, failures = decode([b"\x00\x01\x00\x00" + junk])
    assert (rows[0] is None) == (len(failures) == 1)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda message: message[:-4], "shorter than its definition"),
        (lambda message: message + bytes(8), "longer than its definition"),
        (lambda message: b"\x00\x07" + message[2:], "not plain CDR"),
        (
            lambda message: message[:8] + b"\xff\xff\xff\x7f" + message[12:],
            "longer than the message",
        ),
    ],
)
def test_a_damaged_message_is_refused_alone(damage: Any, reason: str) -> None:
    message = STORE.types["test/msg/Outer"](
        flag=True, letter=1, short=2, name="abc", three=np.zeros(3, np.float32), big=3,
        many=np.zeros(2), tail=4, inners=[],
        pair=[STORE.types["test/msg/Inner"](a=1, b=2.0)] * 2, words=["x"], last=5,
    )  # fmt: skip
    good = bytes(STORE.serialize_cdr(message, "test/msg/Outer"))
    rows, failures = decode([good, damage(good), good])
    assert [place for place, _ in failures] == [1]
    assert reason in failures[0][1]
    assert rows[0] is not None
    assert rows[2] is not None


def test_a_text_that_is_no_definition_is_one_sentence() -> None:
    with pytest.raises(ConversionError, match="cannot be parsed"):
        definitions.parse("float64 = = nonsense [", "test/msg/Broken")
