"""Fields are read as ``float()`` and pynmea2 read them; what is no field is a reject."""

import datetime
from types import ModuleType
from typing import Any

import numpy as np
import pynmea2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.nmea import fields
from spoofbench_converters.nmea.batch import Addresses, read_frames
from spoofbench_converters.nmea.sentences import KMH_MPS, KNOT_MPS
from spoofbench_converters.serial.contract import ABSENT_NS

NUMBERS = st.from_regex(r"\A[+-]?([0-9]{1,9}(\.[0-9]{0,6})?|\.[0-9]{1,6})\Z") | st.just("")
NOT_NUMBERS = st.text(
    st.characters(codec="ascii", exclude_characters=",*$!", categories=("L", "N", "P", "S")),
    min_size=1,
    max_size=30,
)


def cells(texts: list[str]) -> fields.FieldCells:
    joined = ",".join(texts).encode() + b","
    lengths = np.array([len(text) for text in texts], np.int64)
    return fields.FieldCells(
        np.frombuffer(joined, np.uint8), np.cumsum(lengths + 1) - lengths - 1, lengths
    )


@given(st.lists(NUMBERS, min_size=1, max_size=20))
def test_numbers_are_what_float_makes_of_them(texts: list[str]) -> None:
    read = fields.decimals(cells(texts))
    assert read.readable.all()
    assert read.present.tolist() == [bool(text) for text in texts]
    expected = np.array([float(text) if text else np.nan for text in texts])
    np.testing.assert_array_equal(read.floats(), expected)


@given(st.lists(NUMBERS | NOT_NUMBERS, min_size=1, max_size=20))
def test_only_fixed_point_numbers_are_readable(texts: list[str]) -> None:
    readable = fields.decimals(cells(texts)).readable
    for text, found in zip(texts, readable.tolist(), strict=True):
        plain = text.lstrip("0")
        digits = text[1:] if text[:1] in ("+", "-") else text
        fixed = bool(digits.replace(".", "", 1).isdigit() and digits.isascii())
        if not text or not fixed:
            assert found == (not text), text
        elif len(plain) < 18:
            assert found, text


TIMES = st.times()


@given(st.lists(st.tuples(TIMES, st.integers(0, 6)), min_size=1, max_size=10))
def test_times_of_day(times: list[tuple[Any, int]]) -> None:
    texts, expected = [], []
    for time, decimals in times:
        micro = time.microsecond // 10 ** (6 - decimals) * 10 ** (6 - decimals)
        texts.append(f"{time:%H%M%S}" + (f".{micro:06d}"[: decimals + 1] if decimals else ""))
        expected.append(
            ((time.hour * 60 + time.minute) * 60 + time.second) * 10**9
            + (micro * 1000 if decimals else 0)
        )
    value, readable = fields.time_of_day(cells(texts))
    assert readable.all()
    assert value.tolist() == expected


@pytest.mark.parametrize(
    "text", ["240001", "126000", "120061", "-10000", "12:00:00", "1e5", "120000.1234567890"]
)
def test_what_is_no_time_of_day(text: str) -> None:
    assert not fields.time_of_day(cells([text]))[1][0]


def test_leap_seconds_and_the_end_of_the_day() -> None:
    value, readable = fields.time_of_day(cells(["235960", "235960.5", "240000", ""]))
    assert readable.all()
    assert value.tolist() == [86_400 * 10**9, 86_400_500_000_000, 86_400 * 10**9, ABSENT_NS]


@given(st.dates(min_value=datetime.date(1980, 1, 1), max_value=datetime.date(2079, 12, 31)))
def test_dates_of_two_digit_years(day: Any) -> None:
    value, readable = fields.date_of(cells([f"{day:%d%m%y}"]))
    assert readable[0]
    assert value[0] == np.datetime64(day, "ns").astype(np.int64)


@pytest.mark.parametrize("text", ["2208-1", "310299", "000000", "290223", "0101", "01012020"])
def test_what_is_no_date(text: str) -> None:
    assert not fields.date_of(cells([text]))[1][0]


