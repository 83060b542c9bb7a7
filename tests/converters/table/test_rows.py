"""What stands in a table is what stands in the recording: values, times, and every byte accounted
for.
"""

import random
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spoofbench_converters.text import lines

from spoofbench.errors import ConversionError

from .conftest import MAPPING, Result

Convert = Callable[..., Result]
quick = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def _times(result: Result, topic: str = "/imu0/imu") -> list[int]:
    return [int(time) for time in result.recording[topic].time_ns]


def test_values_and_bytes(convert_text: Convert) -> None:
    log = 't,ax,ay,az,note\r\n1.5,1,2,3,a\r\n2.5,4,,6,"b,\nc"\r\n'
    result = convert_text(log)
    imu = result.recording["/imu0/imu"]
    assert _times(result) == [1_500_000_000, 2_500_000_000]
    assert np.array_equal(imu["accel_y_mps2"], [2, np.nan], equal_nan=True)
    assert imu["accel_z_mps2"].tolist() == [3, 6]
    assert (result.ledger.used, result.ledger.skipped) == (len(log), 0)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        (b"3,1,2\n", "another number of cells than the table has columns"),
        (b"3,1,2,3,4,5,6\n", "another number of cells than the table has columns"),
        (b"3,1,x,3,\n", "a cell of 'ay' that is not what the column holds"),
        (b"3,1,inf,3,\n", "a cell of 'ay' that is not what the column holds"),
        (b",1,2,3,\n", "a time that is none"),
        (b"soon,1,2,3,\n", "a time that is none"),
        (b"3,,,,\n", "nothing in the columns that are mapped"),
        (b"3,1,2,3,\xff\n", "text that is not UTF-8"),
        (b"3,1,2\x00,3,\n", "NUL bytes"),
        (b'3,1,2,3,"a"b\n', "quotation marks that do not fit together"),
        (b'3,1,2,3,"a\n', "quotation marks that do not fit together"),
        (b"3,1,2,3," + b"x" * 2**20 + b"\n", "a record of more than 1 MiB"),
    ],
)
def test_damage_costs_one_row(convert_text: Convert, row: bytes, reason: str) -> None:
    before = b't,ax,ay,az,note\n1,1,2,3,\n2,1,2,3,"a"\n'
    log = before + row + b'4,1,2,3,\n5,1,2,3,"a\nb"\n6,1,2,3,'
    result = convert_text(log)
    assert _times(result) == [
        1_000_000_000,
        2_000_000_000,
        4_000_000_000,
        5_000_000_000,
        6_000_000_000,
    ]
    assert dict(result.ledger.reasons) == {reason: len(row)}
    assert [(reject.offset, reject.length) for reject in result.ledger.rejects] == [
        (len(before), len(row))
    ]
    assert result.total == len(log)


def test_a_mark_amid_a_cell_is_a_character(convert_text: Convert) -> None:
    result = convert_text('t,ax,ay,az,note\n1,1,2,3,5" pipe\n2,1,2,3,5" pipe\n')
    assert len(_times(result)) == 2
    assert not result.ledger.reasons


@quick
@given(seed=st.integers(0, 2**32), piece=st.sampled_from([1, 7, 64, 1000]))
def test_pieces_do_not_matter(
    convert_text: Convert, monkeypatch: pytest.MonkeyPatch, seed: int, piece: int
) -> None:
    rng = random.Random(seed)
    rows = [
        rng.choice(
            [
                '{t},1,2,3,"a\nb"\n',
                "{t},1,2,3,\n",
                '{t},1,2,3,"\n',
                '{t},1,"2,3\n',
                "\n",
                '"',
                ',","',
                "{t},1,2,3,x",
            ]
        )
        for _ in range(40)
    ]
    log = (
        "t,ax,ay,az,note\n"
        + "".join(row.replace("{t}", str(place)) for place, row in enumerate(rows))
        + "\n99,1,2,3,\n"
    )
    whole = convert_text(log)
    with monkeypatch.context() as patch:
        patch.setattr(lines, "PIECE_BYTES", piece)
        cut = convert_text(log)
    assert whole.total == cut.total == len(log)
    assert whole.ledger.reasons == cut.ledger.reasons
    assert whole.recording["/imu0/imu"] == cut.recording["/imu0/imu"]


