"""The demultiplexer finds what a byte-by-byte scan finds, whatever the log holds and however it is
read.
"""

import io
import random
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.serial import framing
from spoofbench_converters.serial.demux import RTCM, demultiplex
from spoofbench_converters.serial.host_timestamps import HostTimestamps

Reject = tuple[int, int, str]


def taken_apart(
    log: bytes, checksum: Any = "required", piece_bytes: int = 2**20
) -> tuple[list[tuple[str, int, int]], list[Reject], int]:
    """Return frames, rejects (RTCM messages are frames too) and how many bytes are used."""
    found, rejects, used = [], [], 0
    for piece in demultiplex(
        io.BytesIO(log), HostTimestamps(zone_is_utc=False), checksum, piece_bytes
    ):
        for protocol, part in (("ubx", piece.ubx), ("nmea", piece.nmea)):
            found += [
                (protocol, o, o + n)
                for o, n in zip(
                    (part.starts + part.base).tolist(), part.lengths.tolist(), strict=True
                )
            ]
            used += int(part.used.sum())
        for reject in piece.rejects:
            rejects += [
                (o, n, reject.reason)
                for o, n in zip(reject.offsets.tolist(), reject.lengths.tolist(), strict=True)
            ]
    found += [("rtcm", o, o + n) for o, n, reason in rejects if reason == RTCM]
    return sorted(found, key=lambda frame: frame[1]), sorted(rejects), used


def fragments(make: Any) -> st.SearchStrategy[bytes]:
    """Valid frames, frames within frames, and what looks like frames."""
    text = st.text("ABCXYZ0189,.-", min_size=1, max_size=70).map(str.encode)
    payload = st.binary(max_size=60)
    sentence = st.builds(
        lambda body, start, end: make.sentence(b"GP" + body, start) + end,
        text,
        st.sampled_from([b"$", b"!"]),
        line_ends(),
    )
    valid = st.one_of(payload.map(make.ubx), sentence, payload.map(make.rtcm3))
    nested = st.one_of(
        valid.map(make.ubx), valid.map(make.rtcm3), valid.map(lambda inner: b"$GPGGA,1" + inner)
    )
    damaged = st.builds(
        changed, st.one_of(valid, nested), st.integers(0, 10**6), st.integers(1, 255)
    )
    cut = st.builds(lambda whole, share: whole[: int(len(whole) * share)], valid, st.floats(0, 1))
    noise = st.sampled_from(
        [
            b"\xb5\x62",
            b"\xb5",
            b"$",
            b"$$",
            b"!",
            b"*",
            b"\xd3\x00",
            b"\xd3",
            b"\r\n",
            b"# a comment\n",
            b"$GPRMC",
            b"NMEA,",
        ]
    )
    false_length = st.builds(
        lambda kind, length: b"\xb5\x62" + kind + length.to_bytes(2, "little"),
        st.binary(min_size=2, max_size=2),
        st.integers(0, 65535),
    )
    return st.one_of(
        valid,
        nested,
        damaged,
        cut,
        noise,
        noise.map(lambda part: part * 9),
        false_length,
        st.binary(max_size=40),
    )


def line_ends() -> st.SearchStrategy[bytes]:
    return st.sampled_from(
        [
            b"\r\n",
            b"\n",
            b"",
            b"\r",
            b"\n\n",
            b",1676559153000\n",
            b"\n,1676559153000\n",
            b",junk\n",
        ]
    )


def changed(frame: bytes, place: int, by: int) -> bytes:
    at = place % max(len(frame), 1)
    return frame[:at] + bytes([frame[at] ^ by]) + frame[at + 1 :] if frame else frame


@given(data=st.data(), checksum=st.sampled_from(["required", "missing-allowed", "ignored"]))
@settings(max_examples=150, deadline=None)
def test_the_same_frames_as_byte_by_byte(
    make: Any, slow: Any, data: st.DataObject, checksum: str
) -> None:
    log = b"".join(data.draw(st.lists(fragments(make), max_size=30)))
    assert taken_apart(log, checksum)[0] == slow.scan(log, checksum)


