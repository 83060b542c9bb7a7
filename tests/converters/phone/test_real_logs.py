"""Real logs: what their manifest says of them comes out, and signs and clocks agree with the
motion.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from spoofbench_converters import phone

from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing.converter_cases import ConverterOutcome, outcome

Floats = np.ndarray[Any, np.dtype[np.float64]]


class Expected(NamedTuple):
    """Of the first receiver: seconds, metres, m/s; and the least correlation of turning about the
    vertical with the course's.
    """

    duration_s: float
    distance_m: float
    max_speed_mps: float
    turning: float
    options: dict[str, str]


LOGS = {
    "gl_pixel6_163232.txt": Expected(31.0, 75, 7.3, 0.7, {}),
    "gl_pixel7_163231.txt": Expected(32.0, 32, 3.8, -1.0, {}),
    "sensorlog_motorbike_20160809.csv": Expected(106.0, 757, 8.6, 0.7, {}),
    "sensorlogger_ski_iphone12.zip": Expected(362.7, 2461, 11.0, 0.7, {}),
    "phyphox_cessna_takeoff_deland.zip": Expected(45.4, 787, 34.1, 0.85, {"date": "2023-01-01"}),
}


@pytest.fixture(scope="module", params=LOGS)
def log(request: pytest.FixtureRequest, shared: Path) -> tuple[Expected, ConverterOutcome]:
    expected = LOGS[request.param]
    return expected, outcome(phone, shared / request.param, expected.options)


def test_every_byte_is_accounted_for(log: tuple[Expected, ConverterOutcome]) -> None:
    _, found = log
    assert found.error is None
    assert found.used + found.skipped == found.size
    assert found.skipped < 1000


def test_the_track_is_that_of_the_manifest(log: tuple[Expected, ConverterOutcome]) -> None:
    expected, found = log
    pvt = found.tables["/gnss0/gnss/pvt"]
    north, east = np.radians(pvt["lat_deg"]), np.radians(pvt["lon_deg"])
    distance = float(np.hypot(np.diff(north), np.diff(east) * np.cos(north[0])).sum() * 6_371_000)
    assert np.ptp(pvt.time_ns) / 1e9 == pytest.approx(expected.duration_s, abs=1)
    assert distance == pytest.approx(expected.distance_m, rel=0.02)
    assert np.nanmax(pvt["speed_mps"]) == pytest.approx(expected.max_speed_mps, abs=0.1)


def test_specific_force_is_gravity_on_the_whole(log: tuple[Expected, ConverterOutcome]) -> None:
    for topic, table in log[1].tables.items():
        if topic.endswith("/imu") and table.has("accel_x_mps2"):
            assert np.median(
                np.linalg.norm(_vectors(table, "accel_{}_mps2")[1], axis=1)
            ) == pytest.approx(9.81, abs=0.35)


def test_turning_agrees_with_the_course(log: tuple[Expected, ConverterOutcome]) -> None:
    """Within a lag of 2.5 s: phones' location is late. About up, given by the specific force
    smoothed over 2 s.
    """
    expected, found = log
    imu, pvt = found.tables["/imu0/imu"], found.tables["/gnss0/gnss/pvt"]
    force_ns, force = _vectors(imu, "accel_{}_mps2")
    rate_ns, rate = _vectors(imu, "gyro_{}_radps")
    window = np.ones(round(2e9 / float(np.median(np.diff(force_ns)))))
    up = np.stack(
        [np.interp(rate_ns, force_ns, np.convolve(axis, window, "same")) for axis in force.T], 1
    )
    clockwise = -(rate * up).sum(axis=1) / np.linalg.norm(up, axis=1)
    turned = np.concatenate([[0.0], np.cumsum(clockwise[1:] * np.diff(rate_ns) / 1e9)])
    seconds = np.diff(pvt.time_ns) / 1e9
    course = np.radians((np.diff(pvt["course_deg"]) + 180) % 360 - 180) / seconds
    moving = (np.minimum(pvt["speed_mps"][1:], pvt["speed_mps"][:-1]) > 2) & ~np.isnan(course)
    moving &= (pvt.time_ns[:-1] > rate_ns[0] + 3e9) & (pvt.time_ns[1:] < rate_ns[-1])
    if moving.sum() < 8:
        assert expected.turning < 0
        return
    lags_ns = np.arange(0, 2.6e9, 0.25e9)
    rates = [np.diff(np.interp(pvt.time_ns - lag, rate_ns, turned)) / seconds for lag in lags_ns]
    assert max(np.corrcoef(rate[moving], course[moving])[0, 1] for rate in rates) > expected.turning


def test_android_attitude_agrees_with_the_specific_force(shared: Path) -> None:
    for name in ("gl_pixel6_163232.txt", "gl_pixel7_163231.txt"):
        tables = outcome(phone, shared / name, {}).tables
        attitude = tables["/ins0/ins/pva"]
        force_ns, force = _vectors(tables["/imu0/imu"], "accel_{}_mps2")
        x, y, z = (np.interp(attitude.time_ns, force_ns, axis) for axis in force.T)
        size = np.sqrt(x * x + y * y + z * z)
        quiet = np.abs(size - 9.81) < 0.3
        pitch, roll = np.degrees(np.arcsin(y / size)), np.degrees(np.arctan2(-x, z))
        assert np.corrcoef(pitch[quiet], attitude["pitch_deg"][quiet])[0, 1] > 0.8
        assert np.corrcoef(roll[quiet], attitude["roll_deg"][quiet])[0, 1] > 0.8


def test_two_phones_of_one_play_agree_in_their_measurements(shared: Path) -> None:
    """Both saw the same satellites in the same seconds, metres apart: pseudoranges differ by the
    clocks alone.
    """
    first, second = (
        Recording(outcome(phone, shared / f"gl_{name}.txt", {}).tables)
        for name in ("pixel6_163232", "pixel7_163231")
    )
    ranges = [_ranges(recording["/gnss0/gnss/observation"]) for recording in (first, second)]
    common = sorted(ranges[0].keys() & ranges[1].keys())
    assert len(common) > 15
    differences = np.array([ranges[0][key] - ranges[1][key] for key in common])
    assert np.median(np.abs(differences - np.median(differences))) < 50_000


def test_the_clocks_of_the_two_phones(shared: Path) -> None:
    """The manifest: the Pixel 6's GNSS time is 0.98 s behind its own clock, the Pixel 7's within
    0.02 s of it.
    """
    behind = [
        outcome(phone, shared / f"gl_{name}.txt", {}).tables["/gnss0/gnss/clock"]
        for name in ("pixel6_163232", "pixel7_163231")
    ]
    assert np.median(behind[0]["host_offset_s"]) == pytest.approx(-0.97, abs=0.02)
    assert np.median(behind[1]["host_offset_s"]) == pytest.approx(0.0, abs=0.02)


def _ranges(table: Table) -> dict[tuple[int, int, str], float]:
    rows = table.take(
        np.flatnonzero((table.time_ns == table.time_ns[0]) & ~np.isnan(table["pseudorange_m"]))
    )
    keys = zip(
        rows["constellation"].tolist(), rows["svid"].tolist(), rows.texts("signal"), strict=True
    )
    return dict(zip(keys, rows["pseudorange_m"].tolist(), strict=True))


def _vectors(table: Table, field: str) -> tuple[Floats, Floats]:
    """Times and values of the rows that have a vector."""
    values = np.stack([table[field.format(axis)] for axis in "xyz"], 1)
    rows = ~np.isnan(values).any(axis=1)
    return table.time_ns[rows].astype(np.float64), values[rows]
