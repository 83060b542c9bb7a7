"""What standard messages say, what is made of topics, and bags that were cut off or never
closed.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from spoofbench_converters.rosbag import definitions
from spoofbench_converters.rosbag.unpacking import unpack

from spoofbench.errors import ConversionError
from spoofbench.schema.v1 import gnss_pb2

Convert = Callable[..., Any]
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(
    {
        name: (list(constants), list(fields))
        for name, (constants, fields) in definitions.known().items()
    }
)


def bag(sessions: Any, path: Path, *topics: tuple[str, str, dict[str, Any]]) -> Path:
    """Write a bag with four messages of each topic, a second apart."""
    messages = [
        sessions.Message(name, kind, stamp, {**sessions.time("header.stamp", stamp), **values})
        for i in range(4)
        for name, kind, values in topics
        for stamp in (sessions.START_NS + i * sessions.SECOND_NS,)
    ]
    written: Path = sessions.write_ros2(path, messages, store=STORE)
    return written


def test_what_a_message_says_it_does_not_have_is_absent(
    sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    unknown = np.array([-1.0] + [0.0] * 8)
    neither = {"angular_velocity_covariance": unknown, "linear_acceleration_covariance": unknown}
    path = bag(
        sessions,
        tmp_path / "bag",
        (
            "/a",
            sessions.IMU,
            {
                "linear_acceleration.x": 1.0,
                "angular_velocity.x": 2.0,
                "linear_acceleration_covariance": unknown,
            },
        ),
        ("/b", sessions.IMU, neither),
        ("/fix", sessions.FIX, {"status.status": -1}),
    )
    result = convert_bag(path)
    imu, pvt = result.recording["/imu0/imu"], result.recording["/gnss0/gnss/pvt"]
    assert not imu.has("accel_x_mps2")
    assert imu["gyro_x_radps"].tolist() == [2.0] * 4
    assert imu["interval_s"].tolist() == [0.0] * 4
    assert "/imu1/imu" not in result.recording
    assert result.reasons == {"/b: it holds neither accelerations nor rates"}
    assert set(pvt["fix_type"].tolist()) == {gnss_pb2.FIX_TYPE_NONE}
    assert not pvt.has("lat_deg")
    assert (result.used, result.skipped) == (8, 4)


def test_a_time_reference_belongs_to_its_receiver(
    sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    reference = sessions.time("time_ref", sessions.START_NS + 18 * sessions.SECOND_NS)
    path = bag(
        sessions,
        tmp_path / "bag",
        ("/gps/fix", sessions.FIX, {}),
        ("/gps/time_reference", "sensor_msgs/msg/TimeReference", reference),
        ("/air", "sensor_msgs/msg/FluidPressure", {"fluid_pressure": 101_325.0}),
    )
    recording = convert_bag(path).recording
    assert recording["/gnss0/gnss/clock"]["host_offset_s"].tolist() == [18.0, 17.0, 16.0, 15.0]
    assert recording["/baro0/baro"]["pressure_pa"].tolist() == [101_325.0] * 4


def test_gps_fix_and_its_satellites(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    satellites = {
        "status.satellite_visible_prn": np.array([3, 70, 300], "i4"),
        "status.satellite_visible_snr": np.array([40, 0, 35], "i4"),
        "status.satellite_visible_z": np.array([45, 10, 80], "i4"),
        "status.satellite_used_prn": np.array([3], "i4"),
        "status.satellites_used": 1,
        "status.status": 19,
    }
    fix = {
        "latitude": 42.0,
        "longitude": -71.0,
        "altitude": 12.0,
        "track": 90.0,
        "speed": 5.0,
        "climb": 1.0,
        "hdop": 0.9,
        "err_horz": 2.0,
    }
    recording = convert_bag(
        bag(sessions, tmp_path / "bag", ("/f", "gps_msgs/msg/GPSFix", {**fix, **satellites}))
    ).recording
    pvt, signal = recording["/gnss0/gnss/pvt"], recording["/gnss0/gnss/signal"]
    decoded = {
        "height_msl_m": 12,
        "course_deg": 90,
        "speed_mps": 5,
        "vel_d_mps": -1,
        "hdop": 0.9,
        "h_acc_m": 2,
        "num_sv": 1,
    }
    assert {name: float(pvt[name][0]) for name in decoded} == decoded
    assert not pvt.has("pdop")
    assert pvt["fix_type"][0] == gnss_pb2.FIX_TYPE_RTK_FIXED
    assert signal["svid"][:3].tolist() == [3, 6, 300]
    assert signal["constellation"][:2].tolist() == [
        gnss_pb2.CONSTELLATION_GPS,
        gnss_pb2.CONSTELLATION_GLONASS,
    ]
    assert signal.valid("constellation")[:3].tolist() == [True, True, False]
    assert signal["used"][:3].tolist() == [True, False, False]
    np.testing.assert_array_equal(signal["cn0_dbhz"][:3], np.array([40, np.nan, 35], np.float32))


def test_what_nothing_says_is_a_receivers_or_of_wheels_is_declined(
    sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    path = bag(
        sessions,
        tmp_path / "bag",
        ("/gps/fix", sessions.FIX, {}),
        ("/cmd_vel", sessions.TWIST, {"twist.linear.x": 1.0}),
        ("/gps/cmd_vel", sessions.TWIST, {"twist.linear.x": 1.0}),
        ("/elsewhere/twist", sessions.TWIST, {"twist.linear.x": 2.0}),
        ("/odometry/filtered", "nav_msgs/msg/Odometry", {"twist.twist.linear.x": 3.0}),
        ("/wheel/odom", "nav_msgs/msg/Odometry", {"twist.twist.linear.x": 4.0}),
    )
    result = convert_bag(path)
    assert set(result.recording) == {"/gnss0/gnss/pvt", "/odometer0/odometer"}
    assert result.recording["/odometer0/odometer"]["speed_mps"].tolist() == [4.0] * 4
    assert (result.used, result.skipped) == (8, 16)
    asked = convert_bag(path, velocity="/elsewhere/twist", odometer="/odometry/filtered").recording
    assert asked["/gnss0/gnss/pvt"].has("vel_e_mps") or asked["/gnss1/gnss/pvt"].has("vel_e_mps")
    assert asked["/odometer0/odometer"]["speed_mps"].tolist() == [3.0] * 4


@pytest.mark.parametrize("kind", ["ros1", "ros1-lz4", "mcap", "mcap-chunk-zstd"])
def test_a_bag_without_its_end(
    kind: str, sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    session = sessions.drive(60)
    path = sessions.WRITERS[kind](tmp_path / "bag", session)
    bag_file = path if path.is_file() else next(path.glob("*.mcap"))
    whole = convert_bag(bag_file)
    cut = tmp_path / "cut"
    octets = bag_file.read_bytes()
    for share in (0.95, 0.6):
        cut.write_bytes(octets[: int(share * len(octets))])
        hurt = convert_bag(cut)
        assert hurt.used > (share - 0.2) * len(session)
        for topic, table in hurt.recording.items():
            assert set(table.time_ns.tolist()) <= set(whole.recording[topic].time_ns.tolist())


def test_a_plain_chunk_of_a_wrong_checksum_is_read_and_said_so(
    sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    folder = sessions.write_ros2(tmp_path / "bag", sessions.drive(10), "MCAP")
    path = sessions.rewrite(
        next(folder.glob("*.mcap")), tmp_path / "checked.mcap", CompressionType.NONE
    )
    whole = convert_bag(path)
    octets = bytearray(path.read_bytes())
    octets[len(octets) // 3] ^= 1
    path.write_bytes(octets)
    hurt = convert_bag(path)
    assert hurt.used + hurt.skipped == whole.used
    assert hurt.recording.metadata["recording"]["unverified_chunks"] == "1"
    assert "unverified_chunks" not in whole.recording.metadata["recording"]
    packed = sessions.rewrite(next(folder.glob("*.mcap")), path, CompressionType.LZ4)
    octets = bytearray(packed.read_bytes())
    octets[len(octets) // 3] ^= 1
    packed.write_bytes(octets)
    hurt = convert_bag(packed)
    assert hurt.used + hurt.skipped == whole.used
    assert 0 < hurt.skipped < whole.used


@pytest.mark.parametrize("packing", ["bz2", "lz4", "zstd"])
def test_unpacking_is_bounded_and_keeps_what_precedes_damage(packing: str) -> None:
    import bz2

    import lz4.frame
    import zstandard

    pack = {
        "bz2": bz2.compress,
        "lz4": lz4.frame.compress,
        "zstd": zstandard.ZstdCompressor().compress,
    }[packing]
    data = np.random.default_rng(2).bytes(2_000_000)
    assert unpack(pack(data), packing, len(data)) == (data, None)
    assert len(unpack(pack(bytes(100_000_000)), packing, 1000)[0]) == 1000
    part, wrong = unpack(pack(data)[:1_500_000], packing, len(data))
    assert wrong is not None
    assert data.startswith(part)
    assert len(part) > 1_000_000 * (packing != "bz2")


def test_one_receiver_of_several_is_converted_with_all_other_kinds(
    sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    session = sessions.drive(10)
    second = [
        replace(message, topic=f"/b{message.topic}")
        for message in session
        if message.topic.startswith("/gps")
    ]
    sentences = [
        sessions.Message(
            "/nmea", "nmea_msgs/msg/Sentence", message.stamp_ns, {"sentence": "$GPTXT*"}
        )
        for message in second
    ]
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(
        get_types_from_msg("std_msgs/Header header\nstring sentence\n", "nmea_msgs/msg/Sentence")
    )
    path = sessions.write_ros2(tmp_path / "bag", session + second + sentences, store=store)
    only = convert_bag(path, source="/b/gps/fix")
    assert set(only.recording) == {"/imu0/imu", "/mag0/mag", "/gnss0/gnss/pvt"}
    assert only.recording["/gnss0/gnss/pvt"].has("lat_deg", "vel_e_mps")
    assert only.recording.metadata["source/gnss0"]["topic"] == "/b/gps/fix /b/gps/vel"
    assert only.reasons == {
        f"topic '{name}': not asked for" for name in ("/gps/fix", "/gps/vel", "/nmea")
    }
    assert set(convert_bag(path, source="/imu/data").recording) == {
        "/imu0/imu",
        "/mag0/mag",
        "/gnss0/gnss/pvt",
        "/gnss1/gnss/pvt",
    }
    assert set(convert_bag(path, source="/nmea").recording) == {"/imu0/imu", "/mag0/mag"}
    with pytest.raises(ConversionError, match="/gps/fix"):
        convert_bag(path, source="/gps/fxi")
