"""Damaged, cut-off and hostile files: one sentence and small memory, or the rows as they were;
never a crash.
"""

import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lz4.frame
import mcap.writer
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, DataEnd, Footer, Header, MessageIndex, Metadata, Schema

from spoofbench.codec import ReadLimits, Writer, read, validate, write
from spoofbench.codec.channels import descriptor_set
from spoofbench.errors import FormatError, LimitError, SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.schema import KINDS
from spoofbench.table import Table

MAGIC = mcap.writer.MCAP0_MAGIC


@pytest.fixture(scope="module")
def small(drive: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recording]:
    """A file of a few chunks, with texts, a view for maps and metadata."""
    recording = drive(60)
    path = tmp_path_factory.mktemp("small") / "a.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("spoofbench.codec.writer.CHUNK_BYTES", 100_000)
        write(recording, path)
    return path, recording


@given(st.data())
@settings(deadline=None, max_examples=300)
def test_a_flipped_byte_is_an_error_or_changes_no_row(
    small: tuple[Path, Recording], data: st.DataObject
) -> None:
    path, recording = small
    content = bytearray(path.read_bytes())
    interesting = [
        *range(600),
        *range(len(content) - 600, len(content)),
    ]  # else most flips hit compressed rows
    at = data.draw(st.one_of(st.integers(0, len(content) - 1), st.sampled_from(interesting)))
    content[at] ^= data.draw(st.integers(1, 255))
    with tempfile.TemporaryDirectory() as folder:
        damaged = Path(folder) / "a.mcap"
        damaged.write_bytes(content)
        try:
            again = dict(read(damaged))
        except SpoofbenchError as error:
            assert_one_sentence(error)
        else:
            assert again == dict(recording)
        try:
            validate(damaged)
        except SpoofbenchError as error:
            assert_one_sentence(error)


def assert_one_sentence(error: SpoofbenchError) -> None:
    assert "\n" not in str(error)
    assert len(str(error)) < 400


