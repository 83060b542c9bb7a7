"""Tables of every kind drawn at random, and what the official reader and decoder make of a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from spoofbench.schema import KINDS, SENSOR_KINDS, Field, split_topic, topic_of
from spoofbench.table import Column, Table

TIMES = st.integers(0, 2**63 - 1)
ENUMS = st.sampled_from([0, 1, 5, 127, 128, 16384, 2**31 - 1, -1, -(2**31)])


def _values(field: Field, rows: int) -> st.SearchStrategy[Any]:
    if field.category in ("text", "bytes"):
        words = st.text(max_size=200) if field.category == "text" else st.binary(max_size=200)
        return st.lists(words, min_size=rows, max_size=rows)
    if field.category == "enum":
        return hnp.arrays(np.int32, rows, elements=ENUMS)
    return hnp.arrays(np.dtype(field.dtype), rows)


@st.composite
def _tables(draw: st.DrawFn, kind: str | None = None) -> Table:
    """Tables of up to 40 rows; each field absent, present, or present in some rows."""
    name = kind or draw(st.sampled_from(sorted(KINDS)))
    rows = draw(st.integers(0, 40))
    times = np.array(sorted(draw(st.lists(TIMES, min_size=rows, max_size=rows))), np.int64)
    columns: dict[str, Any] = {}
    for field in KINDS[name].fields.values():
        presence = draw(st.sampled_from(["absent", "present", "mixed", "none of the rows"]))
        if presence == "absent":
            continue
        values = draw(_values(field, rows))
        valid = (
            np.full(rows, presence == "present")
            if presence != "mixed"
            else draw(hnp.arrays(bool, rows))
        )
        if field.category in ("text", "bytes"):
            columns[field.name] = [
                value if is_valid else None for value, is_valid in zip(values, valid, strict=True)
            ]
        else:
            columns[field.name] = Column(values, valid)
    return Table(name, times, columns)


@pytest.fixture(scope="session")
def tables() -> Callable[..., st.SearchStrategy[Table]]:
    """A strategy of tables, of a kind or of all."""
    return _tables


@pytest.fixture(scope="session")
def any_topic() -> Callable[[Table], str]:
    """A topic that fits a table."""
    return lambda table: topic_of(
        "unit0" if table.kind.name in SENSOR_KINDS else "", table.kind.name
    )


def _officially_read(path: Path, topic: str, kind: str | None = None) -> Table:
    fields = KINDS[kind or split_topic(topic)[1]].fields
    times: list[int] = []
    rows: dict[str, list[Any]] = {name: [] for name in fields}
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, _, message, decoded in reader.iter_decoded_messages([topic]):
            times.append(message.log_time)
            assert message.publish_time == message.log_time
            for name, values in rows.items():
                theirs = decoded.DESCRIPTOR.fields_by_name.get(name)
                is_absent = theirs is None or (theirs.has_presence and not decoded.HasField(name))
                values.append(None if is_absent else getattr(decoded, name))
    columns: dict[str, Any] = {}
    for name, field in fields.items():
        if field.category in ("text", "bytes"):
            columns[name] = rows[name]
        elif field.category == "float":
            columns[name] = np.array(
                [np.nan if value is None else value for value in rows[name]], field.dtype
            )
        else:
            valid = np.array([value is not None for value in rows[name]], bool)
            columns[name] = Column(
                np.array([value or 0 for value in rows[name]], field.dtype), valid
            )
    return Table(kind or split_topic(topic)[1], np.array(times, np.int64), columns)


@pytest.fixture(scope="session")
def officially_read() -> Callable[..., Table]:
    """Reads a topic by the mcap library and the official protobuf decoder, row by row."""
    return _officially_read


@pytest.fixture(scope="session")
def drive() -> Callable[[int], Any]:
    """A synthetic drive of so many seconds: IMU 100 Hz with gaps in a field, PVT 1 Hz, signals with
    texts.
    """
    from spoofbench.recording import Recording

    def make(seconds: int) -> Recording:
        rng = np.random.default_rng(7)
        rows, start = 100 * seconds, 1_700_000_000_000_000_000
        time = start + 10_000_000 * np.arange(rows)
        axes = [
            f"{quantity}_{axis}_{unit}"
            for quantity, unit in (("accel", "mps2"), ("gyro", "radps"))
            for axis in "xyz"
        ]
        warmth = np.where(np.arange(rows) % 50 < 10, np.nan, 30.0)
        imu = Table(
            "imu",
            time,
            {
                **{axis: rng.normal(size=rows) for axis in axes},
                "temperature_degc": warmth,
                "interval_s": np.zeros(rows),
            },
        )
        position = {
            "lat_deg": 45 + rng.normal(size=seconds),
            "lon_deg": 7 + rng.normal(size=seconds),
            "height_m": np.full(seconds, 300.0),
        }
        covariance = {
            f"cov_{pair}_m2": rng.normal(size=seconds)
            for pair in ("nn", "ne", "nd", "ee", "ed", "dd")
        }
        pvt = Table(
            "gnss/pvt", time[::100], {**position, **covariance, "fix_type": np.arange(seconds) % 4}
        )
        names = ["1C", "5Q", None, "2X"]
        signal = Table(
            "gnss/signal",
            np.repeat(time[::100], 4),
            {
                "signal": names * seconds,
                "cn0_dbhz": rng.normal(size=4 * seconds),
                "used": rng.random(4 * seconds) < 0.5,
            },
        )
        metadata = {
            "recording": {"clock": "recorder"},
            "primary": {"imu": "imu0"},
            "source/imu0": {"axes": "fr\u00e9\u00e9"},
        }
        return Recording(
            {"/imu0/imu": imu, "/gnss0/gnss/pvt": pvt, "/gnss0/gnss/signal": signal}, metadata
        )

    return make
