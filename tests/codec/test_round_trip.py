"""What is written is what is read, by us and by the official reader; the same rows give the same
bytes.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from spoofbench.codec import Writer, read, validate, write
from spoofbench.codec.encode import TableEncoder
from spoofbench.errors import RecordingError
from spoofbench.recording import Recording
from spoofbench.schema import KINDS
from spoofbench.table import Column, Table

COMPRESSIONS = ("zstd", "lz4", "none")


@given(st.data(), st.sampled_from(COMPRESSIONS))
@settings(deadline=None, max_examples=150)
def test_any_table_is_read_as_it_was_written_and_as_the_official_decoder_reads_it(
    tables: Any, any_topic: Any, officially_read: Any, data: st.DataObject, compression: Any
) -> None:
    table = data.draw(tables())
    topic = any_topic(table)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        write(Recording({topic: table}), path, compression=compression)
        validate(path)
        ours = read(path)
        assert list(ours) == [topic]
        assert ours[topic] == table
        assert ours.metadata == {}
        assert officially_read(path, topic) == table
        for name in table:
            if table[name].dtype.kind == "f":
                known = table.valid(name)
                assert (
                    ours[topic][name][known].tobytes() == table[name][known].tobytes()
                )  # -0.0 is not 0.0


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_drive_is_read_as_it_was_written_with_its_metadata(
    drive: Any, officially_read: Any, tmp_path: Path, compression: Any
) -> None:
    recording = drive(120)
    write(recording, tmp_path / "a.mcap", compression=compression)
    validate(tmp_path / "a.mcap")
    again = read(tmp_path / "a.mcap")
    assert dict(again) == dict(recording)
    assert again.metadata == recording.metadata
    assert again.digest() == recording.digest()
    for topic in recording:
        assert officially_read(tmp_path / "a.mcap", topic) == recording[topic]


def test_the_file_is_in_strict_order_of_time_with_publish_time_equal(
    drive: Any, tmp_path: Path
) -> None:
    write(drive(60), tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        messages = [
            message
            for _, _, message in make_reader(stream, validate_crcs=True).iter_messages(
                log_time_order=False
            )
        ]
    times = [message.log_time for message in messages]
    assert times == sorted(times)
    assert times == [message.publish_time for message in messages]


@given(st.data())
@settings(deadline=None, max_examples=60)
def test_the_same_rows_give_the_same_bytes_however_they_are_cut(
    tables: Any, any_topic: Any, data: st.DataObject
) -> None:
    table = data.draw(tables())
    cuts = sorted(data.draw(st.lists(st.integers(0, len(table)), max_size=5)))
    with tempfile.TemporaryDirectory() as folder:
        whole, pieces = Path(folder) / "whole.mcap", Path(folder) / "pieces.mcap"
        write(Recording({any_topic(table): table}), whole)
        with Writer(pieces) as writer:
            for first, last in zip([0, *cuts], [*cuts, len(table)], strict=True):
                writer.add(any_topic(table), table.take(slice(first, last)))
        assert whole.read_bytes() == pieces.read_bytes()


def test_pieces_that_cross_chunks_give_the_bytes_of_the_whole(drive: Any, tmp_path: Path) -> None:
    recording = drive(300)
    for name, size in (("a.mcap", 10**9), ("b.mcap", 777), ("c.mcap", 9999)):
        with Writer(tmp_path / name) as writer:
            writer.describe(recording.metadata)
            for topic, table in recording.items():
                for first in range(0, len(table), size):
                    writer.add(topic, table.take(slice(first, first + size)))
    assert (
        (tmp_path / "a.mcap").read_bytes()
        == (tmp_path / "b.mcap").read_bytes()
        == (tmp_path / "c.mcap").read_bytes()
    )
    assert dict(read(tmp_path / "b.mcap")) == dict(recording)


def test_every_payload_of_not_a_number_is_absent(tmp_path: Path) -> None:
    payloads = np.array(
        [0x7FF8000000000000, 0x7FF0000000000001, 0xFFF8DEADBEEF0000, 0x3FF0000000000000], np.uint64
    ).view(np.float64)
    write(
        Recording({"/imu0/imu": Table("imu", np.arange(4), {"accel_x_mps2": payloads})}),
        tmp_path / "a.mcap",
    )
    assert read(tmp_path / "a.mcap")["/imu0/imu"].valid("accel_x_mps2").tolist() == [
        False,
        False,
        False,
        True,
    ]
    plain = np.array([np.nan, np.nan, np.nan, 1.0])
    write(
        Recording({"/imu0/imu": Table("imu", np.arange(4), {"accel_x_mps2": plain})}),
        tmp_path / "b.mcap",
    )
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_columns_cannot_be_made_writable(drive: Any, tmp_path: Path) -> None:
    write(drive(20), tmp_path / "a.mcap")
    for table in read(tmp_path / "a.mcap").values():
        for values in (table.time_ns, *table.values()):
            with pytest.raises(ValueError, match="WRITEABLE"):
                values.flags.writeable = True


def test_rows_of_a_topic_are_read_once_for_all_views_of_a_recording(
    drive: Any, tmp_path: Path
) -> None:
    write(drive(5), tmp_path / "a.mcap")
    recording = read(tmp_path / "a.mcap")
    assert recording.blind()["/imu0/imu"] is recording["/imu0/imu"]


def test_positions_have_a_view_for_maps_that_is_not_read_back(drive: Any, tmp_path: Path) -> None:
    recording = drive(20)
    pvt = recording["/gnss0/gnss/pvt"].replace(
        lat_deg=np.where(np.arange(20) < 2, np.nan, 45.0), height_m=None
    )
    write(recording.replace({"/gnss0/gnss/pvt": pvt}), tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        fixes = [
            (message, fix)
            for _, _, message, fix in reader.iter_decoded_messages(["/gnss0/location_fix"])
        ]
    assert [message.log_time for message, _ in fixes] == pvt.time_ns[2:].tolist()
    _, fix = fixes[-1]
    assert fix.timestamp.ToNanoseconds() == pvt.time_ns[-1]
    assert (fix.latitude, fix.longitude) == (45.0, pvt["lon_deg"][-1])
    assert np.isnan(fix.altitude)
    assert fix.position_covariance_type == LocationFix.KNOWN
    assert fix.position_covariance[0] == pvt["cov_ee_m2"][-1]
    assert fix.position_covariance[5] == -pvt["cov_nd_m2"][-1]
    assert "unread" not in read(tmp_path / "a.mcap").metadata


def test_a_failed_write_leaves_nothing_behind(drive: Any, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"before")
    with pytest.raises(ZeroDivisionError), Writer(tmp_path / "a.mcap") as writer:  # noqa: PT012
        writer.add("/imu0/imu", drive(5)["/imu0/imu"])
        raise ZeroDivisionError
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert (tmp_path / "a.mcap").read_bytes() == b"before"


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with Writer(tmp_path / "a.mcap") as writer:
        writer.add("/imu0/imu", Table("imu", np.array([5, 6]), {}))
        with pytest.raises(RecordingError, match="run back in time"):
            writer.add("/imu0/imu", Table("imu", np.array([5]), {}))
        with pytest.raises(RecordingError, match="cannot take rows of kind 'imu'"):
            writer.add("/imu0/mag", Table("imu", np.array([7]), {}))
        with pytest.raises(RecordingError, match="before 1970"):
            writer.add("/imu1/imu", Table("imu", np.array([-1]), {}))
        with pytest.raises(RecordingError, match="not valid Unicode"):
            writer.add("/gnss0/gnss/rf", Table("gnss/rf", np.array([7]), {"band": ["\ud800"]}))
        with pytest.raises(RecordingError, match="must be text"):
            writer.describe({"origin": {"size": 5}})  # type: ignore[dict-item]
    with (
        pytest.raises(RecordingError, match="a folder that exists"),
        Writer(tmp_path / "none" / "a.mcap"),
    ):
        pass


def test_metadata_may_come_in_any_order_and_the_last_word_counts(tmp_path: Path) -> None:
    with Writer(tmp_path / "a.mcap") as writer:
        writer.describe({"b": {"y": "1", "x": "2"}, "a": {"old": "1"}})
        writer.describe({"a": {"k": "v"}})
    with Writer(tmp_path / "b.mcap") as writer:
        writer.describe({"a": {"k": "v"}})
        writer.describe({"b": {"x": "2", "y": "1"}})
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert read(tmp_path / "a.mcap").metadata == {"a": {"k": "v"}, "b": {"x": "2", "y": "1"}}


def test_rows_of_one_shape_take_one_layout_and_masks_take_few() -> None:
    rows = 1000
    dense = Table(
        "imu", np.arange(rows), {name: np.ones(rows) for name in list(KINDS["imu"].fields)[:7]}
    )
    assert np.unique(TableEncoder(1, dense).sizes).size == 1
    halved = dense.replace(receive_time_ns=Column(np.arange(rows), np.arange(rows) % 2 == 0))
    assert np.unique(TableEncoder(1, halved).sizes).tolist() == [31 + 63, 31 + 72]
