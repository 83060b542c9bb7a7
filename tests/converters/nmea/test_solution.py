"""What an epoch's sentences make together: fix types, accuracies, heights, and makers' own
sentences.
"""

from types import ModuleType
from typing import Any

import pytest

from spoofbench.gnss_time import DAY_NS
from spoofbench.schema.v1 import gnss_pb2 as enums


def solution(nmea: ModuleType, *bodies: str) -> dict[str, Any]:
    epochs, _, _ = nmea.decode([nmea.frames(nmea.log(*bodies))])
    (row,) = nmea.rows(epochs, "gnss0", "gnss/pvt")
    found: dict[str, Any] = row
    return found


def gga(quality: str, height: str = "499.6") -> str:
    return f"GPGGA,120000.00,4717.1133,N,00834.0000,E,{quality},08,1.0,{height},M,48.0,M,2.5,0120"


@pytest.mark.parametrize(
    ("quality", "fix_type"),
    [
        ("0", "NONE"),
        ("1", "3D"),
        ("2", "DIFFERENTIAL"),
        ("3", "3D"),
        ("4", "RTK_FIXED"),
        ("5", "RTK_FLOAT"),
        ("6", "DEAD_RECKONING"),
        ("8", "SIMULATED"),
    ],
)
def test_fix_types_of_gga(quality: str, fix_type: str, nmea: ModuleType) -> None:
    row = solution(nmea, gga(quality))
    assert row["fix_type"] == enums.FixType.Value(f"FIX_TYPE_{fix_type}")
    assert (row["lat_deg"] is None) == (quality == "0")
    assert row["height_m"] == (None if quality == "0" else 547.6)
    assert row["period_ns"] == DAY_NS


def test_a_manual_position_is_of_no_fix_type(nmea: ModuleType) -> None:
    assert solution(nmea, gga("7"))["fix_type"] is None


def test_dimensions(nmea: ModuleType) -> None:
    assert solution(nmea, gga("1", ""))["fix_type"] == enums.FIX_TYPE_2D
    assert (
        solution(nmea, gga("1"), "GPGSA,A,2,01,,,,,,,,,,,,2.0,1.0,1.5")["fix_type"]
        == enums.FIX_TYPE_2D
    )


def test_a_fix_of_no_known_dimension_has_no_type(nmea: ModuleType) -> None:
    rmc = "GPRMC,120000,A,4717.11,N,00834.00,E,0.0,,010324,,,{}"
    assert solution(nmea, rmc.format("A"))["fix_type"] is None
    assert solution(nmea, rmc.format("D"))["fix_type"] == enums.FIX_TYPE_DIFFERENTIAL
    assert (
        solution(nmea, rmc.format("A"), "GPGSA,A,2,01,,,,,,,,,,,,2.0,1.0,1.5")["fix_type"]
        == enums.FIX_TYPE_2D
    )


def test_dilutions_without_a_solution_are_absent(nmea: ModuleType) -> None:
    row = solution(
        nmea, "GPGGA,120000.00,,,,,0,00,99.99,,,,,,", "GPGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99"
    )
    assert (row["hdop"], row["vdop"], row["pdop"], row["fix_type"]) == (
        None,
        None,
        None,
        enums.FIX_TYPE_NONE,
    )


@pytest.mark.parametrize(
    ("modes", "fix_type"),
    [
        ("NN", "NONE"),
        ("AN", "3D"),
        ("DA", "DIFFERENTIAL"),
        ("FR", "RTK_FIXED"),
        ("E", "DEAD_RECKONING"),
    ],
)
def test_the_best_mode_of_all_systems_counts(modes: str, fix_type: str, nmea: ModuleType) -> None:
    row = solution(nmea, f"GNGNS,120000.00,4717.1133,N,00834.0000,E,{modes},18,0.7,499.6,48.0,,")
    assert row["fix_type"] == enums.FixType.Value(f"FIX_TYPE_{fix_type}")
    assert row["num_sv"] == 18


