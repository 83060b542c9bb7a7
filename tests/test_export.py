"""What is exported says the same in another program's words: absent is empty, exact where the
format can be.
"""

import csv
import xml.etree.ElementTree as ET
import zipfile
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyarrow import parquet

from spoofbench import plugins
from spoofbench.codec import write
from spoofbench.errors import ConversionError, PluginError, RecordingError
from spoofbench.export import arrow_table, export, export_by_mapping, write_csv
from spoofbench.recording import Recording
from spoofbench.schema import KINDS, split_topic
from spoofbench.table import Column, Table
from spoofbench.testing.recordings import drive

GPX = "{http://www.topografix.com/GPX/1/1}"
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def recording() -> Recording:
    return drive(2, 60.0)


@pytest.fixture(scope="module")
def file(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings") / "drive.mcap"
    write(recording, path)
    return path


def table_of(exported: Any, kind: str) -> Table:
    """Read an Arrow table back, by its documentation."""
    columns: dict[str, Any] = {}
    for name, field in KINDS[kind].fields.items():
        if name not in exported.column_names:
            continue
        values = exported[name].to_pylist()
        if field.category == "enum":
            numbers = KINDS[kind].message.fields_by_name[name].enum_type.values_by_name
            values = [
                None if word is None else numbers[word].number if word in numbers else int(word)
                for word in values
            ]
        if field.category in ("text", "bytes"):
            columns[name] = values
        elif field.category == "float":
            columns[name] = np.array([np.nan if value is None else value for value in values])
        else:
            valid = np.array([value is not None for value in values], bool)
            columns[name] = Column(np.array([value or 0 for value in values], field.dtype), valid)
    return Table(kind, exported["time_ns"].to_numpy(), columns)


def test_parquet_of_every_kind_reads_back_equal(
    recording: Recording, file: Path, tmp_path: Path
) -> None:
    export(file, tmp_path / "all", table_format="parquet")
    for topic in recording:
        exported = parquet.read_table(tmp_path / "all" / f"{topic[1:].replace('/', '_')}.parquet")
        assert exported.schema.metadata[b"spoofbench.topic"].decode() == topic
        assert table_of(exported, split_topic(topic)[1]) == recording[topic]
        assert exported["time"].cast(pa.int64()).to_pylist() == recording[topic].time_ns.tolist()


FLOATS = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True, width=64)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data(), st.integers(0, 5))
def test_any_rows_read_back_equal_from_parquet_and_csv(tmp_path: Path, data: Any, n: int) -> None:
    table = Table(
        "gnss/navdata",
        START_NS + np.arange(n),
        {
            "constellation": Column(
                np.array(data.draw(st.lists(st.integers(0, 99), min_size=n, max_size=n)), np.int32),
                data.draw(arrays(bool, n)),
            ),
            "svid": Column(data.draw(arrays(np.uint32, n)), data.draw(arrays(bool, n))),
            "signal": data.draw(
                st.lists(
                    st.none() | st.text(st.characters(codec="utf-8"), min_size=1, max_size=9),
                    min_size=n,
                    max_size=n,
                )
            ),
            "subframe": data.draw(
                st.lists(st.none() | st.binary(max_size=9), min_size=n, max_size=n)
            ),
        },
    )
    clock = Table(
        "gnss/clock", table.time_ns, {"bias_s": data.draw(arrays(np.float64, n, elements=FLOATS))}
    )
    for each in (table, clock):
        parquet.write_table(arrow_table(each, "/a/x", {}), tmp_path / "x.parquet")
        assert table_of(parquet.read_table(tmp_path / "x.parquet"), each.kind.name) == each
    write_csv(arrow_table(clock, "/a/x", {}), tmp_path / "x.csv")
    with (tmp_path / "x.csv").open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert [int(row["time_ns"]) for row in rows] == clock.time_ns.tolist()
    np.testing.assert_array_equal([float(row["bias_s"] or "nan") for row in rows], clock["bias_s"])
    write_csv(arrow_table(table, "/a/x", {}), tmp_path / "y.csv")
    with (tmp_path / "y.csv").open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    assert [row["signal"] or None for row in rows] == table.texts("signal")
    assert [row["subframe"] for row in rows] == [
        (word or b"").hex() for word in table.texts("subframe")
    ]


def test_csv_has_iso_times_and_empty_cells(
    recording: Recording, file: Path, tmp_path: Path
) -> None:
    export(file, tmp_path / "pvt.csv", topics=["/gnss0/gnss/pvt"])
    pvt = recording["/gnss0/gnss/pvt"]
    with (tmp_path / "pvt.csv").open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == len(pvt)
    no_fix = int(np.flatnonzero(np.isnan(pvt["lat_deg"]))[0])
    assert (rows[no_fix]["lat_deg"], rows[no_fix]["fix_type"], rows[0]["fix_type"]) == (
        "",
        "FIX_TYPE_NONE",
        "FIX_TYPE_3D",
    )
    for row, time_ns in zip(rows, pvt.time_ns.tolist(), strict=True):
        whole, _, nanoseconds = row["time"].removesuffix("Z").partition(".")
        assert (
            int(datetime.fromisoformat(whole + "+00:00").timestamp()) * 10**9 + int(nanoseconds)
            == time_ns
            == int(row["time_ns"])
        )


