"""Satellites and signals: numbers of all makers, signal ids, use and residuals."""

from types import ModuleType
from typing import Any

import numpy as np
import pytest
from spoofbench_converters.nmea import satellites

from spoofbench.schema.v1 import gnss_pb2 as enums

GPS, SBAS, GALILEO, BEIDOU, QZSS, GLONASS = (
    getattr(enums, f"CONSTELLATION_{name}")
    for name in ("GPS", "SBAS", "GALILEO", "BEIDOU", "QZSS", "GLONASS")
)


@pytest.mark.parametrize(
    ("talker", "number", "constellation", "svid"),
    [
        ("GP", 1, GPS, 1), ("GP", 32, GPS, 32), ("GP", 33, SBAS, 120), ("GP", 64, SBAS, 151),
        ("GP", 123, SBAS, 123),
        ("GP", 75, GLONASS, 11), ("GP", 193, QZSS, 1), ("GL", 65, GLONASS, 1),
        ("GL", 88, GLONASS, 24),
        ("GL", 5, GLONASS, 5), ("GA", 36, GALILEO, 36),
        ("GA", 102, GALILEO, 2), ("GA", 301, GALILEO, 1), ("GB", 63, BEIDOU, 63),
        ("BD", 214, BEIDOU, 14), ("GB", 401, BEIDOU, 1),
        ("GQ", 2, QZSS, 2), ("QZ", 193, QZSS, 1), ("GN", 211, BEIDOU, 11), ("GN", 301, GALILEO, 1),
        ("GN", 70, GLONASS, 6),
        ("GP", 999, GPS, 0), ("GN", 999, 0, 0), ("GA", 0, GALILEO, 0),
    ],
)  # fmt: skip
def test_numbers_of_satellites(talker: str, number: int, constellation: int, svid: int) -> None:
    named = satellites.of_talkers([talker])
    found = satellites.identify(named, np.array([number]))
    assert (int(found[0][0]), int(found[1][0])) == (constellation, svid)


def signals(nmea: ModuleType, *bodies: str) -> list[dict[str, Any]]:
    epochs, _, _ = nmea.decode(
        [nmea.frames(nmea.log("GNRMC,120000.00,A,4717.11,N,00834.00,E,,,010324,,,A", *bodies))]
    )
    found: list[dict[str, Any]] = nmea.rows(epochs, "gnss0", "gnss/signal")
    return found


@pytest.mark.parametrize("none", ["0", "00", ""])
def test_a_satellite_not_received_has_no_cn0(none: str, nmea: ModuleType) -> None:
    rows = signals(
        nmea, f"GPGSV,1,1,02,01,10,020,{none},02,11,030,35", f"PUBX,03,01,7,-,123,10,{none},000"
    )
    assert [(row["svid"], row["cn0_dbhz"]) for row in rows] == [(1, None), (2, 35.0), (7, None)]


def test_signal_ids_and_empty_fields(nmea: ModuleType) -> None:
    rows = signals(
        nmea,
        "GPGSV,2,1,05,01,10,020,40,02,,,35,03,00,000,,04,,,,1",
        "GPGSV,2,2,05,,45,123,30,1",
        "GPGSV,1,1,01,01,10,020,38,6",
        "GAGSV,1,1,01,05,20,030,41,7",
        "GBGSV,1,1,01,06,20,030,42,B",
        "PQGSV,1,1,01,19,50,092,31,0,4",
        "GLGSV,1,1,01,70,50,092,31",
    )
    names = ("constellation", "svid", "signal", "cn0_dbhz")
    assert [tuple(row[name] for name in names) for row in rows] == [
        (GPS, 1, "1C", 40.0), (GPS, 2, "1C", 35.0), (GPS, 3, "1C", None), (GPS, 4, "1C", None),
        (GPS, None, "1C", 30.0),
        (GPS, 1, "2L", 38.0), (GALILEO, 5, "1X", 41.0), (BEIDOU, 6, "7I", 42.0),
        (BEIDOU, 19, None, 31.0), (GLONASS, 6, None, 31.0),
    ]  # fmt: skip
    assert (rows[2]["elevation_deg"], rows[2]["azimuth_deg"]) == (0.0, 0.0)
    assert (rows[1]["elevation_deg"], rows[1]["azimuth_deg"]) == (None, None)


def test_use_is_known_only_of_systems_that_are_listed(nmea: ModuleType) -> None:
    rows = signals(
        nmea,
        "GNGSA,A,3,01,,,,,,,,,,,,1.5,1.0,1.1,1",
        "GNGSA,A,3,01,02,03,04,05,06,07,08,09,10,11,12,1.5,1.0,1.1,3",
        "GPGSV,1,1,02,01,10,020,40,02,10,030,30,1",
        "GAGSV,1,1,02,01,10,020,40,13,10,030,30,7",
        "GLGSV,1,1,01,70,10,020,40,1",
    )
    assert [row["used"] for row in rows] == [True, False, True, None, None]


def test_residuals_find_their_satellites(nmea: ModuleType) -> None:
    rows = signals(
        nmea,
        "GNGSA,A,3,01,02,,,,,,,,,,,1.5,1.0,1.1,1",
        "GNGSA,A,3,70,,,,,,,,,,,,1.5,1.0,1.1,2",
        "GNGRS,120000.00,1,-0.5,1.5,,,,,,,,,,,1,1",
        "GNGRS,120000.00,1,2.5,,,,,,,,,,,,2,1",
        "GPGSV,1,1,02,01,10,020,40,02,10,030,30,1",
        "GPGSV,1,1,01,01,10,020,38,6",
        "GLGSV,1,1,01,70,10,020,40,1",
    )
    assert [row["residual_m"] for row in rows] == [-0.5, 1.5, None, 2.5]


def test_satellites_of_a_ublox_status(nmea: ModuleType) -> None:
    rows = signals(nmea, "PUBX,03,3,1,-,014,06,08,000,12,U,207,43,28,009,66,e,223,57,,064")
    assert [
        (row["constellation"], row["svid"], row["used"], row["azimuth_deg"], row["cn0_dbhz"])
        for row in rows
    ] == [
        (GPS, 1, False, 14.0, 8.0),
        (GPS, 12, True, 207.0, 28.0),
        (GLONASS, 2, False, 223.0, None),
    ]


def test_a_signal_is_once_in_an_epoch(nmea: ModuleType) -> None:
    body = "GPGSV,1,1,01,01,10,020,40,1"
    epochs, rejects, _ = nmea.decode(
        [nmea.frames(nmea.log("GPRMC,120000.00,A,4717.11,N,00834.00,E,,,010324,,,A", body, body))]
    )
    assert len(nmea.rows(epochs, "gnss0", "gnss/signal")) == 1
    assert [(reject.reason, reject.offsets.size) for reject in rejects] == [
        ("NMEA GSV: the same epoch again", 1)
    ]
