"""Inertial sensors, wheels, attitude: scales, joined ticks, counters that wrap."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader
from spoofbench_converters.ubx.inertial import MAX_SOURCES

IMU, RAW_TURN = "/imu0/imu", 1 << 24
_TYPES = {
    5: "gyro_z_radps",
    13: "gyro_y_radps",
    14: "gyro_x_radps",
    16: "accel_x_mps2",
    17: "accel_y_mps2",
    18: "accel_z_mps2",
}


def _datum(kind: int, value: int) -> dict[str, int]:
    return {"data": kind << 24 | value & 0xFFFFFF}


def _meas(ubx: Any, tick: int, data: list[dict[str, int]], **fields: Any) -> bytes:
    return bytes(
        ubx.message("ESF-MEAS", data, timeTag=tick % (1 << 32), flags=len(data) << 11, **fields)
    )


@settings(max_examples=30)
@given(
    st.dictionaries(
        st.sampled_from(list(_TYPES)), st.integers(-(1 << 23), (1 << 23) - 1), min_size=1
    )
)
def test_measurements_agree_with_the_reference(ubx: Any, told: dict[int, int]) -> None:
    frame = _meas(ubx, 77, [_datum(kind, value) for kind, value in told.items()])
    parsed = UBXReader.parse(frame)
    table = ubx.decode([frame]).tables[IMU]
    assert len(table) == 1
    for place in range(1, len(told) + 1):
        field = getattr(parsed, f"dataField_{place:02d}")
        name = _TYPES[getattr(parsed, f"dataType_{place:02d}")]
        signed = field - (1 << 24) if field >= 1 << 23 else field
        assert table[name][0] == pytest.approx(
            signed / 1024 if name.startswith("accel") else np.radians(signed / 4096)
        )
    assert sum(not np.isnan(table[name][0]) for name in _TYPES.values()) == len(told)


def test_messages_of_one_tick_are_one_row(ubx: Any) -> None:
    frames = [
        _meas(ubx, 500, [_datum(16, 1024), _datum(17, 0), _datum(18, -1024)]),
        _meas(ubx, 500, [_datum(14, 4096), _datum(12, 2150)]),
    ]
    decoded = ubx.decode(
        [*frames, _meas(ubx, 510, [_datum(16, 0)]), _meas(ubx, 510, [_datum(16, 1)])]
    )
    table = decoded.tables[IMU]
    assert decoded.tick_ns[IMU].tolist() == [
        500_000_000,
        510_000_000,
        510_000_000,
    ]  # a type that comes again is another sample
    assert table["accel_z_mps2"][0] == -1
    assert table["gyro_x_radps"][0] == pytest.approx(np.pi / 180)
    assert table["temperature_degc"][0] == pytest.approx(21.5)


def test_the_time_tag_of_the_receiver_is_no_datum(ubx: Any) -> None:
    frame = ubx.message(
        "ESF-MEAS", [_datum(16, 1024), _datum(5, 999)], timeTag=1, flags=1 << 11 | 8
    )
    table = ubx.decode([frame]).tables[IMU]
    assert table["accel_x_mps2"][0] == 1
    assert np.isnan(table["gyro_z_radps"][0])


def test_the_counter_goes_on_where_it_wraps(ubx: Any) -> None:
    start = (1 << 32) - 25
    decoded = ubx.decode([_meas(ubx, start + 10 * step, [_datum(16, step)]) for step in range(6)])
    assert np.diff(decoded.tick_ns[IMU]).tolist() == [10_000_000] * 5


def _raw(ubx: Any, tick: float, value: int, clock_ms: int) -> bytes:
    """Two samples on three axes, 256 ticks apart."""
    blocks = [
        {**_datum(kind, value), "sTtag": round(tick + later) % RAW_TURN}
        for later in (0, 256)
        for kind in (16, 17, 18)
    ]
    return bytes(ubx.message("ESF-RAW", blocks, msss=clock_ms % (1 << 32)))


@settings(max_examples=20)
@given(
    st.integers(0, RAW_TURN - 1),
    st.lists(st.integers(20, 4_000_000), min_size=1, max_size=6),
    st.booleans(),
)
def test_raw_samples_bear_the_receivers_clock(
    ubx: Any, start: int, gaps_ms: list[int], cut: bool
) -> None:
    """Whatever turns the sensor's counter makes meanwhile, and however slow it is."""
    times = np.cumsum([(1 << 32) - 100, *gaps_ms])
    frames = [_raw(ubx, start + 25.5 * float(time), 7, int(time)) for time in times]
    decoded = ubx.decode(frames, [1] if cut else [])
    told = decoded.tick_ns[IMU].reshape(-1, 2)
    assert np.diff(told[:, 0]).tolist() == (np.diff(times) * 1_000_000).tolist()
    assert np.diff(told, axis=1).tolist() == [[10_000_000]] * times.size
    assert decoded.about["imu0"]["message"] == "ESF-RAW"
    assert "BMI160" in decoded.about["imu0"]["tick_basis"]


def test_raw_samples_without_the_receivers_clock_bear_the_sensors(ubx: Any) -> None:
    frames = [_raw(ubx, RAW_TURN - 300 + 512 * step, 7, 0) for step in range(4)]
    assert np.diff(ubx.decode(frames, [2]).tick_ns[IMU]).tolist() == [10_000_000] * 7


def test_providers_are_sources_as_they_appear(ubx: Any) -> None:
    frames = [
        _meas(ubx, 1, [_datum(16, 1)], id=7),
        ubx.message("ESF-RAW", [{**_datum(16, 2), "sTtag": 5}]),
        _meas(ubx, 1, [_datum(16, 3)], id=3),
        _meas(ubx, 2, [_datum(16, 4)], id=7),
    ]
    for cuts in ([], [1, 2, 3]):
        decoded = ubx.decode(frames, cuts)
        told = [
            (decoded.tables[f"/imu{number}/imu"]["accel_x_mps2"] * 1024).tolist()
            for number in range(3)
        ]
        assert told == [[1, 4], [2], [3]]