@given(data=st.data(), seed=st.integers(0, 2**32), piece_bytes=st.integers(20_000, 80_000))
@settings(max_examples=10, deadline=None)
def test_nothing_depends_on_the_size_of_pieces(
    make: Any, slow: Any, data: st.DataObject, seed: int, piece_bytes: int
) -> None:
    parts = data.draw(st.lists(fragments(make), min_size=5, max_size=20))
    chance = random.Random(seed)
    parts += [
        chance.randbytes(70_000),
        make.ubx(chance.randbytes(30_000)),
        b"x" * 70_000,
        b"# " + b"y" * 70_000 + b"\nz\n",
    ]
    log = b"".join(
        chance.choices(parts, [20] * (len(parts) - 4) + [1] * 4, k=chance.choice([20, 300]))
    )[:300_000]
    whole = taken_apart(log, piece_bytes=10**9)
    assert taken_apart(log, piece_bytes=piece_bytes) == whole
    assert whole[0] == slow.scan(log)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_every_byte_has_one_owner(make: Any, data: st.DataObject) -> None:
    log = b"".join(data.draw(st.lists(fragments(make), max_size=30)))
    owners = np.zeros(len(log), int)
    for piece in demultiplex(io.BytesIO(log), HostTimestamps(zone_is_utc=False)):
        parts = [(part.offsets(), part.used) for part in (piece.ubx, piece.nmea)] + [
            (part.offsets, part.lengths) for part in piece.rejects
        ]
        for offsets, lengths in parts:
            for offset, length in zip(offsets.tolist(), lengths.tolist(), strict=True):
                assert length > 0
                owners[offset : offset + length] += 1
    assert np.all(owners == 1)


