"""Messages that a mapping describes, or that hold messages of ROS, give what their fields say."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from spoofbench_converters.rosbag import mapped

from spoofbench.errors import ConversionError
from spoofbench.schema.v1 import gnss_pb2

Convert = Callable[..., Any]

TYPES = {
    "novatel_oem7_msgs/msg/Oem7Header": "uint16 gps_week_number\nuint32 gps_week_milliseconds\n",
    "novatel_oem7_msgs/msg/PositionOrVelocityType": "uint32 type\n",
    "novatel_oem7_msgs/msg/BESTPOS": (
        "std_msgs/Header header\nOem7Header nov_header\nPositionOrVelocityType pos_type\nfloat64 "
        "lat\nfloat64 lon\nfloat64 hgt\n"
        "float32 hgt_stdev\nfloat32 diff_age\nuint8 num_sol_svs\n"
    ),
    "septentrio_gnss_driver/msg/BlockHeader": "uint32 tow\nuint16 wnc\n",
    "septentrio_gnss_driver/msg/PVTGeodetic": (
        "std_msgs/Header header\nBlockHeader block_header\nuint8 mode\nfloat64 latitude\nfloat64 "
        "longitude\nfloat64 height\n"
        "float32 vn\nfloat32 ve\nfloat32 vu\nfloat32 cog\nfloat64 rx_clk_bias\nfloat32 "
        "rx_clk_drift\nuint8 nr_sv\n"
        "uint16 h_accuracy\nuint16 v_accuracy\n"
    ),
    "px4_msgs/msg/SensorCombined": (
        "uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2\nuint32 "
        "accelerometer_integral_dt\n"
    ),
    "lab/msg/Both": (
        "std_msgs/Header Header\nsensor_msgs/Imu imu\nsensor_msgs/MagneticField mag\nstring raw\n"
    ),
    "lab/msg/Gps": (
        "std_msgs/Header header\nfloat64 latitude\nfloat64 longitude\nstring altitude\nfloat64 "
        "utm_easting\nfloat64 utm_northing\n"
        "int32 zone\nstring letter\n"
    ),
    "lab/msg/Fix": "uint16 week\nuint32 tow_ms\nfloat64 lat\nfloat64 lon\n",
    "lab/msg/Speed": "std_msgs/Header header\nfloat64 kmh\nint32[3] raw\n",
}
STORE = get_typestore(Stores.ROS2_HUMBLE)
for NAME, TEXT in TYPES.items():
    STORE.register(get_types_from_msg(TEXT, NAME))


def bag(
    sessions: Any, path: Path, kind: str, rows: list[dict[str, Any]], header: str = "header"
) -> Path:
    """Write a bag of one topic, a message a second."""
    messages = []
    for i, row in enumerate(rows):
        stamp = sessions.START_NS + i * sessions.SECOND_NS
        stamped = sessions.time(f"{header}.stamp", stamp - 1000)
        messages.append(sessions.Message("/a/b", kind, stamp, {**stamped, **row}))
    written: Path = sessions.write_ros2(path, messages, store=STORE)
    return written


def test_novatel(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    rows = [
        {
            "lat": 42.0 + i,
            "hgt": 30.0,
            "pos_type.type": code,
            "nov_header.gps_week_number": 2300,
            "nov_header.gps_week_milliseconds": 1500,
        }
        for i, code in enumerate((0, 16, 50, 56, 99))
    ]
    result = convert_bag(bag(sessions, tmp_path / "bag", "novatel_oem7_msgs/msg/BESTPOS", rows))
    pvt = result.recording["/gnss0/gnss/pvt"]
    assert pvt["lat_deg"].tolist() == [row["lat"] for row in rows]
    assert set(pvt["tow_s"].tolist()) == {1.5}
    assert set(pvt["gps_week"].tolist()) == {2300}
    types = [
        gnss_pb2.FIX_TYPE_NONE,
        gnss_pb2.FIX_TYPE_3D,
        gnss_pb2.FIX_TYPE_RTK_FIXED,
        gnss_pb2.FIX_TYPE_GNSS_DEAD_RECKONING,
    ]
    assert pvt["fix_type"][:4].tolist() == types
    assert pvt.valid("fix_type").tolist() == [True] * 4 + [False]
    assert not pvt.has("height_m")
    assert result.recording.metadata["source/gnss0"]["mapping"] == "novatel_oem7"


def test_septentrio(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    absent = -2e10
    rows = [
        {
            "latitude": 0.7,
            "longitude": -1.2,
            "height": 5.0,
            "vn": 1.5,
            "ve": 0.0,
            "vu": 2.0,
            "mode": 4,
            "h_accuracy": 120,
            "nr_sv": 12,
        },
        {
            "latitude": absent,
            "longitude": absent,
            "height": absent,
            "vn": absent,
            "ve": absent,
            "vu": absent,
            "h_accuracy": 65535,
        },
    ]
    result = convert_bag(
        bag(sessions, tmp_path / "bag", "septentrio_gnss_driver/msg/PVTGeodetic", rows)
    )
    pvt = result.recording["/gnss0/gnss/pvt"]
    np.testing.assert_allclose(pvt["lat_deg"], [np.rad2deg(0.7), np.nan], rtol=1e-15)
    for name, value in (
        ("vel_n_mps", 1.5),
        ("vel_d_mps", -2.0),
        ("h_acc_m", 1.2),
        ("height_m", 5.0),
    ):
        np.testing.assert_array_equal(pvt[name], [value, np.nan], name)
    assert result.used == 2
    assert len(result.recording["/gnss0/gnss/clock"]) == 2


def test_px4_keeps_no_date_of_its_own(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    rows = [
        {
            "timestamp": i * 10**6,
            "accelerometer_m_s2": np.array([i, 0, -9.75], "f4"),
            "gyro_rad": np.zeros(3, "f4"),
        }
        for i in range(5)
    ]
    result = convert_bag(bag(sessions, tmp_path / "bag", "px4_msgs/msg/SensorCombined", rows))
    imu = result.recording["/imu0/imu"]
    assert imu["accel_x_mps2"].tolist() == [0, 1, 2, 3, 4]
    assert imu.time_ns.tolist() == [sessions.START_NS + i * sessions.SECOND_NS for i in range(5)]
    assert result.recording.metadata["recording"]["clock"] == "recorder"


def test_messages_within_messages(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    covariance = np.array([-1.0] + [0.0] * 8)
    rows = [
        {
            "imu.linear_acceleration.z": 9.8 + i,
            "imu.angular_velocity_covariance": covariance,
            "mag.magnetic_field.x": 2e-5,
            "raw": "x" * i,
        }
        for i in range(4)
    ]
    result = convert_bag(bag(sessions, tmp_path / "bag", "lab/msg/Both", rows, "Header"))
    imu, mag = result.recording["/imu0/imu"], result.recording["/mag0/mag"]
    assert imu["accel_z_mps2"].tolist() == [9.8 + i for i in range(4)]
    assert not imu.has("gyro_x_radps")
    np.testing.assert_allclose(mag["field_x_ut"], 20.0)
    assert imu.time_ns.tolist() == [
        sessions.START_NS + i * sessions.SECOND_NS - 1000 for i in range(4)
    ]
    assert (result.used, result.skipped) == (4, 0)


def test_small_drivers_positions(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    rows = [
        {"latitude": 42.0, "longitude": -71.0, "altitude": text, "letter": "T"}
        for text in ("12.5", "", "13")
    ]
    pvt = convert_bag(bag(sessions, tmp_path / "bag", "lab/msg/Gps", rows)).recording[
        "/gnss0/gnss/pvt"
    ]
    np.testing.assert_array_equal(pvt["height_msl_m"], [12.5, np.nan, 13.0])


def test_a_mapping_of_the_user(sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    path = bag(
        sessions,
        tmp_path / "bag",
        "lab/msg/Speed",
        [{"kmh": 36.0, "raw": np.array([1, i, 3], "i4")} for i in range(3)],
    )
    assert convert_bag(path).used == 0
    mapping = tmp_path / "mine.toml"
    text = (
        'clock = "sensor"\n[table.a]\nmessages = ["lab/*"]\n[table.a."/odometer0/odometer"]\n'
        'speed_mps = { column = "-kmh", unit = "km/h" }\nticks = "raw[1]"\n'
    )
    mapping.write_text(text)
    odometer = convert_bag(path, mapping=str(mapping)).recording["/odometer0/odometer"]
    np.testing.assert_allclose(odometer["speed_mps"], -10.0)
    assert odometer["ticks"].tolist() == [0, 1, 2]
    mapping.write_text(text.replace("lab/*", "other/*"))
    with pytest.raises(
        ConversionError, match=r"describes no topic of the bag; its types are \['lab/msg/Speed'\]"
    ):
        convert_bag(path, mapping=str(mapping))


def test_ready_mappings_can_be_read() -> None:
    names = [mapping.name for mapping in mapped._ready()]
    assert len(names) >= 5
    assert all(table.messages for mapping in mapped._ready() for table in mapping.tables)


GPS_TIME = """
clock = "sensor"
[table.fix]
messages = "lab/msg/Fix"
[table.fix.time]
column = "tow_ms"
unit = "ms"
week = "week"
[table.fix."/gnss0/gnss/pvt"]
lat_deg = "lat"
lon_deg = "lon"
"""


@pytest.mark.parametrize(("setting", "leap_s"), [("", 18), ("leap_seconds = 17\n", 17)])
def test_a_mapped_gps_time_is_turned_to_utc(
    setting: str, leap_s: int, sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    gps_s = sessions.START_NS // sessions.SECOND_NS - 315_964_800 + leap_s
    rows = [
        {
            "week": (gps_s + i) // 604_800,
            "tow_ms": (gps_s + i) % 604_800 * 1000 - 250,
            "lat": 42.0,
            "lon": -71.0,
        }
        for i in range(5)
    ]
    (tmp_path / "lab.toml").write_text(GPS_TIME.replace('unit = "ms"\n', f'unit = "ms"\n{setting}'))
    result = convert_bag(
        bag(sessions, tmp_path / "bag", "lab/msg/Fix", rows), mapping=str(tmp_path / "lab.toml")
    )
    assert (result.recording["/gnss0/gnss/pvt"].time_ns - sessions.START_NS).tolist() == [
        i * 10**9 - 250_000_000 for i in range(5)
    ]


@pytest.mark.parametrize(
    "setting", ['since = "start"', 'since = "day"', "wraps = 65536", 'date = "week"']
)
def test_a_time_that_messages_cannot_have_is_refused(
    setting: str, sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    (tmp_path / "lab.toml").write_text(GPS_TIME.replace('week = "week"', setting))
    with pytest.raises(ConversionError, match="cannot be used for messages"):
        convert_bag(
            bag(sessions, tmp_path / "bag", "lab/msg/Fix", [{"week": 1}]),
            mapping=str(tmp_path / "lab.toml"),
        )
