"""Files of other writers, with other layouts, are read to equal columns."""

import tempfile
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import mcap.writer
import mcap_protobuf.writer
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from mcap_protobuf.schema import register_schema

from spoofbench.codec import read, validate
from spoofbench.codec.channels import descriptor_set
from spoofbench.recording import Recording
from spoofbench.schema import KINDS
from spoofbench.table import Table

Rows = Iterator[tuple[int, str, Any]]
INTEGERS = (
    "INT32",
    "INT64",
    "UINT32",
    "UINT64",
    "SINT32",
    "SINT64",
    "FIXED32",
    "FIXED64",
    "SFIXED32",
    "SFIXED64",
)


def our_messages(topic: str, table: Table) -> Rows:
    """A table's rows as messages of our own schema."""
    message_class = GetMessageClass(table.kind.message)
    words = {name: table.texts(name) for name in table if table.column(name).categories is not None}
    for row, time in enumerate(table.time_ns.tolist()):
        given = {
            name: words[name][row] if name in words else table[name][row].item()
            for name in table
            if table.valid(name)[row]
        }
        yield time, topic, message_class(**given)


def by_time(*topics: Rows) -> list[tuple[int, str, Any]]:
    return sorted((row for rows in topics for row in rows), key=lambda row: row[0])


def save(path: Path, rows: Sequence[tuple[int, str, Any]], **options: Any) -> Path:
    """Write messages as the mcap library does, one channel per topic and message type."""
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, **options)
        writer.start()
        schemas: dict[str, int] = {}
        channels: dict[tuple[str, str], int] = {}
        for time, topic, message in rows:
            name = message.DESCRIPTOR.full_name
            if name not in schemas:
                schemas[name] = register_schema(writer, type(message))
            if (topic, name) not in channels:
                channels[topic, name] = writer.register_channel(topic, "protobuf", schemas[name])
            writer.add_message(channels[topic, name], time, message.SerializeToString(), time)
        writer.finish()
    return path


_files = count()


def message_class(name: str, *fields: tuple[str, int, str] | tuple[str, int, str, str]) -> Any:
    """A proto3 message type of fields (name, number, type); a fourth word, "optional" or a oneof's
    name, gives presence.
    """
    package, _, short = name.rpartition(".")
    message = DescriptorProto(name=short)
    for field_name, number, kind, *presence in fields:
        field = message.field.add(
            name=field_name,
            number=number,
            type=getattr(FieldDescriptorProto, f"TYPE_{kind}"),
            label=1,
        )
        if presence:
            group = f"_{field_name}" if presence == ["optional"] else presence[0]
            names = [oneof.name for oneof in message.oneof_decl]
            field.proto3_optional = presence == ["optional"]
            field.oneof_index = names.index(group) if group in names else len(names)
            if group not in names:
                message.oneof_decl.add(name=group)
    pool = DescriptorPool()
    pool.Add(
        FileDescriptorProto(
            name=f"file{next(_files)}.proto",
            package=package,
            syntax="proto3",
            message_type=[message],
        )
    )
    return GetMessageClass(pool.FindMessageTypeByName(name))


LAYOUTS: dict[str, dict[str, Any]] = {
    "as usual": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "small chunks": {"chunk_size": 3000},
    "one chunk": {"chunk_size": 1 << 30},
    "unchunked": {"use_chunking": False},
    "no indexes": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False},
    "no summary": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
    "channels not repeated": {"repeat_channels": False, "repeat_schemas": False},
    "no checksums": {"enable_crcs": False},
    "checksum of the data": {"enable_data_crcs": True},
}


@pytest.mark.parametrize("options", LAYOUTS.values(), ids=LAYOUTS)
def test_interleaved_channels_of_the_mcap_library(
    drive: Any, tmp_path: Path, options: dict[str, Any]
) -> None:
    recording: Recording = drive(20)
    path = save(
        tmp_path / "a.mcap",
        by_time(*(our_messages(topic, table) for topic, table in recording.items())),
        **options,
    )
    validate(path)
    again = read(path)
    assert dict(again) == dict(recording)
    assert again.metadata == {}