def test_a_field_that_is_not_readable_rejects_its_sentence_alone(nmea: ModuleType) -> None:
    good = "GPGGA,120001.00,4717.1133,N,00834.0000,E,1,08,1.0,499.6,M,48.0,M,,"
    bad = [
        "GPGGA,120002.00,4717.11x3,N,00834.0000,E,1,08,1.0,499.6,M,48.0,M,,",
        "GPGGA,120003.00,4717.1133,Q,00834.0000,E,1,08,1.0,,M,,M,,",
    ]
    octets = nmea.log(good, *bad, good.replace("120001", "120004"))
    epochs, rejects, _ = nmea.decode([nmea.frames(octets)])
    assert [reject.reason for reject in rejects] == ["NMEA GGA: field not readable"]
    first = len(nmea.sentence(good))
    assert rejects[0].offsets.tolist() == [first, first + len(nmea.sentence(bad[0]))]
    assert len(nmea.rows(epochs, "gnss0", "gnss/pvt")) == 2


PLACES = {  # of each column in the list of fields that pynmea2 gives, and its unit
    "GGA": {
        "quality": 5,
        "num_sv": 6,
        "hdop": 7,
        "height_msl_m": 8,
        "separation_m": 10,
        "diff_age_s": 12,
    },
    "RMC": {"speed_mps": (6, KNOT_MPS), "course_deg": 7},
    "GLL": {},
    "GST": {"sigma_n_m": 5, "sigma_e_m": 6, "sigma_d_m": 7},
    "GSA": {"dimension": 1, "pdop": 14, "hdop": 15, "vdop": 16},
}


NO_DILUTION = 99.99  # what receivers write without a solution
COUNTS = ("quality", "num_sv", "dimension")


def expected(said: Any, name: str) -> dict[str, float]:
    """What pynmea2 says of a sentence, by column."""
    data = [*said.data, *[""] * 20]
    found = {}
    for column, place in PLACES[name].items():
        index, unit = place if isinstance(place, tuple) else (place, 1.0)
        none = not data[index] or (column.endswith("dop") and float(data[index]) == NO_DILUTION)
        found[column] = np.nan if none else float(data[index]) * unit
    if name in ("GGA", "RMC", "GLL"):
        given = said.lat and said.lon
        found |= {
            "lat_deg": said.latitude if given else np.nan,
            "lon_deg": said.longitude if given else np.nan,
        }
    return found


def test_every_field_of_real_sentences_is_what_pynmea2_reads(
    real_log: Any, nmea: ModuleType
) -> None:
    frames = nmea.frames(nmea.content(real_log)[:2_000_000])
    batch, _ = read_frames(frames, Addresses(), None)
    base = {int(offset): place for place, offset in enumerate(frames.offsets().tolist())}
    for name in PLACES:
        if name not in batch.tables:
            continue
        table = batch.tables[name]
        for row, frame in list(enumerate(table["frame"].tolist()))[:300]:
            place = base[int(batch.frames["offset"][frame])]
            text = bytes(frames.octets[frames.starts[place] :][: frames.lengths[place]]).decode()
            if text.startswith("$P"):
                continue
            for column, value in expected(pynmea2.parse(text), name).items():
                found = float(table[column][row])
                found = np.nan if column in COUNTS and found < 0 else found
                np.testing.assert_allclose(
                    found, value, rtol=1e-14, atol=1e-13, err_msg=f"{column} of {text}"
                )


@settings(max_examples=50)
@given(
    knots=st.decimals(0, 2000, places=3),
    kmh=st.decimals(0, 4000, places=1),
    course=st.decimals(0, 360, places=2),
)
def test_of_speeds_the_finer_text_counts(
    nmea: ModuleType, knots: Any, kmh: Any, course: Any
) -> None:
    octets = nmea.log(
        "GPRMC,120001,A,4717.11,N,00834.00,E,,,010120,,,A",
        f"GPVTG,{course},T,,M,{knots},N,{kmh},K,A",
    )
    epochs, _, _ = nmea.decode([nmea.frames(octets)])
    row = nmea.rows(epochs, "gnss0", "gnss/pvt")[0]
    assert row["speed_mps"] == float(knots) * KNOT_MPS
    assert row["course_deg"] == float(course)
    octets = nmea.log(
        "GPRMC,120001,A,4717.11,N,00834.00,E,1,,010120,,,A", f"GPVTG,,T,,M,1,N,{kmh},K,A"
    )
    epochs, _, _ = nmea.decode([nmea.frames(octets)])
    assert nmea.rows(epochs, "gnss0", "gnss/pvt")[0]["speed_mps"] == float(kmh) * KMH_MPS
