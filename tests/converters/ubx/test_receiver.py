"""Fix types, satellites' numbers, and the receiver's word on jamming and spoofing."""

from typing import Any

import numpy as np
import pytest

from spoofbench.schema.v1 import gnss_pb2

PVT, SIGNAL, INTEGRITY = "/gnss0/gnss/pvt", "/gnss0/gnss/signal", "/gnss0/gnss/integrity"


@pytest.mark.parametrize(
    ("fix", "flags", "expected"),
    [
        (0, 0, gnss_pb2.FIX_TYPE_NONE),
        (1, 1, gnss_pb2.FIX_TYPE_DEAD_RECKONING),
        (2, 1, gnss_pb2.FIX_TYPE_2D),
        (3, 1, gnss_pb2.FIX_TYPE_3D),
        (3, 3, gnss_pb2.FIX_TYPE_DIFFERENTIAL),
        (3, 0, gnss_pb2.FIX_TYPE_NONE),
        (3, 3 | 1 << 6, gnss_pb2.FIX_TYPE_RTK_FLOAT),
        (3, 3 | 2 << 6, gnss_pb2.FIX_TYPE_RTK_FIXED),
        (4, 3, gnss_pb2.FIX_TYPE_GNSS_DEAD_RECKONING),
        (5, 1, gnss_pb2.FIX_TYPE_TIME_ONLY),
    ],
)
def test_fix_types(ubx: Any, fix: int, flags: int, expected: int) -> None:
    table = ubx.decode(
        [ubx.message("NAV-PVT", iTOW=1000, fixType=fix, flags=flags, lat=5, velN=3)]
    ).tables[PVT]
    assert table["fix_type"].tolist() == [expected]
    assert np.isnan(table["lat_deg"][0]) == (expected == gnss_pb2.FIX_TYPE_NONE)
    assert np.isnan(table["vel_n_mps"][0]) == (expected == gnss_pb2.FIX_TYPE_NONE)


def test_a_status_without_a_fix_takes_the_position_away(ubx: Any) -> None:
    frames = [
        ubx.message("NAV-POSLLH", iTOW=1000, lat=5),
        ubx.message("NAV-STATUS", iTOW=1000, gpsFix=0),
    ]
    assert np.isnan(ubx.decode(frames).tables[PVT]["lat_deg"][0])


def test_solutions_before_u_blox_8(ubx: Any) -> None:
    octets = ubx.payload("NAV-PVT", iTOW=1000, fixType=3, flags=1, lat=123, pDOP=170, flags3=1)[
        :84
    ]  # these end before flags3 has a meaning
    table = ubx.decode([ubx.frame("NAV-PVT", octets[:78] + bytes(6))]).tables[PVT]
    assert (table["lat_deg"][0], table["pdop"][0]) == (pytest.approx(1.23e-5), pytest.approx(1.7))


def test_the_single_numbering_of_satellites(ubx: Any) -> None:
    expected = {
        1: (gnss_pb2.CONSTELLATION_GPS, 1),
        33: (gnss_pb2.CONSTELLATION_BEIDOU, 6),
        64: (gnss_pb2.CONSTELLATION_BEIDOU, 37),
        65: (gnss_pb2.CONSTELLATION_GLONASS, 1),
        120: (gnss_pb2.CONSTELLATION_SBAS, 120),
        159: (gnss_pb2.CONSTELLATION_BEIDOU, 1),
        173: (gnss_pb2.CONSTELLATION_IMES, 1),
        193: (gnss_pb2.CONSTELLATION_QZSS, 1),
        211: (gnss_pb2.CONSTELLATION_GALILEO, 1),
        255: (gnss_pb2.CONSTELLATION_GLONASS, None),
        203: (None, None),
    }
    channels = [
        {"chn": 9},
        *({"svid": number, "cno": 30} for number in expected),
        {"chn": 255},
    ]  # the first and last have no satellite
    table = ubx.decode([ubx.message("NAV-SVINFO", channels, iTOW=1000)]).tables[SIGNAL]
    for row, (constellation, number) in enumerate(expected.values()):
        assert (
            table["constellation"][row] if table.valid("constellation")[row] else None
        ) == constellation
        assert (table["svid"][row] if table.valid("svid")[row] else None) == number