def test_the_protobuf_writer_with_metadata_and_an_attachment(drive: Any, tmp_path: Path) -> None:
    recording: Recording = drive(5)
    with (tmp_path / "a.mcap").open("wb") as stream, mcap_protobuf.writer.Writer(stream) as writer:
        writer.add_metadata("source/imu0", {"axes": "frd"})
        for time, topic, message in our_messages("/imu0/imu", recording["/imu0/imu"]):
            writer.write_message(topic, message, time, time)
        writer.add_attachment(1, 2, "note.txt", "text/plain", b"hello")
    validate(tmp_path / "a.mcap")
    again = read(tmp_path / "a.mcap")
    assert dict(again) == {"/imu0/imu": recording["/imu0/imu"]}
    assert again.metadata == {"source/imu0": {"axes": "frd"}}


def test_the_foxglove_sdk(drive: Any, tmp_path: Path) -> None:
    foxglove = pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    recording: Recording = drive(20)
    with foxglove.open_mcap(str(tmp_path / "a.mcap")):
        channels = {}
        for topic, table in recording.items():
            schema = foxglove.Schema(
                name=table.kind.message.full_name,
                encoding="protobuf",
                data=descriptor_set(table.kind.message),
            )
            channels[topic] = foxglove.Channel(topic, schema=schema, message_encoding="protobuf")
        for time, topic, message in by_time(
            *(our_messages(topic, table) for topic, table in recording.items())
        ):
            channels[topic].log(message.SerializeToString(), log_time=time)
        for channel in channels.values():
            channel.close()
    validate(tmp_path / "a.mcap")
    assert dict(read(tmp_path / "a.mcap")) == dict(recording)


def test_zeros_that_a_writer_without_presence_drops_are_zeros(
    officially_read: Any, tmp_path: Path
) -> None:
    imu = message_class(
        "spoofbench.schema.v1.Imu",
        ("accel_x_mps2", 1, "DOUBLE"),
        ("accel_y_mps2", 2, "DOUBLE", "optional"),
    )
    rows = [
        (
            time,
            "/imu0/imu",
            imu(accel_x_mps2=time % 3, **({"accel_y_mps2": 0.0} if time % 2 else {})),
        )
        for time in range(300)
    ]
    path = save(tmp_path / "a.mcap", rows)
    table = read(path)["/imu0/imu"]
    assert table == officially_read(path, "/imu0/imu")
    assert table["accel_x_mps2"].tolist() == [float(time % 3) for time in range(300)]
    assert table.valid("accel_y_mps2").tolist() == [time % 2 == 1 for time in range(300)]


