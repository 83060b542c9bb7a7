"""Receivers' own bytes in messages give what their decoders make of them, and each message is
accounted for.
"""

from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Convert = Callable[..., Any]

NAV_PVT = (
    "uint32 iTOW\nuint16 year\nuint8 month\nuint8 day\nuint8 hour\nuint8 min\nuint8 sec\nuint8 "
    "valid\nuint32 tAcc\nint32 nano\n"
    "uint8 fixType\nuint8 flags\nuint8 flags2\nuint8 numSV\nint32 lon\nint32 lat\nint32 height\n"
    "int32 hMSL\nuint32 hAcc\nuint32 vAcc\n"
    "int32 velN\nint32 velE\nint32 velD\nint32 gSpeed\nint32 heading\nuint32 sAcc\nuint32 "
    "headAcc\nuint16 pDOP\nuint8[6] reserved1\n"
    "int32 headVeh\nint16 magDec\nuint16 magAcc\n"
)
NAV_SAT = "uint32 iTOW\nuint8 version\nuint8 numSvs\nuint8[2] reserved0\nNavSAT_SV[] sv\n"
NAV_SAT_SV = (
    "uint8 gnssId\nuint8 svId\nuint8 cno\nint8 elev\nint16 azim\nint16 prRes\nuint32 flags\n"
)
SENTENCE = "std_msgs/Header header\nstring sentence\n"


def store(base: Stores) -> Typestore:
    made = get_typestore(base)
    for text, name in ((NAV_PVT, "NavPVT"), (NAV_SAT_SV, "NavSAT_SV"), (NAV_SAT, "NavSAT")):
        made.register(get_types_from_msg(text, f"ublox_msgs/msg/{name}"))
    made.register(get_types_from_msg(SENTENCE, "nmea_msgs/msg/Sentence"))
    return made


STORES = {"ros1": store(Stores.ROS1_NOETIC), "ros2": store(Stores.ROS2_HUMBLE)}


def write(sessions: Any, kind: str, path: Path, messages: list[Any]) -> Path:
    writer = sessions.write_ros1 if kind == "ros1" else sessions.write_ros2
    written: Path = writer(path, messages, store=STORES[kind])
    return written


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_ubx(kind: str, sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    messages, epochs = [], 40
    north, lat = (
        rng.integers(-20_000, 20_000, epochs),
        rng.integers(-800_000_000, 800_000_000, epochs),
    )
    for i in range(epochs):
        stamp = sessions.START_NS + i * 250_000_000
        clock = {
            "iTOW": 1000 + i * 250,
            "year": 2023,
            "month": 11,
            "day": 12,
            "sec": i // 4,
            "valid": 7,
        }
        fix = {
            "fixType": 3,
            "flags": 1,
            "numSV": 9,
            "lat": int(lat[i]),
            "velN": int(north[i]),
            "sAcc": 50,
            "hAcc": 900,
        }
        messages.append(
            sessions.Message(
                "/ublox/navpvt",
                "ublox_msgs/msg/NavPVT",
                stamp,
                {**clock, **fix, "reserved1": np.zeros(6, "u1")},
            )
        )
    result = convert_bag(write(sessions, kind, tmp_path / "bag", messages))
    pvt = result.recording["/gnss0/gnss/pvt"]
    assert (result.used, result.skipped) == (epochs, 0)
    assert pvt.time_ns.tolist() == [message.stamp_ns for message in messages]
    np.testing.assert_allclose(pvt["lat_deg"], lat * 1e-7, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pvt["vel_n_mps"], north * 1e-3, rtol=0, atol=1e-12)
    assert set(pvt["num_sv"].tolist()) == {9}


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_ubx_with_repeated_groups(
    kind: str, sessions: Any, convert_bag: Convert, tmp_path: Path
) -> None:
    def satellite(number: int) -> Any:
        return sessions.build(
            STORES[kind],
            "ublox_msgs/msg/NavSAT_SV",
            {"svId": number, "cno": 30 + number, "elev": -number, "flags": 8},
        )

    messages = []
    for i in range(20):
        seen = [satellite(number) for number in range(1, 2 + i % 5)]
        values = {
            "iTOW": 1000 * i,
            "version": 1,
            "numSvs": len(seen),
            "reserved0": np.zeros(2, "u1"),
            "sv": seen,
        }
        messages.append(
            sessions.Message(
                "/ublox/navsat",
                "ublox_msgs/msg/NavSAT",
                sessions.START_NS + i * sessions.SECOND_NS,
                values,
            )
        )
    result = convert_bag(write(sessions, kind, tmp_path / "bag", messages))
    signal = result.recording["/gnss0/gnss/signal"]
    assert (result.used, result.skipped) == (20, 0)
    assert signal["svid"].tolist() == [number for i in range(20) for number in range(1, 2 + i % 5)]
    assert signal["elevation_deg"].tolist() == [-number for number in signal["svid"].tolist()]
    assert signal["used"].all()


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_sentences(kind: str, sessions: Any, convert_bag: Convert, tmp_path: Path) -> None:
    messages = []
    for i in range(30):
        for text in (
            f"GPGGA,1200{i:02d}.00,4807.{i:03d}8,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,",
            "GPHDT,12.3,T",
            "GPXYZ,1",
        ):
            checksum = reduce(lambda value, octet: value ^ octet, text.encode())
            stamp = sessions.START_NS + i * sessions.SECOND_NS + len(messages) % 3 * 1_000_000
            values = {"sentence": f"${text}*{checksum:02X}\r\n"}
            messages.append(sessions.Message("/nmea", "nmea_msgs/msg/Sentence", stamp, values))
    messages[3] = sessions.Message(
        "/nmea", "nmea_msgs/msg/Sentence", messages[3].stamp_ns, {"sentence": "$GPGGA,wrong*00"}
    )
    messages[6] = sessions.Message(
        "/nmea", "nmea_msgs/msg/Sentence", messages[6].stamp_ns, {"sentence": ""}
    )
    result = convert_bag(write(sessions, kind, tmp_path / "bag", messages))
    assert result.used + result.skipped == len(messages)
    assert {3, 6} <= {reject.offset for reject in result.rejects}
    pvt = result.recording["/gnss0/gnss/pvt"]
    assert len(pvt) == 28
    assert set(pvt.time_ns.tolist()) <= {message.stamp_ns for message in messages}
    assert np.all(np.diff(pvt["lat_deg"]) > 0)
