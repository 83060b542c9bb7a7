"""Tables in JSON: both layouts of pandas say the same, each byte is accounted for, and a recording
holds one flight.
"""

import gzip
import io
import json
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_converters import table
from spoofbench_converters.table.json_rows import json_rows

from spoofbench.conversion import Rejects, Source
from spoofbench.errors import ConversionError
from spoofbench.testing import check_converter

from .conftest import Result, convert_table

START_MS = 1_726_560_000_000


def _flight(seconds: int, icao24: str = "4baac6", callsign: str | None = "THY9BP") -> list[Any]:
    return [
        {
            "timestamp": START_MS + 1000 * second,
            "icao24": icao24,
            "callsign": callsign,
            "latitude": 49.0 + 0.001 * second,
            "longitude": 23.0,
            "altitude": 38000.0,
            "groundspeed": 450.0,
            "track": 10.0,
            "vertical_rate": -64.0 if second % 3 else None,
            "last_position": START_MS + 2000 * (second // 2) - 500,
        }
        for second in range(seconds)
    ]


def _records(rows: list[Any]) -> bytes:
    return json.dumps(rows, separators=(",", ":")).encode()


def _columns(rows: list[Any]) -> bytes:
    return str(pd.DataFrame(rows).to_json()).encode()


def _parquet(rows: list[Any]) -> bytes:
    """Return the table as traffic writes it, with times as such."""
    frame, buffer = pd.DataFrame(rows), io.BytesIO()
    for name in ("timestamp", "last_position"):
        frame[name] = pd.to_datetime(frame[name], unit="ms", utc=True)
    frame.to_parquet(buffer)
    return buffer.getvalue()


def _written(folder: Path, octets: bytes, name: str = "log.json.gz") -> Path:
    path = folder / name
    path.write_bytes(gzip.compress(octets, mtime=0) if name.endswith(".gz") else octets)
    return path


def _converted(folder: Path, octets: bytes, name: str = "log.json.gz", **options: Any) -> Result:
    path = _written(folder, octets, name)
    assert table.sniff(Source.of(path)) == 0.9
    result = convert_table(path, **options)
    assert result.total == len(octets)
    return result


@pytest.mark.parametrize("write", [_records, _columns])
def test_units_signs_and_times(tmp_path: Path, write: Any) -> None:
    pvt = _converted(tmp_path, write(_flight(60))).recording["/gnss0/gnss/pvt"]
    assert len(pvt) == 30
    assert np.array_equal(pvt.time_ns // 10**6, START_MS + 2000 * np.arange(30) - 500)
    assert np.allclose(pvt["speed_mps"], 450 * 1852 / 3600)
    assert np.allclose(pvt["height_msl_m"], 38000 * 0.3048)
    assert "height_m" not in pvt
    climb = pvt["vel_d_mps"]
    assert np.allclose(climb[~np.isnan(climb)], 64 * 0.3048 / 60)
    assert np.array_equal(np.isnan(climb), np.arange(0, 60, 2) % 3 == 0)


def test_both_layouts_and_text_give_the_same_rows(tmp_path: Path) -> None:
    rows = _flight(50)
    text = pd.DataFrame(rows).to_csv(index=False).encode()
    one, *others = (
        _converted(tmp_path, octets, name).recording["/gnss0/gnss/pvt"]
        for octets, name in (
            (_records(rows), "a.json"),
            (_records(rows), "a.json.gz"),
            (_columns(rows), "b.json"),
            (text, "c.csv"),
            (_parquet(rows), "d.parquet"),
        )
    )
    for other in others:
        assert np.array_equal(one.time_ns, other.time_ns)
        for name in ("lat_deg", "speed_mps", "course_deg", "vel_d_mps", "height_msl_m"):
            assert np.array_equal(one[name], other[name], equal_nan=True), name


def test_without_the_time_of_a_position_only_its_first_row_counts(tmp_path: Path) -> None:
    rows = _flight(60)
    for number, row in enumerate(rows):
        del row["last_position"]
        row["latitude"] = rows[number - number % 4]["latitude"]
    pvt = _converted(tmp_path, _records(rows)).recording["/gnss0/gnss/pvt"]
    assert np.array_equal(pvt.time_ns // 10**6, START_MS + 4000 * np.arange(15))


@pytest.mark.parametrize("write", [_records, _columns])
def test_several_flights_are_refused_and_one_can_be_chosen(tmp_path: Path, write: Any) -> None:
    octets = write([*_flight(20), *_flight(30, "39b415", "AFR1"), *_flight(8, "39b415", None)])
    path = _written(tmp_path, octets)
    with pytest.raises(ConversionError, match=r"several flights: 'icao24' .*-p flight=39b415"):
        convert_table(path)
    result = convert_table(path, flight="39b415 AFR1")
    assert len(result.recording["/gnss0/gnss/pvt"]) == 15
    assert result.metadata["recording"]["callsign"] == "AFR1"
    assert result.ledger.reasons["of another flight"] > 0
    assert result.total == len(octets)


def test_a_stray_row_of_another_flight_is_left_out(tmp_path: Path) -> None:
    rows = [*_flight(1, "0aaaaa", None), *_flight(40)[1:]]
    result = _converted(tmp_path, _records(rows))
    assert result.metadata["recording"]["icao24"] == "4baac6"
    assert result.ledger.reasons["of another flight"] > 0


def test_a_callsign_that_is_missing_for_a_while_tells_no_flights_apart(tmp_path: Path) -> None:
    rows = _flight(40)
    for row in rows[:10]:
        row["callsign"] = None
    assert len(_converted(tmp_path, _records(rows)).recording["/gnss0/gnss/pvt"]) == 20


@given(data=st.data())
def test_a_wrong_byte_costs_at_most_the_records_it_touches(data: st.DataObject) -> None:
    rows = _flight(12)
    octets = bytearray(_records(rows))
    place = data.draw(st.integers(2, len(octets) - 3))
    octets[place] = data.draw(st.integers(0, 255))
    items = list(json_rows(io.BytesIO(octets), bytes(octets), "log", ["timestamp"], 7))
    taken = sum(item.offsets.size for item in items if not isinstance(item, Rejects))
    spans = sum(int(item.lengths.sum()) for item in items)
    besides = sum(item.besides for item in items if not isinstance(item, Rejects))
    assert taken >= len(rows) - 2
    assert spans + besides == len(octets)


@pytest.mark.parametrize(
    "octets",
    [b'{"a":{"0":1}', b'{"a":{"0":1},"b":3}', b'[{"a":' + b"[" * 10**5, b'[{"a":1' + b"9" * 5000],
)
def test_damage_ends_in_one_sentence_or_a_reject(octets: bytes) -> None:
    read = partial(json_rows, io.BytesIO(octets), octets, "log", ["a"], 0)
    if octets.startswith(b"{"):
        with pytest.raises(ConversionError, match="'log'"):
            list(read())
    else:
        assert sum(int(item.lengths.sum()) for item in read() if isinstance(item, Rejects)) > 0


FOLDER = Path(tempfile.mkdtemp())
RECORDS = _written(FOLDER, _records(_flight(240)), "records.json")
COLUMNS = _written(FOLDER, _columns(_flight(240)), "columns.json")


@check_converter("table", [RECORDS])
def test_conformance_of_records(check: Any) -> None:
    check()


@check_converter("table", [COLUMNS], streamed=False)
def test_conformance_of_columns(check: Any) -> None:
    check()