@given(st.data())
@settings(deadline=None, max_examples=150)
def test_any_numbering_types_and_presence_of_fields(
    officially_read: Any, data: st.DataObject
) -> None:
    """Renumbered fields, other scalar types, unknown fields, absence and dropped zeros, by layout
    and by the official decoder.
    """
    fields = {
        "constellation": INTEGERS,
        "svid": ("UINT32", "UINT64", "FIXED32"),
        "signal": ("STRING",),
    }
    fields |= {
        "pseudorange_m": ("DOUBLE", "FLOAT", *INTEGERS),
        "cn0_dbhz": ("FLOAT",),
        "frequency_slot": INTEGERS,
        "receive_time_ns": INTEGERS,
    }
    fields |= {"used": ("BOOL",), "note": ("STRING", "BYTES"), "weight": ("DOUBLE", "SINT64")}
    numbers = data.draw(st.permutations([1, 2, 3, 15, 16, 17, 2047, 2048, 100_000, 4]))
    declared = []
    for (name, kinds), number in zip(fields.items(), numbers, strict=True):
        presence = data.draw(st.sampled_from([(), ("optional",), ("optional",)]))
        declared.append((name, number, data.draw(st.sampled_from(kinds)), *presence))
    observation = message_class("someone.Observation", *declared)
    small = st.sampled_from([0, 1, 2, 100, 127, 128, 300, 2**31 - 1])
    pool = data.draw(
        st.lists(
            st.tuples(*(st.one_of(st.none(), small) for _ in declared)), min_size=1, max_size=12
        )
    )
    rows = []
    for time in range(data.draw(st.integers(1, 120))):
        picked = pool[time * 7 % len(pool)]
        given = {}
        for (name, _, kind, *_), value in zip(declared, picked, strict=True):
            if value is not None:
                given[name] = (
                    "x" * (value % 5)
                    if kind == "STRING"
                    else b"x" * (value % 5)
                    if kind == "BYTES"
                    else value
                )
        given = {name: bool(value) if name == "used" else value for name, value in given.items()}
        rows.append((time, "/gnss0/gnss/observation", observation(**given)))
    with tempfile.TemporaryDirectory() as folder:
        path = save(Path(folder) / "a.mcap", rows)
        validate(path)
        assert read(path)["/gnss0/gnss/observation"] == officially_read(
            path, "/gnss0/gnss/observation"
        )


def test_negative_numbers_in_variable_width(officially_read: Any, tmp_path: Path) -> None:
    observation = message_class(
        "someone.Observation",
        ("frequency_slot", 1, "INT32"),
        ("receive_time_ns", 2, "SINT64"),
        ("constellation", 3, "INT64"),
    )
    rows = [
        (
            time,
            "/a/gnss/observation",
            observation(
                frequency_slot=-time, receive_time_ns=-(2**62) + time, constellation=time - 5
            ),
        )
        for time in range(400)
    ]
    path = save(tmp_path / "a.mcap", rows)
    assert read(path)["/a/gnss/observation"] == officially_read(path, "/a/gnss/observation")
    assert read(path)["/a/gnss/observation"]["frequency_slot"].tolist() == [
        -time for time in range(400)
    ]


def test_a_number_that_looks_like_the_next_tag(officially_read: Any, tmp_path: Path) -> None:
    """Both messages take five bytes, and the second byte of the one's long number is the tag of the
    other's second field.
    """
    observation = message_class(
        "someone.Observation", ("frequency_slot", 1, "INT32"), ("receive_time_ns", 2, "INT64")
    )
    short_long, long_short = (
        {"frequency_slot": 5, "receive_time_ns": 300},
        {"frequency_slot": 0x10 << 7 | 5, "receive_time_ns": 3},
    )
    rows = [
        (time, "/a/gnss/observation", observation(**(long_short if time % 3 else short_long)))
        for time in range(100)
    ]
    path = save(tmp_path / "a.mcap", rows)
    assert read(path)["/a/gnss/observation"] == officially_read(path, "/a/gnss/observation")


def test_the_last_member_of_a_oneof_counts(officially_read: Any, tmp_path: Path) -> None:
    baro = message_class(
        "someone.Baro",
        ("pressure_pa", 1, "DOUBLE", "one"),
        ("temperature_degc", 2, "DOUBLE", "one"),
    )
    both = (
        baro(pressure_pa=1.0).SerializeToString() + baro(temperature_degc=2.0).SerializeToString()
    )
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start()
        channel = writer.register_channel("/a/baro", "protobuf", register_schema(writer, baro))
        for time in range(100):
            writer.add_message(channel, time, both, time)
        writer.finish()
    table = read(tmp_path / "a.mcap")["/a/baro"]
    assert table == officially_read(tmp_path / "a.mcap", "/a/baro")
    assert not table.has("pressure_pa")