@pytest.mark.parametrize(
    "pattern",
    [
        b"\xb5\x62",
        b"$",
        b"$A",
        b"$ABCD",
        b"\xd3",
        b"\xd3\x00",
        b"\xd3\x03",
        b"#\n",
        b"\n",
        b"*",
        b"\x00",
    ],
)
def test_a_flood_of_false_starts_costs_no_frame(make: Any, pattern: bytes) -> None:
    frame = make.ubx(b"behind the flood")
    found, _, _ = taken_apart(
        pattern * (500_000 // len(pattern)) + frame + make.sentence(b"GPTXT,too")
    )
    assert [end - start for _, start, end in found] == [len(frame), len("$GPTXT,too*hh")]


def test_a_message_that_ends_within_a_frame_frees_what_is_in_it(make: Any, slow: Any) -> None:
    """A message takes the head of a UBX frame, whose payload begins with the message's CRC; another
    message follows within the frame.
    """
    inner = make.rtcm3(b"inner")
    head = b"\xb5\x62\x01\x07" + (3 + len(inner)).to_bytes(2, "little")
    outer = make.rtcm3(b"outer" + head)
    frame = make.ubx(outer[-3:] + inner)
    assert frame.startswith(head + outer[-3:])
    log = outer + inner + frame[-2:] + make.ubx(b"another")
    found, _, _ = taken_apart(log)
    assert [(protocol, start) for protocol, start, _ in found] == [
        ("rtcm", 0),
        ("rtcm", len(outer)),
        ("ubx", len(outer + inner) + 2),
    ]
    assert found == slow.scan(log)


def test_the_longest_frame_is_found_and_a_longer_sentence_is_not(make: Any) -> None:
    longest, body = make.ubx(bytes(65_535)), b"GPTXT,".ljust(framing.MAX_SENTENCE - 2, b"x")
    log = longest + make.sentence(body) + b"\n" + make.sentence(body + b"x") + b"\n"
    assert [
        (protocol, end - start) for protocol, start, end in taken_apart(log, piece_bytes=1000)[0]
    ] == [
        ("ubx", 65_543),
        ("nmea", len(body) + 4),
    ]


def test_reasons_say_what_is_wrong(make: Any) -> None:
    sentence = make.sentence(b"GPGGA,123519,4807.038,N")
    parts = {
        b"# a header\n": "comment line",
        make.ubx(b"payload")[:-1] + b"\x00": "UBX frame with a wrong checksum",
        sentence[:-1] + b"?\r\n": "sentence with a wrong checksum",
        sentence[:-3] + b"\r\n": "sentence without a checksum",
        sentence[:12]: "sentence broken off",
        sentence + b"\r\n": "",
        b"\r\n \n": "blank or line end",
        sentence + b"\n": "",
        b"hello world\n": "text that is no sentence",
        make.rtcm3(b"message"): RTCM,
        b"\x00\x01\x02": "binary data that are no frame",
        make.ubx(b"whole"): "",
        make.ubx(b"payload")[:-3]: "UBX frame cut off at the end of the log",
    }
    _, rejects, _ = taken_apart(b"".join(parts))
    assert [reason for _, _, reason in rejects] == [reason for reason in parts.values() if reason]
    assert [length for _, length, _ in rejects] == [
        len(part) for part, reason in parts.items() if reason
    ]


def test_a_nested_sentence_costs_its_head_alone(make: Any) -> None:
    inner = make.sentence(b"SDVLW,0.0,N,0.0,N")
    found, rejects, _ = taken_apart(b"$SDV" + inner + b"\r\n$" + inner + b"\r\n")
    assert [start for _, start, _ in found] == [4, 4 + len(inner) + 3]
    assert [(offset, length) for offset, length, _ in rejects] == [(0, 4), (4 + len(inner) + 2, 1)]


TIME_NS = 1_676_559_153_000_000_000  # 2023-02-16T14:52:33Z


@pytest.mark.parametrize(
    ("before", "after", "time_ns"),
    [
        (b"NMEA,", b",1676559153000", TIME_NS),
        (b"", b",1676559153000", TIME_NS),
        (b"NMEA,", b"\n,1676559153000", TIME_NS),
        (b"NMEA,", b"\r\n,1676559153000", TIME_NS),
        (b"(1676559153) ", b"", TIME_NS),
        (b"(1676559153.25) ", b"", TIME_NS + 250_000_000),
        (b"1676559153.000000001,", b"", TIME_NS + 1),
        (b"1676559153000000 ", b"", TIME_NS),
        (b"1676559153000000007 ", b"", TIME_NS + 7),
        (b"2023-02-16T14:52:33Z ", b"", TIME_NS),
        (b"[2023-02-16 14:52:33.5 UTC]: ", b"", TIME_NS + 500_000_000),
        (b"2023-02-16T16:22:33,001+01:30;", b"", TIME_NS + 1_000_000),
        (b"2023-02-16T09:52:33.000-0500\t", b"", TIME_NS),
        (b"", b" 2023/02/16 14:52:33Z", TIME_NS),
        (b"\\s:station,c:1676559153*4E\\", b"", TIME_NS),
        (b"\\g:1-2-73874,n:157036*1F\\", b"", None),
        (b"NMEA,", b"", None),
        (b"", b" \t", None),
        (b"9999999999 ", b"", None),
        (b"2023-02-30T14:52:33Z ", b"", None),
        (b"2023-02-16T14:52:33 ", b"", None),
    ],
)
def test_times_beside_sentences(
    make: Any, before: bytes, after: bytes, time_ns: int | None
) -> None:
    lines = [before + make.sentence(b"GPTXT,%d" % number) + after + b"\r\n" for number in range(3)]
    (piece,) = demultiplex(io.BytesIO(b"".join(lines)), HostTimestamps(zone_is_utc=False))
    assert piece.nmea.used.tolist() == [len(line) for line in lines]
    assert (
        piece.nmea.receive_time_ns.tolist()
        == [np.iinfo(np.int64).min if time_ns is None else time_ns] * 3
    )


def test_times_without_a_zone_are_counted_or_taken_as_utc(make: Any) -> None:
    log = b"2023-02-16T14:52:33 " + make.sentence(b"GPTXT,a") + b"\n"
    left, taken = HostTimestamps(zone_is_utc=False), HostTimestamps(zone_is_utc=True)
    (ignored,), (used,) = demultiplex(io.BytesIO(log), left), demultiplex(io.BytesIO(log), taken)
    assert (left.without_zone, taken.without_zone) == (1, 0)
    assert ignored.nmea.receive_time_ns.tolist() == [np.iinfo(np.int64).min]
    assert used.nmea.receive_time_ns.tolist() == [TIME_NS]


@pytest.mark.parametrize(
    "before", [b"12:34:56 > ", b"\\s:station,c:1676559153*4F\\", b"1676559153000x "]
)
def test_other_text_before_a_sentence_is_not_used(make: Any, before: bytes) -> None:
    sentence = make.sentence(b"GPTXT,a") + b"\n"
    found, rejects, used = taken_apart(before + sentence)
    assert [start for _, start, _ in found] == [len(before)]
    assert (rejects, used) == ([(0, len(before), "text that is no sentence")], len(sentence))


@given(st.integers(86_400, 9_214_560_000), st.integers(0, 999_999), st.integers(-840, 840))
def test_iso_times_are_those_of_datetime(seconds: int, micro: int, ahead_min: int) -> None:
    zone = timezone(timedelta(minutes=ahead_min))
    time = datetime.fromtimestamp(0, zone) + timedelta(seconds=seconds, microseconds=micro)
    octets = np.frombuffer(f"{time:%Y-%m-%d %H:%M:%S.%f%z}".encode(), np.uint8)
    understood, times = HostTimestamps(zone_is_utc=False).before(
        octets, np.array([0]), np.array([octets.size])
    )
    assert understood.all()
    assert times.tolist() == [seconds * 10**9 + micro * 1000]