def test_gpx_is_a_track_of_segments(recording: Recording, file: Path, tmp_path: Path) -> None:
    assert export(file, tmp_path / "track.gpx") == ["/gnss0/gnss/pvt"]
    pvt = recording["/gnss0/gnss/pvt"]
    root = ET.parse(tmp_path / "track.gpx").getroot()
    points = root.findall(f"{GPX}trk/{GPX}trkseg/{GPX}trkpt")
    known = np.isfinite(pvt["lat_deg"])
    assert [float(point.attrib["lat"]) for point in points] == pvt["lat_deg"][known].tolist()
    assert [float(point.attrib["lon"]) for point in points] == pvt["lon_deg"][known].tolist()
    assert [point.findtext(f"{GPX}sat") for point in points] == ["8"] * len(points)
    assert root.findtext(f"{GPX}trk/{GPX}name") == "gnss0"
    assert len(root.findall(f"{GPX}trk/{GPX}trkseg")) == 2  # the epoch without a fix parts them
    assert all("e" not in point.attrib["lat"] for point in points)


def test_heights_of_gpx_are_above_the_sea(tmp_path: Path) -> None:
    columns = {
        "lat_deg": [1e-7, 2.0, 95.0, 3.0],
        "lon_deg": [0.0, 180.0, 0.0, 0.0],
        "height_m": [50.0] * 4,
        "height_msl_m": [3.0, np.nan, 3.0, 3.0],
    }
    table = Table(
        "gnss/pvt",
        START_NS + np.arange(4),
        {name: np.array(values) for name, values in columns.items()},
    )
    write(Recording({"/gn\x1b<ss/gnss/pvt": table}), tmp_path / "x.mcap")
    export(tmp_path / "x.mcap", tmp_path / "x.gpx")
    points = list(ET.parse(tmp_path / "x.gpx").iter(f"{GPX}trkpt"))
    assert [
        (
            point.attrib["lat"],
            point.attrib["lon"],
            point.findtext(f"{GPX}ele"),
            point.findtext(f"{GPX}geoidheight"),
        )
        for point in points
    ] == [
        ("0.0000001", "0", "3", "47"),
        ("2", "-180", None, None),
        ("3", "0", "3", "47"),
    ]


def test_an_archive_holds_the_same_and_is_the_same_again(file: Path, tmp_path: Path) -> None:
    for name in ("a.zip", "b.zip"):
        export(file, tmp_path / name)
    export(file, tmp_path / "folder")
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == {
            path.name: path.read_bytes() for path in (tmp_path / "folder").iterdir()
        }
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zip", "b.zip", "folder"]


@pytest.mark.parametrize(
    ("out", "topics", "sentence"),
    [
        ("x.csv", [], "can hold one topic; say which with --topic"),
        ("x.csv", ["/gnss0/pvt"], "has no topic '/gnss0/pvt'"),
        ("x.gpx", ["/imu0/imu"], "has no gnss/pvt topic to draw"),
        ("full", [], "is not empty; name another"),
    ],
)
def test_what_cannot_be_exported_is_one_sentence(
    out: str, topics: list[str], sentence: str, file: Path, tmp_path: Path
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("x")
    with pytest.raises(RecordingError, match=sentence):
        export(file, tmp_path / out, topics=topics)
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


def test_topics_of_strange_names_stay_in_the_folder(tmp_path: Path) -> None:
    table = Table("imu", np.array([START_NS]), {"accel_x_mps2": np.zeros(1)})
    write(
        Recording({f"/{name}/imu": table for name in ("..", "a b", "a_b", "a\x00b", "A_B")}),
        tmp_path / "x.mcap",
    )
    export(tmp_path / "x.mcap", tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "A_B_imu.csv",
        "a_b_imu_.csv",
        "a_b_imu__.csv",
        "a_b_imu___.csv",
        "imu.csv",
    ]


def test_a_mapping_is_a_matter_of_the_converter_that_knows_it(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_text(recording: Recording, mapping: str, out: Path) -> None:
        if mapping != "known":
            raise ConversionError(f"there is no mapping {mapping!r}")
        out.write_text(f"{mapping} {len(recording)}")

    def fail(recording: Recording, mapping: str, out: Path) -> None:
        out.write_text("half")
        raise ZeroDivisionError

    def install(**converters: Any) -> None:
        found = {
            name: SimpleNamespace(name=name, load=lambda converter=converter: converter)
            for name, converter in converters.items()
        }
        monkeypatch.setattr(plugins, "found", lambda group: found)

    install(plain=SimpleNamespace(), tables=SimpleNamespace(export=write_text))
    export_by_mapping(file, tmp_path / "out.csv", "known")
    assert (tmp_path / "out.csv").read_text().startswith("known ")
    with pytest.raises(ConversionError, match="there is no mapping 'unknown'"):
        export_by_mapping(file, tmp_path / "other.csv", "unknown")
    install(tables=SimpleNamespace(export=fail))
    with pytest.raises(PluginError, match="ZeroDivisionError"):
        export_by_mapping(file, tmp_path / "other.csv", "known")
    install(plain=SimpleNamespace())
    with pytest.raises(PluginError, match="no converter that is installed can export by a mapping"):
        export_by_mapping(file, tmp_path / "other.csv", "known")
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]
