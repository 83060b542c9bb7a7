"""Damage costs what it hits; strange bags are one sentence; every message is accounted for."""

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import apsw
import pytest
import rosbags.rosbag2
from spoofbench_converters import rosbag

from spoofbench.conversion import Source
from spoofbench.errors import ConversionError

START_NS = 1_700_000_000_000_000_000
PAGE = 4096


def database(bag: Path) -> Path:
    return next(bag.glob("*.db3"))


def test_unreadable_pages_cost_their_own_messages(
    maker: Any, convert_bag: Callable[..., Any]
) -> None:
    session = maker.session(60)
    path = maker.bag(session)
    whole = convert_bag(path)
    octets = bytearray(database(path).read_bytes())
    middle = len(octets) // PAGE // 2 * PAGE
    octets[middle : middle + 2 * PAGE] = b"\xff" * (2 * PAGE)
    database(path).write_bytes(octets)
    hurt = convert_bag(path)
    assert hurt.used + hurt.skipped == len(session)
    assert 0 < hurt.skipped < len(session) // 10
    assert any("damaged" in reason for reason in hurt.reasons)
    for topic, table in whole.recording.items():
        assert set(hurt.recording[topic].time_ns.tolist()) <= set(table.time_ns.tolist())


def test_a_truncated_file_keeps_its_beginning(maker: Any, convert_bag: Callable[..., Any]) -> None:
    session = maker.session(60)
    path = maker.bag(session)
    octets = database(path).read_bytes()
    database(path).write_bytes(octets[: len(octets) * 3 // 4 // PAGE * PAGE])
    hurt = convert_bag(path)
    assert hurt.used + hurt.skipped == len(session)
    assert hurt.used > len(session) // 4


def test_topics_that_are_not_understood_are_counted(
    maker: Any, convert_bag: Callable[..., Any]
) -> None:
    session = maker.session(5)
    other = [("/camera", "sensor_msgs/msg/Image", START_NS + i, bytes(100_000)) for i in range(7)]
    maker.store.register(
        {
            "sensor_msgs/msg/Image": (
                [],
                [("x", maker.store.fielddefs["aspn23_ros_interfaces/msg/TypeTimestamp"][1][0][1])],
            )
        }
    )
    result = convert_bag(maker.bag([*other, *session]))
    assert [(reject.offset, reject.length) for reject in result.rejects] == [(0, 7)]
    assert "'/camera' of type 'sensor_msgs/msg/Image'" in result.rejects[0].reason
    assert result.used == len(session)


def test_messages_that_are_too_long_or_of_strange_types_cost_themselves(
    maker: Any, convert_bag: Callable[..., Any]
) -> None:
    session = maker.session(5)
    path = maker.bag(session)
    with sqlite3.connect(database(path)) as file:
        file.execute("UPDATE messages SET data = zeroblob(1000000) WHERE id = 20")
        file.execute("UPDATE messages SET data = 'text' WHERE id = 30")
        file.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 40")
        file.execute("UPDATE messages SET topic_id = 99 WHERE id = 50")
        file.execute("UPDATE messages SET data = x'0001' WHERE id = 60")
    result = convert_bag(path)
    assert result.used + result.skipped == len(session)
    assert sorted(reject.offset for reject in result.rejects) == [19, 29, 39, 49, 59]


def test_a_locked_database_is_one_sentence(
    maker: Any, convert_bag: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    from spoofbench_converters.rosbag import sqlite_log

    monkeypatch.setattr(sqlite_log, "BUSY_MS", 10)
    path = maker.bag(maker.session(2))
    # Locks of one process hold between connections of one library alone.
    writer = apsw.Connection(str(database(path)))
    writer.execute("BEGIN EXCLUSIVE")
    with pytest.raises(ConversionError, match="locked"):
        convert_bag(path)
    writer.close()
    assert convert_bag(path).used


def test_converting_leaves_no_trace_beside_the_bag(
    maker: Any, convert_bag: Callable[..., Any]
) -> None:
    path = maker.bag(maker.session(2))
    with sqlite3.connect(database(path)) as file:
        file.execute("PRAGMA journal_mode=WAL")
    file.close()
    before = {entry: entry.stat().st_size for entry in path.iterdir()}
    assert convert_bag(path).used
    assert {entry: entry.stat().st_size for entry in path.iterdir()} == before


def test_a_bare_database_gives_the_same_rows(maker: Any, convert_bag: Callable[..., Any]) -> None:
    path = maker.bag(maker.session(5))
    assert dict(convert_bag(database(path)).recording) == dict(convert_bag(path).recording)
    assert rosbag.sniff(Source.of(path)) == rosbag.sniff(Source.of(database(path))) == 1


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "compression_format: ''\n  compression_mode: ''",
            "compression_format: lz5\n  compression_mode: message",
            "only zstd can be unpacked",
        ),
        ("rosbag2_bagfile_information:", "[rosbag2_bagfile_information", "cannot be read"),
        ("bag.db3", "../../secret.db3", "lacks its file 'secret.db3'"),
        ("- bag.db3", "- [bag.db3]", "does not name its files"),
        ("compression_mode: ''", "compression_mode: " + "[" * 10_000, "cannot be read"),
    ],
)
def test_bags_that_cannot_be_read_are_one_sentence(
    maker: Any, convert_bag: Callable[..., Any], old: str, new: str, sentence: str
) -> None:
    path = maker.bag(maker.session(1))
    about = path / "metadata.yaml"
    assert old in about.read_text()
    about.write_text(about.read_text().replace(old, new))
    with pytest.raises(ConversionError, match=sentence):
        convert_bag(path)


