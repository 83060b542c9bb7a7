"""One session in every kind of bag gives the same rows, and each message is accounted for."""

import gzip
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from spoofbench_converters import rosbag

from spoofbench.conversion import Source

Convert = Callable[..., Any]
KINDS = (
    "ros1",
    "ros1-bz2",
    "ros1-lz4",
    "sqlite",
    "sqlite-file-zstd",
    "sqlite-message-zstd",
    "mcap",
    "mcap-file-zstd",
    "mcap-message-zstd",
    "mcap-chunk-zstd",
)


def told(converted: Any) -> tuple[Any, ...]:
    """What has to be equal of one session in all kinds of bags: rows, metadata and account."""
    metadata = {name: dict(about) for name, about in converted.recording.metadata.items()}
    return dict(converted.recording), metadata, converted.used, converted.skipped


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_gives_the_same_rows(
    kind: str, sessions: Any, expected: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    session = sessions.drive(40)
    path = sessions.WRITERS[kind](tmp_path / "bag", session)
    assert rosbag.sniff(Source.of(path)) == 1
    result = convert_bag(path)
    assert result.used == len(session)
    assert set(result.recording) == {"/imu0/imu", "/mag0/mag", "/gnss0/gnss/pvt"}
    assert told(result) == told(expected)


def test_rows_are_what_was_written(sessions: Any, expected: Any) -> None:
    session = sessions.drive(40)
    fixes = [message.values for message in session if message.topic == "/gps/fix"]
    twists = [message.values for message in session if message.topic == "/gps/vel"]
    pvt = expected.recording["/gnss0/gnss/pvt"]
    assert pvt["lat_deg"].tolist() == [fix["latitude"] for fix in fixes]
    assert pvt["height_m"].tolist() == [fix["altitude"] for fix in fixes]
    assert pvt.time_ns.tolist() == [
        fix["header.stamp.sec"] * 10**9 + fix["header.stamp.nanosec"] for fix in fixes
    ]
    for name, axis, sign in (("vel_n_mps", "y", 1), ("vel_e_mps", "x", 1), ("vel_d_mps", "z", -1)):
        assert pvt[name].tolist() == [sign * twist[f"twist.linear.{axis}"] for twist in twists]
    covariance = np.array([fix["position_covariance"] for fix in fixes])
    kinds = np.array([fix["position_covariance_type"] for fix in fixes])
    np.testing.assert_array_equal(pvt["cov_nn_m2"], np.where(kinds > 0, covariance[:, 4], np.nan))
    np.testing.assert_array_equal(pvt["cov_nd_m2"], np.where(kinds == 3, -covariance[:, 5], np.nan))
    imu = [message.values for message in session if message.topic == "/imu/data"]
    assert expected.recording["/imu0/imu"]["gyro_y_radps"].tolist() == [
        message["angular_velocity.y"] for message in imu
    ]
    field = [
        message.values["magnetic_field.z"] * 1e6
        for message in session
        if message.topic == "/imu/mag"
    ]
    assert expected.recording["/mag0/mag"]["field_z_ut"].tolist() == field


def test_a_bag_under_another_name_or_packed_as_a_whole(
    sessions: Any, expected: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    bag = sessions.write_ros1(tmp_path / "a.bag", sessions.drive(40))
    misnamed = bag.rename(tmp_path / "a.db3")
    assert told(convert_bag(misnamed)) == told(expected)
    packed = tmp_path / "a.gz"
    packed.write_bytes(gzip.compress(misnamed.read_bytes(), 1))
    assert rosbag.sniff(Source.of(packed)) == 1
    assert told(convert_bag(packed)) == told(expected)
    folder = sessions.write_ros2(tmp_path / "b", sessions.drive(40))
    database = next(folder.glob("*.db3"))
    packed.write_bytes(gzip.compress(database.read_bytes(), 1))
    assert rosbag.sniff(Source.of(packed)) == 1
    assert told(convert_bag(packed)) == told(expected)
    archive = tmp_path / "c.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(folder.iterdir()):
            file.write(path, f"deep/{path.name}")
    assert 0 < rosbag.sniff(Source.of(archive)) < 1
    assert told(convert_bag(archive)) == told(expected)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_split_bags(
    storage: str, sessions: Any, expected: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    session = sessions.drive(40)
    third = len(session) // 3
    parts = [session[:third], session[third : 2 * third], session[2 * third :]]
    whole = tmp_path / "whole"
    whole.mkdir()
    suffix = {"SQLITE3": "db3", "MCAP": "mcap"}[storage]
    for number, part in enumerate(parts):
        folder = sessions.write_ros2(tmp_path / f"part{number}", part, storage)
        shutil.copy(next(folder.glob(f"*.{suffix}")), whole / f"bag_{number}.{suffix}")
    assert rosbag.sniff(Source.of(whole)) == 1  # a recorder that is killed leaves no metadata
    assert told(convert_bag(whole)) == told(expected)
    about = (tmp_path / "part0" / "metadata.yaml").read_text()
    name = f"part0.{suffix}"
    assert f"- {name}" in about
    listed = "\n".join(f"  - bag_{number}.{suffix}" for number in range(3))
    about = about.replace(f"  - {name}", listed).replace(
        f"message_count: {third}\n", f"message_count: {len(session)}\n"
    )
    (whole / "metadata.yaml").write_text(about)
    assert told(convert_bag(whole)) == told(expected)
    (whole / f"bag_1.{suffix}").unlink()
    hurt = convert_bag(whole)
    assert hurt.used + hurt.skipped == len(session)
    assert any("missing" in reason for reason in hurt.reasons)


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"use_statistics": False, "use_summary_offsets": False},
        {"index_types": IndexType.NONE},
    ],
)
@pytest.mark.parametrize("compression", list(CompressionType))
def test_mcap_of_other_writers(
    options: dict[str, Any],
    compression: CompressionType,
    sessions: Any,
    expected: Any,
    convert_bag: Convert,
    tmp_path: Path,
) -> None:
    bag = next(sessions.write_ros2(tmp_path / "bag", sessions.drive(40), "MCAP").glob("*.mcap"))
    assert told(
        convert_bag(sessions.rewrite(bag, tmp_path / "again.mcap", compression, **options))
    ) == told(expected)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_packed_messages_of_a_lone_file(
    storage: str, sessions: Any, expected: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    folder = sessions.write_ros2(tmp_path / "bag", sessions.drive(40), storage, "MESSAGE")
    assert told(
        convert_bag(next(path for path in folder.iterdir() if path.suffix != ".yaml"))
    ) == told(expected)
