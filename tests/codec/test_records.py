"""Records are found one after the other, by indexes, and again behind damage."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from spoofbench.codec.records import (
    MESSAGE,
    RECORD,
    indexed_starts,
    is_plausible,
    record_starts,
    surviving_records,
)

CHANNEL_ID = 3


def message(data: bytes) -> bytes:
    head = np.zeros(1, MESSAGE)
    head["opcode"], head["channel"] = Opcode.MESSAGE, CHANNEL_ID
    head["length"] = MESSAGE.itemsize - RECORD.size + len(data)
    return head.tobytes() + data


def octets(data: bytes) -> Any:
    return np.frombuffer(data, np.uint8)


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 40), st.integers(1, 200))))
def test_a_walk_finds_every_record_however_often_it_repeats(
    runs: list[tuple[int, int, int]],
) -> None:
    data, starts = b"", []
    for opcode, length, times in runs:
        for _ in range(times):
            starts.append(len(data))
            data += RECORD.pack(opcode, length) + bytes(length)
    found, end = record_starts(octets(data), 0, len(data))
    assert (found.tolist(), end) == (starts, len(data))
    believed, stop = record_starts(octets(data), 0, len(data), only_plausible=True)
    count = 0
    while count < len(starts) and is_plausible(*RECORD.unpack_from(data, starts[count])):
        count += 1
    assert believed.tolist() == starts[:count]
    assert stop == (starts[count] if count < len(starts) else len(data))


def test_a_walk_ends_before_a_record_that_is_cut_off() -> None:
    data = message(b"a") * 20 + message(b"abc")[:-1]
    found, end = record_starts(octets(data), 0, len(data))
    assert (found.size, end) == (20, 20 * len(message(b"a")))


SIZES = (5, 0, 700, 5)
STARTS = np.cumsum([0, *(MESSAGE.itemsize + size for size in SIZES[:-1])]).astype(np.uint64)


def test_an_index_is_believed_where_it_names_all_messages_and_nothing_else() -> None:
    records = octets(b"".join(message(bytes(size)) for size in SIZES))
    found = indexed_starts(records, [STARTS])
    assert found is not None
    assert found.tolist() == STARTS.tolist()
    by_channel = indexed_starts(records, [STARTS[1::2], STARTS[::2]])
    assert by_channel is not None
    assert by_channel.tolist() == STARTS.tolist()


@pytest.mark.parametrize(
    "offsets",
    [
        [],
        [STARTS[:0]],
        [STARTS[:-1]],
        [STARTS[1:]],
        [STARTS[::-1]],
        [STARTS, STARTS[1:2]],
        [np.append(STARTS, np.uint64(2**64 - 1))],
        [STARTS + np.uint64(1)],
    ],
    ids=repr,
)
def test_an_index_that_lies_is_not_believed(offsets: Any) -> None:
    assert indexed_starts(octets(b"".join(message(bytes(n)) for n in SIZES)), offsets) is None
    assert indexed_starts(octets(b"\x05"), offsets) is None
    assert indexed_starts(octets(b""), offsets) is None


@given(st.integers(0, 9), st.binary(min_size=1, max_size=60))
def test_messages_behind_damage_are_found(first: int, damage: bytes) -> None:
    before, after = message(b"before") * first, message(b"the message after") * 5
    data = before + b"\xff" + damage + after
    starts, gaps = surviving_records(octets(data), {CHANNEL_ID})
    found = [data[start : start + len(message(b"the message after"))] for start in starts]
    assert found.count(message(b"the message after")) >= 4
    assert starts[:first].tolist() == [i * len(message(b"before")) for i in range(first)]
    assert gaps >= 1


def test_no_damage_is_no_gap() -> None:
    assert surviving_records(octets(message(b"x") * 30), set())[1] == 0
