"""Parquet, MAT files and NumPy arrays: the rows of text, bytes shared out, and bounds."""

import io
import struct
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spoofbench_converters.table import matfile

from spoofbench.errors import ConversionError, LimitError, SpoofbenchError

from .conftest import Result, convert_table

N = 100
MAPPING = """
clock = "sensor"
[table.log]
LAYOUT
[table.log.time]
column = "t"
unit = "s"
[table.log."/imu0/imu"]
accel = ["ax", "ay", "az"]
"""
quick = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    return {
        "t": 1.6e9 + np.arange(N) / 128,
        **{name: rng.normal(size=N) for name in ("ax", "ay", "az")},
    }


def _convert(path: Path, layout: str = "", mapping: str = MAPPING, **options: Any) -> Result:
    given_ = path.parent / "mapping.toml"
    given_.write_text(mapping.replace("LAYOUT", layout))
    return convert_table(path, mapping=str(given_), **options)


def _same(result: Result, columns: dict[str, np.ndarray]) -> None:
    imu = result.recording["/imu0/imu"]
    assert imu.time_ns.tolist() == [
        1_600_000_000_000_000_000 + place * 7_812_500 for place in range(N)
    ]
    for axis in "xyz":
        assert imu[f"accel_{axis}_mps2"].tolist() == columns[f"a{axis}"].tolist()
    assert not result.ledger.reasons