@quick
@given(st.binary(max_size=400))
def test_any_bytes_are_accounted_for(convert_text: Convert, noise: bytes) -> None:
    log = b"t,ax,ay,az,note\n1,1,2,3,\n" + noise.replace(b"\r", b"") + b"\n2,1,2,3,\n"
    result = convert_text(log)
    assert result.total == len(log)
    assert _times(result)[0] == 1_000_000_000 or noise


@quick
@given(
    st.lists(st.decimals("0", "1e9", places=9, allow_nan=False), min_size=1, max_size=20),
    st.sampled_from([("s", 9), ("ms", 6), ("us", 3), ("ns", 0)]),
)
def test_decimal_times_are_exact(
    convert_text: Convert, times: list[Decimal], unit: tuple[str, int]
) -> None:
    name, digits = unit
    written = sorted(
        Decimal(round(time * 10**9)) / 10 ** (9 - digits) / 10**digits * 10 ** (9 - digits)
        for time in times
    )
    log = "t,ax,ay,az\n" + "".join(f"{time:f},1,2,3\n" for time in written)
    result = convert_text(log, MAPPING.replace('"s"', f'"{name}"'))
    assert _times(result) == [round(time * 10**digits) for time in written]


def test_a_bad_time_leaves_the_others_exact(convert_text: Convert) -> None:
    good = [
        "1711303747.217394001",
        "+1711303748.5",
        " 1711303749 ",
        "1.7113037502173940015e9",
        "1711303751.0000000000000000000000001",
    ]
    bad = ["soon", "1_0", "1e400", "-inf", "1e-999999999x", "99999999999999999999"]
    result = convert_text("t,ax,ay,az\n" + "".join(f"{time},1,2,3\n" for time in [*good, *bad]))
    assert _times(result) == [
        1_711_303_747_217_394_001,
        1_711_303_748_500_000_000,
        1_711_303_749_000_000_000,
        1_711_303_750_217_394_002,
        1_711_303_751_000_000_000,
    ]
    assert set(result.ledger.reasons) == {"a time that is none"}


def test_a_bad_number_leaves_the_others_exact(convert_text: Convert) -> None:
    mapping = MAPPING.replace("/imu0/imu", "/gnss0/gnss/integrity").replace(
        'accel = ["ax", "ay", "az"]', 'raw = "ax"'
    )
    cells = [
        "9007199254740993",
        "x",
        "1e400",
        " 12 ",
        "3.0",
        "1.5",
        "nan",
        "-NaN",
        "99999999999999999999",
    ]
    result = convert_text(
        "t,ax\n" + "".join(f"{place},{cell}\n" for place, cell in enumerate(cells)), mapping
    )
    assert result.recording["/gnss0/gnss/integrity"]["raw"].tolist() == [9007199254740993, 12, 3]


