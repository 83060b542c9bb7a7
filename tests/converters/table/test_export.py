"""Tables that are exported by a mapping and converted again give the same rows."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spoofbench_converters.table import export

from spoofbench.errors import ConversionError
from spoofbench.recording import Recording
from spoofbench.table import Column, Table

from .conftest import MAPPING, convert_table

ONE_TABLE = """
clock = "sensor"
[table.log]
LAYOUT
[table.log.time]
TIME
[table.log."/imu0/imu"]
accel = { columns = ["ax", "ay", "-az"], unit = "g", at_rest = "down" }
gyro = { columns = ["gx", "gy", "gz"], unit = "deg/s" }
[table.log."/gnss0/gnss/pvt"]
lat_deg = { column = "lat", unit = "1e-7 deg" }
speed_mps = { column = "v", unit = "km/h" }
num_sv = "n"
fix_type = { column = "q", values = { 1 = "RTK_FIXED", 2 = "RTK_FLOAT" } }
time_valid = "ok"
claims = { column = "tow", unit = "s", week = "week" }
[table.log."/gnss0/gnss/rf"]
band = "band"
"""

LAYOUTS = [
    "",
    'delimiter = ";"\ndecimal_comma = true',
    'delimiter = "whitespace"',
    (
        'header = false\ncolumns = ["t", "day", "ax", "ay", "az", "gx", "gy", "gz", "lat", "v", '
        '"n", "q", "ok", "tow", "week", "band", "more"]'
    ),
]
TIMES = [
    'column = "t"\nunit = "s"',
    'column = "t"\nunit = "ms"\nscale = "gps"',
    'column = "t"\nunit = "ns"',
    'column = "t"\nformat = "iso"\ndate = "day"\nzone = "+05:30"',
    'column = "t"\nunit = "us"\ndate = "day"',
    'column = "t"\nunit = "s"\nweek = "day"',
]
quick = settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def _recording(seed: int) -> Recording:
    """Return rows of whose fields some are absent, made of what a table of this mapping can say."""
    rng = np.random.default_rng(seed)
    n, m = 20, 12
    imu_ns = 1_600_000_000_000_000_000 + np.sort(rng.integers(0, 10**9, n))
    pvt_ns = np.sort(
        np.concatenate(
            [rng.choice(imu_ns, m // 2), 1_600_000_000_000_000_000 + rng.integers(0, 10**9, m // 2)]
        )
    )
    draw = rng.integers(-(10**9), 10**9, (6, n))
    accel = {f"accel_{axis}_mps2": draw[place] / 1e5 * 9.80665 for place, axis in enumerate("xyz")}
    gyro = {
        f"gyro_{axis}_radps": np.where(draw[place] > 0, draw[place] / 1e5, np.nan) * (np.pi / 180)
        for place, axis in enumerate("xyz", 3)
    }
    some = rng.random(m) < 0.6
    week = np.full(m, 2100)
    pvt = {
        "lat_deg": rng.integers(-(9 * 10**8), 9 * 10**8, m) / 1e7,
        "speed_mps": np.where(some, rng.integers(0, 10**5, m) / 1e3 * 10 / 36, np.nan),
        "num_sv": Column(rng.integers(0, 40, m), rng.random(m) < 0.5),
        "fix_type": Column(rng.integers(8, 10, m), some),
        "time_valid": Column(rng.integers(0, 2, m).astype(bool), some),
        "gps_week": Column(week, some),
        "tow_s": np.where(some, rng.integers(0, 604_800_000, m) / 1e3, np.nan),
    }
    bands = [str(word) for word in rng.choice(["L1", "L5", "bänd,2", 'a"b'], m)]
    return Recording(
        {
            "/imu0/imu": Table("imu", imu_ns, accel | gyro),
            "/gnss0/gnss/pvt": Table("gnss/pvt", pvt_ns, pvt),
            "/gnss0/gnss/rf": Table("gnss/rf", pvt_ns, {"band": bands}),
        }
    )


def _again(recording: Recording, mapping: str, folder: Path, name: str) -> Recording:
    (folder / "mapping.toml").write_text(mapping)
    (path,) = export(recording, folder / "mapping.toml", folder / name)
    result = convert_table(path, mapping=str(folder / "mapping.toml"))
    assert not result.ledger.reasons
    assert result.ledger.used == path.stat().st_size
    return result.recording


@quick
@given(st.integers(0, 2**32), st.sampled_from(LAYOUTS), st.sampled_from(TIMES))
def test_text(tmp_path: Path, seed: int, layout: str, time: str) -> None:
    recording = _recording(seed)
    if "whitespace" in layout:
        recording = recording.replace({"/gnss0/gnss/rf": None})
    mapping = ONE_TABLE.replace("LAYOUT", layout).replace("TIME", time)
    once = _again(recording, mapping, tmp_path, "log.csv")
    assert set(once) == set(recording)
    for topic in recording:
        assert once[topic].time_ns.tolist() == recording[topic].time_ns.tolist()
        for field in recording[topic]:
            assert np.array_equal(once[topic].valid(field), recording[topic].valid(field))
    assert dict(_again(once, mapping, tmp_path, "log.csv")) == dict(once)


@quick
@given(st.integers(0, 2**32), st.sampled_from(TIMES))
def test_parquet_gives_the_rows_of_text(tmp_path: Path, seed: int, time: str) -> None:
    mapping = ONE_TABLE.replace("LAYOUT", "").replace("TIME", time)
    text = _again(_recording(seed), mapping, tmp_path, "log.csv")
    parquet = _again(_recording(seed), mapping, tmp_path, "log.parquet")
    assert dict(text) == dict(parquet)


def test_topics_with_conditions_stand_in_rows_of_their_own(tmp_path: Path) -> None:
    baro_topic = '[table.log."/baro0/baro"]\nwhere = { kind = "baro" }\npressure_pa = "ax"\n'
    mapping = f'{MAPPING}\nwhere = {{ kind = "imu" }}\n{baro_topic}'
    imu = Table(
        "imu",
        np.array([1, 2, 2], np.int64),
        {f"accel_{axis}_mps2": np.array([1.0, 2, 3]) for axis in "xyz"},
    )
    baro = Table("baro", np.array([2, 5], np.int64), {"pressure_pa": np.array([101325.0, 99999])})
    recording = Recording({"/imu0/imu": imu, "/baro0/baro": baro})
    assert dict(_again(recording, mapping, tmp_path, "log.csv")) == dict(recording)


def test_several_tables_are_a_folder(tmp_path: Path) -> None:
    imu = Table(
        "imu",
        np.array([10**9], np.int64),
        {f"accel_{axis}_mps2": np.array([1.0]) for axis in "xyz"},
    )
    pvt = Table(
        "gnss/pvt",
        np.array([10**9], np.int64),
        {"lat_deg": np.array([1.0]), "lon_deg": np.array([1.0])},
    )
    recording = Recording({"/imu0/imu": imu, "/gnss0/gnss/pvt": pvt})
    paths = export(recording, "car_circles", tmp_path / "out")
    assert [path.name for path in paths] == ["imu.csv", "gps.csv"]
    again = convert_table(tmp_path / "out")
    assert again.recording["/gnss0/gnss/pvt"]["lat_deg"].tolist() == [1.0]
    assert again.recording["/imu0/imu"]["accel_x_mps2"].tolist() == [1.0]
    with pytest.raises(ConversionError, match="name a folder"):
        export(recording, "car_circles", tmp_path / "out.csv")
    with pytest.raises(ConversionError, match="none of the topics"):
        export(
            Recording({"/baro0/baro": Table("baro", np.array([1], np.int64), {})}),
            "car_circles",
            tmp_path / "x",
        )