def test_sources_are_bounded(ubx: Any) -> None:
    decoded = ubx.decode([_meas(ubx, 1, [_datum(16, 1)], id=number) for number in range(20)])
    assert len(decoded.tables) == MAX_SOURCES
    assert decoded.rejected == {
        f"UBX ESF-MEAS: of a data provider beyond {MAX_SOURCES} sources": 4 * 20
    }


def test_wheels(ubx: Any) -> None:
    backwards = 1 << 23
    decoded = ubx.decode(
        [
            _meas(
                ubx,
                9,
                [_datum(8, 41), _datum(9, backwards | 42), _datum(10, 43), _datum(11, -1500)],
            )
        ]
    )
    table = decoded.tables["/imu0/odometer"]
    assert table.texts("wheel") == ["rear-left", "rear-right", "single", None]
    assert table["ticks"].tolist() == [41, 42, 43, 0]
    assert table.valid("ticks").tolist() == [True, True, True, False]
    assert table["speed_mps"][3] == -1.5
    assert np.isnan(table["speed_mps"][:3]).all()


def test_types_that_the_schema_lacks_are_refused(ubx: Any) -> None:
    decoded = ubx.decode([_meas(ubx, 1, [_datum(33, 1)])])
    assert decoded.rejected == {"UBX ESF-MEAS: no data of a type in the schema": 20}


def test_rows_without_a_valid_value_are_refused(ubx: Any) -> None:
    frames = [ubx.message("ESF-INS", iTOW=1000), ubx.message("NAV-ATT", iTOW=1000)]
    decoded = ubx.decode(frames)
    assert not decoded.tables
    assert decoded.rejected == {
        "UBX ESF-INS: no value valid": 44,
        "UBX NAV-ATT: no value valid": 40,
    }


def test_attitude_and_dynamics_of_one_epoch_are_one_row(ubx: Any) -> None:
    frames = [
        ubx.message("NAV-ATT", iTOW=1000, roll=-100_000, accHeading=50_000),
        ubx.message(
            "ESF-INS", iTOW=1000, flags=1 << 10 | 1 << 11, zAngRate=-2000, xAccel=150, yAccel=9
        ),
        ubx.message("NAV-PVT", iTOW=1000, fixType=4, flags=1 | 32, headVeh=9_000_000),
    ]
    decoded = ubx.decode(frames)
    table = decoded.tables["/ins0/ins/pva"]
    assert len(table) == 1
    assert table["roll_deg"][0] == pytest.approx(-1)
    assert table["rate_z_radps"][0] == pytest.approx(np.radians(-2))
    assert table["linear_accel_x_mps2"][0] == pytest.approx(1.5)
    assert np.isnan(table["linear_accel_y_mps2"][0])
    assert table["yaw_deg"][0] == 0  # NAV-ATT tells it first


def test_the_vehicles_angles_have_flags_each(ubx: Any) -> None:
    frame = ubx.message(
        "NAV-PVAT",
        iTOW=1000,
        fixType=4,
        flags=1 | 16,
        vehPitch=250_000,
        vehRoll=7,
        accPitch=120,
        velN=1500,
        lat=10,
    )
    table = ubx.decode([frame]).tables["/ins0/ins/pva"]
    assert table["pitch_deg"][0] == pytest.approx(2.5)
    assert np.isnan(table["roll_deg"][0])
    assert table["attitude_acc_deg"][0] == pytest.approx(1.2)
    assert table["vel_n_mps"][0] == pytest.approx(1.5)


def test_alignment_fusion_and_version_are_told_of_the_sources(ubx: Any) -> None:
    extensions = [
        {"extension": b"FWVER=HPS 1.21"},
        {"extension": b"PROTVER=33.21"},
        {"extension": b"MOD=ZED-F9R"},
    ]
    frames = [
        ubx.message(
            "MON-VER", extensions, swVersion=b"EXT CORE 1.00 (a669b8)", hwVersion=b"00190000"
        ),
        ubx.message("ESF-ALG", iTOW=1000, flags=4 << 1, yaw=17_950, pitch=-120, roll=5),
        ubx.message(
            "ESF-STATUS",
            [{"sensStatus1": 5 | 64, "sensStatus2": 2}],
            iTOW=1000,
            version=2,
            fusionMode=1,
        ),
        ubx.message("NAV-PVT", iTOW=1000, fixType=3, flags=1),
        ubx.message("NAV-ATT", iTOW=1000, accRoll=1),
    ]
    decoded = ubx.decode(frames)
    assert decoded.about["gnss0"]["device"] == "ZED-F9R"
    assert decoded.about["gnss0"]["firmware"] == "HPS 1.21"
    assert decoded.about["gnss0"]["protocol_version"] == "33.21"
    assert decoded.about["gnss0"]["solution"] == "fused"
    ins = decoded.about["ins0"]
    assert (ins["mounting_yaw_deg"], ins["mounting_pitch_deg"], ins["mounting_status"]) == (
        "179.5",
        "-1.2",
        "fine",
    )
    assert json.loads(ins["fusion_reports"]) == {"fusing": 1}
    assert json.loads(ins["fusion_sensors"]) == [
        {"type": 5, "used": True, "calibration": "calibrated"}
    ]
    assert set(decoded.rejected) == {
        f"UBX {name}: told in the metadata" for name in ("MON-VER", "ESF-ALG", "ESF-STATUS")
    }