def test_other_files_are_refused(tmp_path: Path, convert_bag: Callable[..., Any]) -> None:
    for head, sentence, confidence in (
        (b"#ROSBAG V1.2\n", "another version", 1),
        (b"hello", "is no bag", 0),
    ):
        path = tmp_path / "file"
        path.write_bytes(head)
        assert rosbag.sniff(Source.of(path)) == confidence
        with pytest.raises(ConversionError, match=sentence):
            convert_bag(path)
    with sqlite3.connect(tmp_path / "other.db3") as file:
        file.execute("CREATE TABLE messages (x)")
    file.close()
    assert rosbag.sniff(Source.of(tmp_path / "other.db3")) == 0
    with pytest.raises(ConversionError, match="no ROS 2 bag"):
        convert_bag(tmp_path / "other.db3")
    assert rosbag.sniff(Source.of(tmp_path)) == 0


def test_views_that_pose_as_tables_are_not_read(
    tmp_path: Path, convert_bag: Callable[..., Any]
) -> None:
    with sqlite3.connect(tmp_path / "trap.db3") as file:
        file.execute("CREATE TABLE topics (id, name, type, serialization_format)")
        file.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 "
            "FROM n) SELECT id FROM n"
        )
    file.close()
    with pytest.raises(ConversionError, match="no ROS 2 bag"):
        convert_bag(tmp_path / "trap.db3")


def test_definitions_of_the_user_go_first(
    maker: Any, convert_bag: Callable[..., Any], tmp_path: Path
) -> None:
    path = maker.bag(maker.session(2))
    folder = tmp_path / "aspn23_ros_interfaces" / "msg"
    folder.mkdir(parents=True)
    with pytest.raises(ConversionError, match=r"no \.msg file"):
        convert_bag(path, definitions=str(tmp_path / "aspn23_ros_interfaces"))
    (folder / "TypeTimestamp.msg").write_text("int64 elapsed_nsec\nint64 another\n")
    result = convert_bag(path, definitions=str(tmp_path / "aspn23_ros_interfaces"))
    assert not result.used
    assert any("definition" in reason for reason in result.reasons)
    (folder / "TypeTimestamp.msg").write_text("int64 elapsed_nsec\n")
    assert dict(convert_bag(path, definitions=str(tmp_path)).recording) == dict(
        convert_bag(path).recording
    )


def test_rosbags_reads_what_these_tests_write(maker: Any) -> None:
    session = maker.session(2)
    with rosbags.rosbag2.Reader(maker.bag(session)) as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == [stamp for _, _, stamp, _ in session]


@pytest.mark.parametrize("value", [0.0, -0.01, float("nan"), float("inf")])
def test_an_interval_that_no_inertial_sensor_has_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="imu_interval_s must be above 0"):
        rosbag.Options(imu_interval_s=value)