def test_every_format_gives_the_same_rows(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    pq.write_table(pa.table({**columns, "more": ["x"] * N}), tmp_path / "log.parquet")
    result = _convert(tmp_path / "log.parquet")
    _same(result, columns)
    assert result.ledger.used == (tmp_path / "log.parquet").stat().st_size

    for version, compressed in (("one", False), ("two", True)):
        path = tmp_path / f"{version}.mat"
        scipy.io.savemat(path, {**columns, "other": "text"}, do_compression=compressed)
        result = _convert(path)
        _same(result, columns)
        assert result.ledger.used == path.stat().st_size

    scipy.io.savemat(tmp_path / "three.mat", {"log": columns})
    _same(_convert(tmp_path / "three.mat", 'variable = "log"'), columns)
    matrix = np.stack(list(columns.values()), axis=1)
    scipy.io.savemat(tmp_path / "four.mat", {"log": matrix})
    _same(
        _convert(tmp_path / "four.mat", 'variable = "log"\ncolumns = ["t", "ax", "ay", "az"]'),
        columns,
    )
    scipy.io.savemat(
        tmp_path / "five.mat",
        {"log": matrix, "log_label": np.array(list(columns), object)[:, None]},
    )
    _same(_convert(tmp_path / "five.mat", 'variable = "log"'), columns)

    folder = tmp_path / "arrays"
    folder.mkdir()
    np.save(folder / "t.npy", columns["t"])
    np.save(folder / "a.npy", np.asfortranarray(matrix[:, 1:]))
    arrays = MAPPING.replace('["ax", "ay", "az"]', '["a[0]", "a[1]", "a[2]"]')
    with zipfile.ZipFile(tmp_path / "arrays.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("t", "a"):
            archive.write(folder / f"{name}.npy", f"{name}.npy")
    result = _convert(tmp_path / "arrays.zip", 'format = "npy"\nfiles = "*.npy"', arrays)
    _same(result, columns)
    assert result.ledger.used == sum(path.stat().st_size for path in folder.iterdir())


def test_times_of_parquet_are_exact(tmp_path: Path) -> None:
    exact = [1_600_000_000_123_456_789, 1_600_000_000_123_456_790]
    for kind in (pa.timestamp("ns"), pa.timestamp("ns", "UTC"), pa.int64()):
        table = {"t": pa.array(exact, kind), **{name: [1.0, 2.0] for name in ("ax", "ay", "az")}}
        pq.write_table(pa.table(table), tmp_path / "log.parquet")
        result = _convert(
            tmp_path / "log.parquet", mapping=MAPPING.replace('unit = "s"', 'unit = "ns"')
        )
        assert result.recording["/imu0/imu"].time_ns.tolist() == exact


def test_arrays_are_matched_by_equal_times(tmp_path: Path) -> None:
    mapping = """
clock = "sensor"
[table.imu]
format = "npy"
files = ["accel/*", "gyro/*"]
index = "t"
[table.imu.time]
column = "t"
unit = "s"
[table.imu."/imu0/imu"]
accel_x_mps2 = "accel/value"
gyro = ["gyro/value[0]", "gyro/value[1]", "gyro/value[2]"]
"""
    for name, times, values in (
        ("accel", [1.0, 2, 4], np.array([1.0, 2, 4])),
        ("gyro", [2.0, 3, 4], np.arange(9.0).reshape(3, 3)),
    ):
        (tmp_path / "log" / name).mkdir(parents=True)
        np.save(tmp_path / "log" / name / "t.npy", np.array(times))
        np.save(tmp_path / "log" / name / "value.npy", values)
    (tmp_path / "mapping.toml").write_text(mapping)
    imu = convert_table(tmp_path / "log", mapping=str(tmp_path / "mapping.toml")).recording[
        "/imu0/imu"
    ]
    assert (imu.time_ns // 10**9).tolist() == [1, 2, 3, 4]
    assert np.array_equal(imu["accel_x_mps2"], [1, 2, np.nan, 4], equal_nan=True)
    assert np.array_equal(imu["gyro_y_radps"], [np.nan, 1, 4, 7], equal_nan=True)


def test_a_bad_row_has_its_share(tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    columns["ay"][10] = np.inf
    pq.write_table(pa.table(columns), tmp_path / "log.parquet")
    result = _convert(tmp_path / "log.parquet")
    size = (tmp_path / "log.parquet").stat().st_size
    assert len(result.recording["/imu0/imu"]) == N - 1
    assert result.total == size
    assert abs(result.ledger.skipped - size / N) <= 1


@quick
@given(st.sampled_from(["log.parquet", "one.mat", "two.mat", "arrays.zip"]), st.data())
def test_damage_is_said_in_a_sentence(
    tmp_path: Path, columns: dict[str, np.ndarray], name: str, data: st.DataObject
) -> None:
    path, layout = tmp_path / name, ""
    if name == "log.parquet":
        pq.write_table(pa.table(columns), path)
    elif name == "arrays.zip":
        with zipfile.ZipFile(path, "w") as archive:
            for key, values in columns.items():
                octets = io.BytesIO()
                np.save(octets, values)
                archive.writestr(f"{key}.npy", octets.getvalue())
        layout = 'format = "npy"\nfiles = "*.npy"'
    else:
        scipy.io.savemat(path, columns, do_compression=name == "two.mat")
    octets_ = bytearray(path.read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(octets_) - 1), min_size=1, max_size=5)):
        octets_[place] = data.draw(st.sampled_from([0, 1, 127, 255]))
    path.write_bytes(
        octets_[: data.draw(st.integers(1, len(octets_)))] if data.draw(st.booleans()) else octets_
    )
    with suppress(SpoofbenchError):
        result = _convert(path, layout)
        assert name == "arrays.zip" or result.total == path.stat().st_size


def test_a_bomb_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, columns: dict[str, np.ndarray]
) -> None:
    monkeypatch.setattr(matfile, "MAX_UNPACKED_BYTES", 500)
    scipy.io.savemat(tmp_path / "bomb.mat", columns, do_compression=True)
    with pytest.raises(LimitError, match="unpacks to more than"):
        matfile.read_mat((tmp_path / "bomb.mat").read_bytes(), "bomb.mat", frozenset(["ax"]))


def test_an_array_that_claims_too_much_is_refused(tmp_path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999,), }\n"
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        archive.writestr("t.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    with pytest.raises(LimitError, match="more than"):
        _convert(tmp_path / "log.zip", 'format = "npy"\nfiles = "*.npy"')


def test_version_7_3_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + zlib.compress(b"x"))
    with pytest.raises(ConversionError, match="save it with '-v7'"):
        _convert(tmp_path / "log.mat", 'format = "mat"')


def test_what_an_archive_hides_is_no_table(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        archive.writestr("drive/imu.csv", "t,ax,ay,az\n1,2,3,4\n")
        archive.writestr("__MACOSX/drive/._imu.csv", bytes(range(32)))
        archive.writestr("drive/.DS_Store", b"Bud1")
    result = _convert(tmp_path / "log.zip")
    assert len(result.recording["/imu0/imu"]) == 1
    assert result.ledger.reasons == {"a file that is not in the mapping": 36}


def test_what_lies_too_deep_in_a_mat_file_is_said(
    tmp_path: Path, columns: dict[str, np.ndarray]
) -> None:
    scipy.io.savemat(tmp_path / "log.mat", {"drive": {"imu": columns}})
    with pytest.raises(ConversionError, match="within structures"):
        _convert(tmp_path / "log.mat", 'variable = "drive"')