@pytest.mark.parametrize(
    ("settings_", "cell", "expected"),
    [
        (
            'column = "t"\nformat = "iso"',
            "2025-07-08T19:34:18.123456789Z",
            "2025-07-08T19:34:18.123456789",
        ),
        ('column = "t"\nformat = "iso"', "2025/07/08 19:34:18.5", "2025-07-08T19:34:18.5"),
        (
            'column = "t"\nformat = "iso"\nzone = "+02:00"',
            "2016-08-09 13:09:51.825",
            "2016-08-09T11:09:51.825",
        ),
        (
            'column = "t"\nformat = "iso"\nzone = "+02:00"',
            "2016-08-09 13:09:51.825-01:00",
            "2016-08-09T14:09:51.825",
        ),
        ('column = "t"\nformat = "%d%m%y %H%M%S"', "260314 123825", "2014-03-26T12:38:25"),
        (
            'column = "t"\nformat = "iso"\nscale = "gps"',
            "2025-07-08 19:34:18",
            "2025-07-08T19:34:00",
        ),
        ('column = "t"\nunit = "s"\nscale = "gps"', "1752003258", "2025-07-08T19:34:00"),
        ('column = "t"\nunit = "s"\nsince = "gps"', "1000000000", "2011-09-14T01:46:25"),
        ('column = "t"\nunit = "ms"\nweek = "ax"', "243258499", "2011-02-01T19:34:03.499"),
        (
            'column = "t"\nunit = "ms"\nweek = "ax"\nleap_seconds = 0',
            "243258499",
            "2011-02-01T19:34:18.499",
        ),
        ('column = "t"\nunit = "day"\nsince = "matlab"', "738000.5", "2020-07-28T12:00:00"),
        ('column = "t"\nunit = "day"\nsince = "1899-12-30"', "45123.25", "2023-07-16T06:00:00"),
        (
            'column = "t"\nunit = "s"\ndate = "note"\ndate_format = "%d%m%y"',
            "3600.5",
            "2014-03-26T01:00:00.5",
        ),
        (
            'column = "t"\nunit = "s"\ndate = "note"\ndate_format = "%d%m%y"\nzone = "-05:00"',
            "3600.5",
            "2014-03-26T06:00:00.5",
        ),
        (
            'column = "t"\ndate = "note"\nformat = "%d%m%y %H:%M:%S.%f"',
            "01:02:03.25",
            "2014-03-26T01:02:03.25",
        ),
        ('column = "t"\nformat = "iso"', "2025-07-08", "2025-07-08"),
        ('column = "t"\nunit = "1e-7 s"', "15000000000000001", "2017-07-14T02:40:00.0000001"),
    ],
)
def test_times_in_all_that_they_are_written_in(
    convert_text: Convert, settings_: str, cell: str, expected: str
) -> None:
    mapping = MAPPING.replace('column = "t"\nunit = "s"', settings_)
    result = convert_text(f"t,ax,ay,az,note\n{cell},1621,2,3,260314\n", mapping)
    assert _times(result) == [int(np.datetime64(expected, "ns").astype(np.int64))]


def test_a_counter_that_starts_over_goes_on(convert_text: Convert) -> None:
    mapping = MAPPING.replace('unit = "s"', 'unit = "ms"\nsince = "start"\nwraps = 65536')
    counts = [65_000, 65_500, 400, 900, 65_400 - 64_000]
    result = convert_text(
        "t,ax,ay,az\n" + "".join(f"{count},1,2,3\n" for count in counts),
        mapping,
        date="2020-01-01T00:01:05",
    )
    start = int(np.datetime64("2020-01-01T00:01:05", "ns").astype(np.int64))
    assert [time - start for time in _times(result)] == [
        0,
        500_000_000,
        936_000_000,
        1_436_000_000,
        1_936_000_000,
    ]


def test_midnight_passes(convert_text: Convert) -> None:
    mapping = MAPPING.replace('unit = "s"', 'unit = "s"\nsince = "day"')
    result = convert_text("t,ax,ay,az\n86399.5,1,2,3\n0.5,1,2,3\n", mapping, date="2020-01-01")
    assert np.diff(_times(result)).tolist() == [1_000_000_000]
    assert result.metadata["recording"]["reference_date"] == "2020-01-01"


@pytest.mark.parametrize(
    ("pattern", "cells"),
    [("%H%M%S.%f", "235959.5 000000.5"), ("%I:%M:%S.%f %p", "11:59:59.5_PM 12:00:00.5_AM")],
)
def test_a_text_of_the_time_of_day_is_of_the_date_that_is_given(
    pattern: str, cells: str, convert_text: Convert
) -> None:
    mapping = MAPPING.replace('unit = "s"', f'format = "{pattern}"\nzone = "+01:00"')
    log = "t,ax,ay,az\n" + "".join(
        f"{cell.replace('_', ' ')},1,2,3\n" for cell in ["x", *cells.split()]
    )
    result = convert_text(log, mapping, date="2020-01-01")
    start = int(np.datetime64("2020-01-01T22:59:59.5", "ns").astype(np.int64))
    assert _times(result) == [start, start + 1_000_000_000]
    assert result.ledger.reasons == {"a time that is none": 8}