def test_repeated_fields_of_one_message_take_the_last_value(tmp_path: Path) -> None:
    baro = GetMessageClass(KINDS["baro"].message)
    twice = (
        baro(pressure_pa=1.0).SerializeToString()
        + baro(pressure_pa=2.0, temperature_degc=0.0).SerializeToString()
    )
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start()
        channel = writer.register_channel("/a/baro", "protobuf", register_schema(writer, baro))
        for time in range(100):
            writer.add_message(channel, time, twice, time)
        writer.finish()
    assert set(read(tmp_path / "a.mcap")["/a/baro"]["pressure_pa"].tolist()) == {2.0}


def test_messages_of_a_million_unknown_fields(tmp_path: Path) -> None:
    baro = GetMessageClass(KINDS["baro"].message)
    crowded = baro(pressure_pa=1.0).SerializeToString() + b"\x38\x01" * 1_000_000
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start()
        channel = writer.register_channel("/a/baro", "protobuf", register_schema(writer, baro))
        for time in range(3):
            writer.add_message(channel, time, crowded, time)
        writer.finish()
    assert read(tmp_path / "a.mcap")["/a/baro"]["pressure_pa"].tolist() == [1.0] * 3


def test_rows_out_of_order_come_in_the_order_of_time(tmp_path: Path) -> None:
    mag = GetMessageClass(KINDS["mag"].message)
    times = np.random.default_rng(3).integers(0, 50, 500).tolist()
    rows = [(time, "/m/mag", mag(field_x_ut=number)) for number, time in enumerate(times)]
    table = read(save(tmp_path / "a.mcap", rows, chunk_size=2000))["/m/mag"]
    assert table.time_ns.tolist() == sorted(times)
    assert table["field_x_ut"].tolist() == np.argsort(times, kind="stable").tolist()


def test_two_channels_of_one_topic_are_one_table_in_file_order(tmp_path: Path) -> None:
    ours, theirs = (
        GetMessageClass(KINDS["gnss/rf"].message),
        message_class("someone.Rf", ("band", 7, "STRING"), ("agc", 3, "FLOAT")),
    )
    rows = [
        (
            number // 4,
            "/r/gnss/rf",
            (ours if number % 3 else theirs)(band=f"L{number % 5}", agc=number),
        )
        for number in range(900)
    ]
    table = read(save(tmp_path / "a.mcap", rows, chunk_size=4000))["/r/gnss/rf"]
    assert table["agc"].tolist() == list(range(900))
    assert table.texts("band") == [f"L{number % 5}" for number in range(900)]


def test_topics_are_found_by_message_and_the_rest_is_listed(drive: Any, tmp_path: Path) -> None:
    table: Table = drive(2)["/imu0/imu"]
    rows = [
        *our_messages("/vehicle/front/imu_raw", table),
        *our_messages("/left/imu", table),
        *(
            (time, "/camera", message_class("someone.Image", ("width", 1, "UINT32"))(width=5))
            for time in range(1)
        ),
        *(
            (
                time,
                "/odd/baro",
                message_class("someone.Baro", ("pressure", 1, "DOUBLE"))(pressure=5),
            )
            for time in range(1)
        ),
    ]
    path = save(tmp_path / "a.mcap", by_time(iter(rows)))
    again = read(path)
    assert set(again) == {"/vehicle_front_imu_raw/imu", "/left/imu"}
    assert all(found == table for found in again.values())
    assert again.metadata["unread"] == {
        "/camera": "someone.Image (protobuf)",
        "/odd/baro": "someone.Baro (protobuf)",
    }


def test_other_encodings_are_listed(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start()
        schema = writer.register_schema("spoofbench.schema.v1.Imu", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/imu0/imu", "json", schema), 1, b"{}", 1)
        writer.add_message(writer.register_channel("/plain", "json", 0), 1, b"{}", 1)
        writer.finish()
    again = read(tmp_path / "a.mcap")
    assert not again
    assert again.metadata["unread"] == {
        "/imu0/imu": "spoofbench.schema.v1.Imu (json)",
        "/plain": "no schema (json)",
    }