def test_standard_deviations(nmea: ModuleType) -> None:
    row = solution(nmea, gga("1"), "GPGST,120000.00,1.0,5.0,4.0,45.0,3.0,4.0,6.0")
    assert (
        row["h_acc_m"],
        row["v_acc_m"],
        row["cov_nn_m2"],
        row["cov_ee_m2"],
        row["cov_dd_m2"],
    ) == (5.0, 6.0, 9.0, 16.0, 36.0)
    assert (row["hdop"], row["diff_age_s"], row["num_sv"]) == (1.0, 2.5, 8)


def test_garmins_errors(nmea: ModuleType) -> None:
    row = solution(nmea, gga("1"), "PGRME,15.0,M,45.0,M,25.0,M")
    assert (row["h_acc_m"], row["v_acc_m"]) == (15.0, 45.0)


def test_ublox_positions(nmea: ModuleType) -> None:
    position = (
        "PUBX,00,103607.00,5327.03942,N,00214.42462,W,104.461,G3,29,31,36.00,39.63,-0.007,"
        ",5.88,7.62,8.09,6,0,0"
    )
    row = solution(nmea, position, "PUBX,04,103607.00,060321,556567.00,2147,18,-384839,-53.623,16")
    assert (row["height_m"], row["speed_mps"], row["course_deg"], row["vel_d_mps"]) == (
        104.461,
        36.0 / 3.6,
        39.63,
        -0.007,
    )
    assert (row["fix_type"], row["num_sv"], row["hdop"], row["vdop"]) == (
        enums.FIX_TYPE_3D,
        6,
        5.88,
        7.62,
    )
    assert (row["gps_week"], row["tow_s"], row["time_valid"]) == (2147, 556585.0, True)


def test_a_default_leap_second_makes_no_date(nmea: ModuleType) -> None:
    row = solution(
        nmea,
        gga("1").replace("120000.00", "103607.00"),
        "PUBX,04,103607.00,060321,556567.00,2147,15D,-384839,-53.623,16",
    )
    assert row["period_ns"] == DAY_NS


def test_gps_time_counts_an_inserted_second(nmea: ModuleType) -> None:
    """The last second of 2016 was followed by an inserted one, which sentences number 60."""
    found = [
        solution(nmea, f"GPRMC,{time},A,4717.11,N,00834.00,E,0.0,,{day},,,A")
        for time, day in (("235959", "311216"), ("235960", "311216"), ("000000", "010117"))
    ]
    assert [(row["gps_week"], row["tow_s"]) for row in found] == [
        (1930, 16.0),
        (1930, 17.0),
        (1930, 18.0),
    ]


def test_a_course_that_is_left_empty_is_absent(nmea: ModuleType) -> None:
    row = solution(nmea, "GPRMC,120000,A,4717.11,N,00834.00,E,0.0,,010324,,,A")
    assert (row["speed_mps"], row["course_deg"]) == (0.0, None)


def test_an_empty_burst_has_nothing(nmea: ModuleType) -> None:
    row = solution(nmea, "GPVTG,,T,,M,,N,,K,N", "GPGGA,,,,,,0,,,,M,,M,,")
    given = {name for name, value in row.items() if value is not None}
    assert given == {"epoch", "claimed_ns", "period_ns", "offset_ns", "fix_type"}
    assert row["fix_type"] == enums.FIX_TYPE_NONE


def test_attitude_and_datum(nmea: ModuleType) -> None:
    bodies = [
        gga("1"),
        "PASHR,120000.00,123.4,T,+1.5,-2.5,0.1,0.2,0.3,0.4,1,1",
        "GPTHS,77.5,A",
        "GPHDT,,T",
        "GPDTM,P90,,0.0,S,0.0,E,0.97,W84",
    ]
    epochs, rejects, decoder = nmea.decode([nmea.frames(nmea.log(*bodies))])
    (attitude,) = nmea.rows(epochs, "ins0", "ins/pva")
    assert [
        attitude[name] for name in ("roll_deg", "pitch_deg", "yaw_deg", "attitude_acc_deg")
    ] == [1.5, -2.5, 123.4, 0.4]
    (heading,) = nmea.rows(epochs, "ins1", "ins/pva")
    assert heading["yaw_deg"] == 77.5
    assert decoder.about()["gnss0"]["datum"] == "P90"
    assert [reject.reason for reject in rejects] == ["NMEA HDT: no value"]