def test_signals_have_the_direction_of_their_satellite(ubx: Any) -> None:
    sky = [
        {"gnssId": 2, "svId": 7, "elev": 30, "azim": 200, "cno": 40},
        {"gnssId": 0, "svId": 7, "elev": -91, "cno": 41},
    ]
    heard = [
        {"gnssId": 0, "svId": 7, "cno": 41},
        {"gnssId": 2, "svId": 7, "sigId": 6, "cno": 38},
        {"gnssId": 2, "svId": 8, "cno": 20},
    ]
    table = ubx.decode(
        [ubx.message("NAV-SIG", heard, iTOW=1000), ubx.message("NAV-SAT", sky, iTOW=1000)]
    ).tables[SIGNAL]
    assert table.texts("signal") == ["1C", "7Q", "1C"]
    assert table["elevation_deg"].tolist() == pytest.approx([np.nan, 30, np.nan], nan_ok=True)
    assert table["azimuth_deg"].tolist() == pytest.approx([np.nan, 200, np.nan], nan_ok=True)


def test_satellites_stand_in_where_an_epoch_has_no_signals(ubx: Any) -> None:
    frames = [
        ubx.message("NAV-SAT", [{"svId": 1, "cno": 30}], iTOW=1000),
        ubx.message("NAV-SIG", [{"svId": 2, "cno": 30}], iTOW=2000),
        ubx.message("NAV-SAT", [{"svId": 2, "cno": 30}], iTOW=2000),
        ubx.message("NAV-SVINFO", [{"svid": 3, "cno": 30}], iTOW=3000),
    ]
    decoded = ubx.decode(frames)
    assert decoded.tables[SIGNAL]["svid"].tolist() == [1, 2, 3]
    assert decoded.epoch[SIGNAL].tolist() == [0, 1, 2]


def test_subframes_keep_their_bytes(ubx: Any) -> None:
    frames = [
        ubx.message(
            "RXM-SFRBX",
            [{"dwrd": 0x22C34D21}, {"dwrd": 0x00000001}],
            gnssId=2,
            svId=4,
            sigId=1,
            version=2,
        ),
        ubx.message("RXM-SFRB", svid=70, dwrd=np.arange(10)),
    ]
    table = ubx.decode(frames).tables["/gnss0/gnss/navdata"]
    assert table.texts("subframe") == [
        bytes.fromhex("22c34d2100000001"),
        np.arange(10, dtype=">u4").tobytes(),
    ]
    assert table.texts("signal") == ["1B", "1C"]
    assert table["svid"].tolist() == [4, 6]


@pytest.mark.parametrize(
    ("octets", "spoofing", "jamming"),
    [
        (
            bytes([2, 0b0_010_1_10_1, 0, 0]),
            gnss_pb2.SPOOFING_STATE_INDICATED,
            gnss_pb2.JAMMING_STATE_WARNING,
        ),
        (
            bytes([2, 0b0_011_1_11_1, 0, 0]),
            gnss_pb2.SPOOFING_STATE_CONFIRMED,
            gnss_pb2.JAMMING_STATE_CRITICAL,
        ),
        (
            bytes([2, 0b0_010_0_10_0, 0, 0]),
            gnss_pb2.SPOOFING_STATE_UNKNOWN,
            gnss_pb2.JAMMING_STATE_UNKNOWN,
        ),  # detection is off
        (
            bytes([1, 0, 0, 0, 0b011, 0, 0, 0, 0b0011, 0, 0, 0]),
            gnss_pb2.SPOOFING_STATE_NONE,
            gnss_pb2.JAMMING_STATE_NONE,
        ),
    ],
)
def test_the_receivers_word(ubx: Any, octets: bytes, spoofing: int, jamming: int) -> None:
    table = ubx.decode([ubx.frame("SEC-SIG", octets)]).tables[INTEGRITY]
    assert (table["spoofing"][0], table["jamming"][0]) == (spoofing, jamming)