def test_a_file_cut_anywhere_gives_its_complete_chunks_and_says_so(
    small: tuple[Path, Recording], tmp_path: Path
) -> None:
    path, recording = small
    content = path.read_bytes()
    counts = []
    for kept in [
        *range(8, 2000, 97),
        *range(2000, len(content), len(content) // 40),
        len(content) - 9,
        len(content) - 1,
    ]:
        (tmp_path / "a.mcap").write_bytes(content[:kept])
        again = read(tmp_path / "a.mcap")
        assert "the file has no end" in again.metadata["damage"]["truncated"]
        assert int(again.metadata["damage"]["lost_bytes"]) <= kept
        for topic, table in again.items():
            assert table == recording[topic].take(slice(0, len(table)))
        counts.append(sum(len(table) for table in again.values()))
        with pytest.raises(FormatError, match="cut off"):
            validate(tmp_path / "a.mcap")
    assert counts == sorted(counts)
    assert counts[-1] == sum(len(table) for table in recording.values())
    assert len(set(counts)) > 2


def test_an_unchunked_file_that_is_cut_gives_its_complete_messages(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = mcap.writer.Writer(stream, use_chunking=False)
        writer.start()
        schema = writer.register_schema(
            "spoofbench.schema.v1.Mag", "protobuf", descriptor_set(KINDS["mag"].message)
        )
        channel = writer.register_channel("/m/mag", "protobuf", schema)
        for time in range(100):
            writer.add_message(channel, time, struct.pack("<Bd", 9, time), time)
        cut = stream.tell() - 1
    (tmp_path / "a.mcap").write_bytes((tmp_path / "a.mcap").read_bytes()[:cut])
    assert read(tmp_path / "a.mcap")["/m/mag"]["field_x_ut"].tolist() == list(range(99))


@pytest.mark.parametrize(
    "content", [b"", b"x", MAGIC[:7], MAGIC, MAGIC + MAGIC, b"PK\x03\x04" * 10], ids=repr
)
def test_what_is_no_recording(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(FormatError):
        validate(tmp_path / "a.mcap")
    if content != MAGIC:  # the beginning of a file, cut off
        with pytest.raises(FormatError):
            read(tmp_path / "a.mcap")


def test_what_cannot_be_opened(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.mcap"):
        with pytest.raises(FormatError, match="cannot be read"):
            read(path)


def encoded(*records: Any) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


MAG = Schema(1, descriptor_set(KINDS["mag"].message), "protobuf", "spoofbench.schema.v1.Mag")
CHANNEL = Channel(1, "/m/mag", "protobuf", {}, 1)
ROW = struct.pack("<BQHIQQBd", 5, 31, 1, 0, 7, 7, 9, 2.5)


def mcap_file(path: Path, *records: Any, definitions: tuple[Any, ...] = (MAG, CHANNEL)) -> Path:
    """A file without summary around some records, or bytes."""
    body = b"".join(record if isinstance(record, bytes) else encoded(record) for record in records)
    path.write_bytes(
        MAGIC
        + encoded(Header("", "test"), *definitions)
        + body
        + encoded(DataEnd(0), Footer(0, 0, 0))
        + MAGIC
    )
    return path


def chunk(data: bytes, size: int, compression: str = "", crc: int = 0) -> Chunk:
    return Chunk(compression, data, 7, 7, crc, size)


def lz4_bomb() -> Chunk:
    return chunk(lz4.frame.compress(bytes(256 << 20), store_size=False), 1000, "lz4")


def zstd_bomb() -> Chunk:
    compressor = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    return chunk(
        b"".join(compressor.compress(bytes(1 << 20)) for _ in range(256)) + compressor.flush(),
        1000,
        "zstd",
    )


def zstd_frame(declared: int) -> bytes:
    return struct.pack("<IBQ", 0xFD2FB528, 0xE0, declared) + b"\x01\x00\x00"


HOSTILE: dict[str, tuple[Callable[[], Any], str]] = {
    "lz4 inflates": (lz4_bomb, "more than the 1000 bytes"),
    "zstd inflates": (zstd_bomb, "does not unpack"),
    "zstd declares 40 GB": (
        lambda: chunk(zstd_frame(40 * 10**9), 1000, "zstd"),
        "zstd frame 40000000000",
    ),
    "both declare 40 GB": (
        lambda: chunk(zstd_frame(40 * 10**9), 40 * 10**9, "zstd"),
        "40000000000",
    ),
    "both declare 100 MB": (lambda: chunk(zstd_frame(10**8), 10**8, "zstd"), "does not unpack"),
    "zstd is garbage": (lambda: chunk(b"garbage", 1000, "zstd"), "does not unpack"),
    "lz4 is garbage": (lambda: chunk(b"garbage", 1000, "lz4"), "does not unpack"),
    "lz4 is cut": (lambda: chunk(lz4.frame.compress(ROW)[:-9], len(ROW), "lz4"), "does not unpack"),
    "unknown compression": (lambda: chunk(ROW, len(ROW), "brotli"), "brotli"),
    "wrong checksum": (lambda: chunk(ROW, len(ROW), crc=5), "checksum"),
    "wrong size": (lambda: chunk(ROW, len(ROW) + 1), "does not unpack to the 41 bytes"),
    "record of 2**63 bytes": (
        lambda: struct.pack("<BQ", 0x06, 2**63) + bytes(99),
        "does not end within the file",
    ),
    "record of 2**64 - 9 bytes": (
        lambda: struct.pack("<BQ", 0x0C, 2**64 - 9) + bytes(99),
        "does not end within the file",
    ),
    "chunk without room for its head": (
        lambda: struct.pack("<BQ", 0x06, 10) + bytes(10),
        "only 10 bytes long",
    ),
    "chunk data beyond the chunk": (
        lambda: struct.pack("<BQQQQIIQ", 6, 40, 0, 0, 9, 0, 0, 2**63),
        "beyond its end",
    ),
    "chunk name beyond the chunk": (
        lambda: struct.pack("<BQQQQIIQ", 6, 40, 0, 0, 9, 0, 2**32 - 1, 0),
        "beyond its end",
    ),
    "message beyond the chunk": (
        lambda: chunk(ROW[:1] + struct.pack("<Q", 2**62) + ROW[9:], len(ROW)),
        "does not end within it",
    ),
    "message without a head": (lambda: chunk(struct.pack("<BQI", 5, 4, 0), 13), "too short"),
    "loose message without a head": (lambda: struct.pack("<BQI", 5, 4, 0), "too short"),
    "time after 2262": (
        lambda: chunk(ROW[:15] + struct.pack("<Q", 2**63) + ROW[23:], len(ROW)),
        "beyond the year 2262",
    ),
    "message of no channel": (
        lambda: chunk(ROW[:9] + b"\x09\x00" + ROW[11:], len(ROW)),
        "channel 9",
    ),
    "message is no protobuf": (
        lambda: chunk(struct.pack("<BQHIQQ", 5, 24, 1, 0, 7, 7) + b"\x09\x00", 33),
        "spoofbench.schema.v1.Mag",
    ),
    "text of 4 GB": (lambda: struct.pack("<BQI", 0x0C, 8, 2**32 - 1) + b"abcd", "is damaged"),
    "text is no text": (lambda: struct.pack("<BQI2sI", 0x0C, 10, 2, b"\xff\xff", 0), "is damaged"),
    "two channels of one id": (
        lambda: replace(CHANNEL, topic="/n/mag"),
        "two channels with the id 1",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_record_is_refused_in_one_sentence(name: str, tmp_path: Path) -> None:
    make, reason = HOSTILE[name]
    path = mcap_file(tmp_path / "a.mcap", make())
    for job in (lambda: dict(read(path)), lambda: validate(path)):
        with pytest.raises((FormatError, LimitError), match=reason) as caught:
            job()
        assert_one_sentence(caught.value)


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="ru_maxrss is in kilobytes on Linux alone"
)
@pytest.mark.parametrize(
    "name",
    [
        "lz4 inflates",
        "zstd inflates",
        "zstd declares 40 GB",
        "both declare 40 GB",
        "both declare 100 MB",
    ],
)
def test_a_bomb_takes_little_memory(name: str, tmp_path: Path) -> None:
    mcap_file(tmp_path / "warm.mcap", chunk(zstandard.compress(ROW), len(ROW), "zstd"))
    mcap_file(tmp_path / "bomb.mcap", HOSTILE[name][0]())
    script = """if True:
        import resource, sys
        from pathlib import Path
        from spoofbench.codec import read, validate
        from spoofbench.errors import FormatError, LimitError
        warm, bomb = map(Path, sys.argv[1:])
        dict(read(warm))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for job in (lambda: dict(read(bomb)), lambda: validate(bomb)):
            try:
                job()
            except (FormatError, LimitError):
                print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    """
    command = [sys.executable, "-c", script, tmp_path / "warm.mcap", tmp_path / "bomb.mcap"]
    grown_kb = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ).stdout
    assert len(grown_kb.split()) == 2
    assert max(map(int, grown_kb.split())) < 32 * 1024


def test_limits_are_kept(small: tuple[Path, Recording]) -> None:
    path, recording = small
    rows = len(recording["/imu0/imu"])
    for limits in (
        ReadLimits(chunk_bytes=1000),
        ReadLimits(total_bytes=500_000),
        ReadLimits(messages=rows - 1),
        ReadLimits(records=3),
        ReadLimits(text_bytes=100),
    ):
        with pytest.raises(LimitError) as caught:
            dict(read(path, limits))
        assert_one_sentence(caught.value)
        with pytest.raises(LimitError):
            validate(path, limits)


def test_messages_are_limited_where_no_statistics_count_them(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", chunk(ROW * 10, 10 * len(ROW)))
    assert len(read(path, ReadLimits(messages=10))["/m/mag"]) == 10
    for job in (lambda limits: dict(read(path, limits)), lambda limits: validate(path, limits)):
        with pytest.raises(LimitError):
            job(ReadLimits(messages=9))


def indexed(path: Path, index: MessageIndex) -> Path:
    return mcap_file(path, chunk(ROW * 3, 3 * len(ROW)), index)


@pytest.mark.parametrize(
    "index",
    [
        MessageIndex(1, [(7, 0), (7, 40)]),
        MessageIndex(1, [(7, 0), (7, 40), (7, 81)]),
        MessageIndex(1, [(7, 0), (7, 40), (7, 2**63)]),
        MessageIndex(1, [(7, 0), (7, 40), (7, 80), (7, 80)]),
        MessageIndex(1, [(7, 0), (8, 40), (7, 80)]),
        MessageIndex(2, [(7, 0), (7, 40), (7, 80)]),
        MessageIndex(1, [(7, 9), (7, 40), (7, 80)]),
    ],
    ids=repr,
)
def test_an_index_that_lies_hides_no_row_and_is_found_out(
    index: MessageIndex, tmp_path: Path
) -> None:
    path = indexed(tmp_path / "a.mcap", index)
    assert read(path)["/m/mag"]["field_x_ut"].tolist() == [2.5] * 3
    with pytest.raises(FormatError, match="message index"):
        validate(path)
    validate(indexed(tmp_path / "b.mcap", MessageIndex(1, [(7, 0), (7, 40), (7, 80)])))


def test_an_index_of_an_empty_chunk_hides_nothing_and_is_found_out(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", chunk(b"", 0), MessageIndex(1, [(7, 0)]))
    assert len(read(path)["/m/mag"]) == 0
    with pytest.raises(FormatError, match="message indexes are not those of its channels"):
        validate(path)


def test_a_chunk_that_an_index_hides_is_missed_by_the_statistics(tmp_path: Path) -> None:
    with Writer(tmp_path / "a.mcap", compression="none") as writer:
        writer.add("/m/mag", Table("mag", np.arange(10), {"field_x_ut": np.ones(10)}))
        writer.add("/n/mag", Table("mag", np.arange(10), {"field_x_ut": np.ones(10)}))
    content = (tmp_path / "a.mcap").read_bytes()
    second_index = content.index(struct.pack("<BQHI", 7, 6 + 160, 2, 160))
    (tmp_path / "a.mcap").write_bytes(
        content[: second_index + 9] + b"\x01" + content[second_index + 10 :]
    )
    with pytest.raises(FormatError, match="declares 10 messages of channel 2 and holds 0"):
        dict(read(tmp_path / "a.mcap"))


@pytest.mark.parametrize(
    "data",
    [b"", b"garbage", MAG.data[: len(MAG.data) // 2], MAG.data * 2],
    ids=["empty", "garbage", "cut", "twice"],
)
def test_a_schema_that_makes_no_sense_is_unread_or_harmless(data: bytes, tmp_path: Path) -> None:
    path = mcap_file(
        tmp_path / "a.mcap", chunk(ROW, len(ROW)), definitions=(replace(MAG, data=data), CHANNEL)
    )
    again = read(path)
    assert "/m/mag" in again.metadata.get("unread", {}) or again["/m/mag"][
        "field_x_ut"
    ].tolist() == [2.5]


def test_a_channel_without_its_schema_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="has no schema 1"):
        read(mcap_file(tmp_path / "a.mcap", definitions=(CHANNEL,)))


def test_validation_finds_what_reading_may_overlook(
    small: tuple[Path, Recording], tmp_path: Path
) -> None:
    content = small[0].read_bytes()

    def changed(old: bytes, new: bytes) -> Path:
        assert old in content
        (tmp_path / "a.mcap").write_bytes(content.replace(old, new, 1))
        return tmp_path / "a.mcap"

    metadata = encoded(Metadata("recording", {"clock": "recorder"}))
    with pytest.raises(FormatError, match="at byte"):
        validate(changed(metadata, b"\x0e" + metadata[1:]))
    with pytest.raises(FormatError, match="does not say where it is"):
        validate(changed(metadata, metadata.replace(b"recording", b"rec0rding")))
    with pytest.raises(FormatError, match="no header"):
        validate(changed(content[8:9], b"\x81"))
    begin = content.index(b"zstd") - 4 - 4 - 8 - 8 - 8
    with pytest.raises(FormatError, match="does not span"):
        validate(changed(content[begin : begin + 40], b"\x01" + content[begin + 1 : begin + 40]))


def test_records_within_chunks_and_channels_are_limited(tmp_path: Path) -> None:
    strange = (b"\x80" + bytes(8)) * 1000
    path = mcap_file(tmp_path / "strange.mcap", *[chunk(strange, len(strange))] * 3)
    with pytest.raises(LimitError, match="records where at most 2500 are allowed"):
        read(path, ReadLimits(records=2500))
    channels = [replace(CHANNEL, id=number, topic=f"/m{number}/mag") for number in range(1, 20)]
    path = mcap_file(tmp_path / "many.mcap", definitions=(MAG, *channels))
    with pytest.raises(LimitError, match="19 channels where at most 10 are allowed"):
        read(path, ReadLimits(channels=10))


def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource", reason="needs POSIX limits")
    signal = pytest.importorskip("signal")
    table = Table(
        "imu", np.arange(200_000), {"accel_x_mps2": np.random.default_rng(1).random(200_000)}
    )
    before, handler = (
        resource.getrlimit(resource.RLIMIT_FSIZE),
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN),
    )
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
        with pytest.raises(SpoofbenchError, match="cannot be written"):
            write(Recording({"/imu0/imu": table}), tmp_path / "full.mcap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_no_place_for_a_file() -> None:
    with pytest.raises(SpoofbenchError, match="name the file to write"):
        Writer(Path())