def test_a_date_that_is_none_is_refused(convert_text: Convert) -> None:
    with pytest.raises(ConversionError, match="2025-13-01"):
        convert_text("t,ax,ay,az\n1,1,2,3\n", date="2025-13-01")


def test_a_clock_without_date_says_so(convert_text: Convert) -> None:
    result = convert_text(
        "t,ax,ay,az\n5,1,2,3\n", MAPPING.replace('unit = "s"', 'unit = "s"\nsince = "start"')
    )
    assert _times(result) == [5_000_000_000]
    assert "--date" in result.metadata["recording"]["reference_date_basis"]


def test_a_clock_that_jumps_back(convert_text: Convert) -> None:
    log = "t,ax,ay,az\n" + "".join(f"{time},1,2,3\n" for time in (100, 100.5, 101, 50, 50.5, 51))
    result = convert_text(log)
    assert _times(result) == [100_000_000_000, 100_500_000_000, 101_000_000_000]
    assert result.ledger.reasons["time runs backwards"] == len("50,1,2,3\n50.5,1,2,3\n51,1,2,3\n")
    appended = convert_text(log, append_clock=True)
    assert np.diff(_times(appended)).tolist() == [500_000_000] * 5
    assert appended.metadata["recording"]["clock_step_count"] == "1"
    assert appended.total == len(log)


@quick
@given(
    st.lists(
        st.sampled_from([1, 2, 5, 10, 900, 1100, 5000, -5, -900, -1100, -50_000, 50_000]),
        min_size=1,
        max_size=60,
    ),
    st.sampled_from([1, 16, 50]),
)
def test_appending_does_not_depend_on_pieces(
    convert_text: Convert, monkeypatch: pytest.MonkeyPatch, steps: list[int], piece: int
) -> None:
    log = "t,ax,ay,az\n" + "".join(
        f"{time / 1000},1,2,3\n" for time in np.cumsum([10**6, 10, *steps]).tolist()
    )
    whole = convert_text(log, append_clock=True)
    with monkeypatch.context() as patch:
        patch.setattr(lines, "PIECE_BYTES", piece)
        cut = convert_text(log, append_clock=True)
    assert _times(whole) == _times(cut)
    assert whole.metadata == cut.metadata
    assert whole.total == cut.total == len(log)


TOPICS = """
clock = "sensor"
[table.log]
[table.log.time]
column = "t"
unit = "s"
[table.log."/gnss0/gnss/pvt"]
where = { type = "GPS" }
unless = { q = 0 }
changes = ["lat"]
lat_deg = { column = "lat", missing = [0] }
speed_mps = { column = "v", unit = "km/h", missing = [-1] }
fix_type = { column = "q", values = { 1 = "3D", 4 = "RTK_FIXED" } }
time_valid = { column = "ok" }
num_sv = { value = 7 }
receive_time_ns = { column = "r", unit = "ms" }
claims = { column = "tow", unit = "s", week = "week" }
[table.log."/imu0/imu"]
where = { type = ["IMU", "BOTH"] }
accel_z_mps2 = { column = "-v", unit = "g", offset = 1.0 }
[table.log."/gnss0/gnss/signal"]
where = { type = "SAT" }
signal = "ok"
constellation = "r"
svid = "q"
"""