def test_older_words_are_one_row_until_the_newer_speaks(ubx: Any) -> None:
    def older(second: int) -> list[bytes]:
        blocks = [{"flags": 1}, {"flags": 2, "blockId": 1}]
        return [
            ubx.message("NAV-STATUS", iTOW=second * 1000, flags2=2 << 3),
            ubx.message("MON-RF", blocks),
        ]

    frames = [*older(1), *older(2), ubx.frame("SEC-SIG", bytes([2, 0b1001, 0, 0]))]
    frames += [frame for second in range(3, 23) for frame in older(second)]
    for cuts in ([], [2, 3, 5, 30]):
        decoded = ubx.decode(frames, cuts)
        table = decoded.tables[INTEGRITY]
        assert decoded.epoch[INTEGRITY].tolist() == [0, 1]
        assert table["spoofing"].tolist() == [
            gnss_pb2.SPOOFING_STATE_INDICATED,
            gnss_pb2.SPOOFING_STATE_UNKNOWN,
        ]
        assert table["jamming"].tolist() == [
            gnss_pb2.JAMMING_STATE_WARNING,
            gnss_pb2.JAMMING_STATE_UNKNOWN,
        ]
        assert len(decoded.tables["/gnss0/gnss/rf"]) == 44


def test_front_ends_of_u_blox_6(ubx: Any) -> None:
    octets = bytearray(68)
    octets[16:20] = (111).to_bytes(2, "little") + (4095).to_bytes(2, "little")
    octets[22], octets[53] = 3 << 2, 51
    decoded = ubx.decode([ubx.frame("MON-HW", bytes(octets))])
    table = decoded.tables["/gnss0/gnss/rf"]
    assert (table["noise"][0], table["agc"][0], table["jam_indicator"][0]) == pytest.approx(
        (111, 4095 / 8191, 0.2)
    )
    assert decoded.tables[INTEGRITY]["jamming"].tolist() == [gnss_pb2.JAMMING_STATE_CRITICAL]


def test_events_are_told_once(ubx: Any) -> None:
    blocks = [
        {"timeElapsed": 0, "detectionType": 1, "eventType": 0},
        {"timeElapsed": 500, "detectionType": 1, "eventType": 1},
    ]
    decoded = ubx.decode([ubx.message("SEC-SIGLOG", blocks), ubx.message("SEC-SIGLOG", blocks[1:])])
    assert decoded.tables[INTEGRITY]["spoofing"].tolist() == [gnss_pb2.SPOOFING_STATE_INDICATED]
    assert decoded.rejected == {"UBX SEC-SIGLOG: no event within the last second": 24}


def test_covariances_are_valid_each(ubx: Any) -> None:
    frames = [
        ubx.message("NAV-POSLLH", iTOW=1000),
        ubx.message("NAV-COV", iTOW=1000, posCovValid=1, posCovNN=2.5, posCovED=-0.5, velCovNN=9.0),
    ]
    table = ubx.decode(frames).tables[PVT]
    assert (table["cov_nn_m2"][0], table["cov_ed_m2"][0]) == (2.5, -0.5)
    assert np.isnan(table["cov_vel_nn_m2ps2"][0])


def test_what_is_no_finite_number_is_absent(ubx: Any) -> None:
    block = {
        "prMes": np.inf,
        "cpMes": -np.inf,
        "doMes": np.frombuffer(b"\x01\x00\x80\x7f", "<f4")[0],
        "trkStat": 3,
    }
    table = ubx.decode([ubx.message("RXM-RAWX", [block], week=2300)]).tables[
        "/gnss0/gnss/observation"
    ]
    assert all(
        np.isnan(table[name][0]) for name in ("pseudorange_m", "carrier_cycles", "doppler_hz")
    )