def test_conditions_values_and_constants(convert_text: Convert) -> None:
    rows = [
        "1,GPS,50,36,1.000,true,1001.5,100,2000",
        "2,GPS,50,36,1,true,,,",  # repeated
        "3,GPS,51,-1,9,no,,,",
        "4,GPS,52,1,0,true,,,",  # unless
        "5,IMU,,2,,,,,",
        "6,SAT,,,12,1C,GALILEO,,",
        "7,SAT,,,13,5Q,1,,",
        "8,NEW,,,,,,,",
    ]
    log = "t,type,lat,v,q,ok,r,tow,week\n" + "".join(f"{row}\n" for row in rows)
    result = convert_text(log, TOPICS)
    pvt = result.recording["/gnss0/gnss/pvt"]
    assert pvt.time_ns.tolist() == [1_000_000_000, 3_000_000_000]
    assert np.array_equal(pvt["speed_mps"], [10, np.nan], equal_nan=True)
    assert pvt["fix_type"].tolist() == [4, 0]
    assert pvt.valid("fix_type").tolist() == [True, False]
    assert pvt["time_valid"].tolist() == [True, False]
    assert pvt["num_sv"].tolist() == [7, 7]
    assert (pvt["receive_time_ns"][0], pvt.valid("receive_time_ns").tolist()) == (
        1_001_500_000,
        [True, False],
    )
    assert (pvt["gps_week"][0], pvt["tow_s"][0], pvt.valid("gps_week")[1]) == (2000, 100, False)
    assert result.recording["/imu0/imu"]["accel_z_mps2"].tolist() == [1 - 2 * 9.80665]
    signal = result.recording["/gnss0/gnss/signal"]
    assert (signal.texts("signal"), signal["constellation"].tolist(), signal["svid"].tolist()) == (
        ["1C", "5Q"],
        [3, 1],
        [12, 13],
    )
    lengths = [len(row) + 1 for row in rows]
    assert dict(result.ledger.reasons) == {
        "repeated row": lengths[1],
        "of no topic of the mapping": lengths[3] + lengths[7],
    }
    assert result.metadata["source/gnss0"]["repeated_rows"] == "1"


@pytest.mark.parametrize(
    ("text_", "words"),
    [
        (b"t,ax,ay\n1,2,3\n", "needs a column 'az'; did you mean 'ay'"),
        ("t,ax,ay,az\n1,2,3,4\n".encode("utf-16"), "is UTF-16 text"),
        (b"", "no header"),
        (b",".join(b"c%d" % place for place in range(10_001)) + b"\n", "more than 10,000 columns"),
    ],
)
def test_what_cannot_be_read_is_said(convert_text: Convert, text_: bytes, words: str) -> None:
    with pytest.raises(ConversionError) as caught:
        convert_text(text_)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("layout", "log"),
    [
        ("", "\ufefft,ax,ay,az\n1,1,2.5,3\n"),
        ('delimiter = ";"\ndecimal_comma = true', "t;ax;ay;az\n1,0;1;2,5;3\n"),
        ('delimiter = "\\t"', "t\tax\tay\taz\n1\t1\t2.5\t3\n"),
        ('delimiter = "whitespace"', "  t ax\tay   az\n  1   1  2.5 3  \n"),
        ('header = false\ncolumns = ["t", "ax", "ay", "az", "more"]', "1,1,2.5,3\n"),
        ('comment = "#"\nskip_lines = 1', 'a logger\n# of mine\nt,ax,ay,az\n# "\n1,1,2.5,3\n'),
        ("", "t,ax,ay,az\r1,1,2.5,3\r"),
        ("", "t,ax,ay,az\r\n\r\n1, 1 ,2.5,3,\r\n"),
        ('encoding = "latin-1"', "t,ax,ay,az,ä\n1,1,2.5,3,ü\n"),
    ],
)
def test_layouts(convert_text: Convert, layout: str, log: str) -> None:
    octets = log.encode("latin-1" if "latin" in layout else "utf-8")
    result = convert_text(
        octets, MAPPING.replace("[table.log.time]", f"[table.log]\n{layout}\n[table.log.time]")
    )
    assert _times(result) == [1_000_000_000]
    assert result.recording["/imu0/imu"]["accel_y_mps2"].tolist() == [2.5]
    assert (result.ledger.used, result.ledger.skipped) == (len(octets), 0)


def test_source_and_session_are_chosen(convert_text: Convert) -> None:
    mapping: Any = (
        MAPPING
        + '\n[table.log."/imu1/imu"]\ngyro_x_radps = "ax"\n'
        + '[table.log."/baro0/baro"]\npressure_pa = "ay"\n'
    )
    result = convert_text("t,ax,ay,az\n1,1,2,3\n", mapping, source="imu1", session="monday")
    assert set(result.recording) == {"/imu1/imu", "/baro0/baro"}
    assert result.metadata["recording"]["session_id"] == "monday"
    with pytest.raises(ConversionError, match="no source 'imu7'"):
        convert_text("t,ax,ay,az\n1,1,2,3\n", mapping, source="imu7")
