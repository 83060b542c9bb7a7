"""Means over intervals, and standstill, against loops over the rows."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.errors import RecordingError
from spoofbench.navigation import imu
from spoofbench.recording import Recording
from spoofbench.table import Table

SECOND = 1_000_000_000
NAMES = (
    "accel_x_mps2",
    "accel_y_mps2",
    "accel_z_mps2",
    "gyro_x_radps",
    "gyro_y_radps",
    "gyro_z_radps",
)


def rows(seed: int, n: int, averaged: bool, lost: float = 0.0) -> Table:
    """IMU rows about every 10 ms, some lost, averaged over their own step or sampled."""
    rng = np.random.default_rng(seed)
    step = rng.integers(8_000_000, 12_000_000, n)
    kept = rng.random(n) >= lost
    time_ns = np.cumsum(step)[kept]
    columns = {name: rng.normal(0, 1, kept.sum()) for name in NAMES}
    if averaged:
        columns["interval_s"] = step[kept] / 1e9
    return Table("imu", time_ns, columns)


def literal_mean(table: Table, name: str, start: int, end: int) -> float:
    """Sum of increments over sum of seconds of the rows in (start, end]; NaN if they stand for less
    than 80 %.
    """
    increments, seconds = [], []
    for k in range(len(table)):
        if start < table.time_ns[k] <= end:
            interval = table["interval_s"][k]
            if not interval > 0:
                interval = (
                    min((table.time_ns[k] - table.time_ns[k - 1]) / 1e9, imu.GAP_S) if k else 0.0
                )
            increments.append(table[name][k] * interval)
            seconds.append(interval)
    if not seconds or math.fsum(seconds) < imu.COVERAGE * (end - start) / 1e9:
        return math.nan
    return math.fsum(increments) / math.fsum(seconds)


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.floats(0, 0.3),
    st.lists(st.integers(-SECOND, 5 * SECOND), min_size=2, max_size=12),
)
def test_means_are_increments_over_seconds(
    seed: int, averaged: bool, lost: float, edges: list[int]
) -> None:
    table = rows(seed, 300, averaged, lost)
    start, end = np.sort(np.array([edges[:-1], edges[1:]]), axis=0)
    found = np.hstack(imu.interval_means(table, start, end)).T
    for name, row in zip(NAMES, found, strict=True):
        expected = [
            literal_mean(table, name, *pair)
            for pair in zip(start.tolist(), end.tolist(), strict=True)
        ]
        assert row == pytest.approx(expected, rel=1e-9, abs=1e-12, nan_ok=True)


def test_later_rows_change_no_bit() -> None:
    table, edges = rows(3, 2000, averaged=True), np.arange(0, 12) * SECOND
    whole = imu.interval_means(table, edges[:-1], edges[1:])
    part = imu.interval_means(table.until(int(edges[-1])), edges[:-1], edges[1:])
    assert np.concatenate(whole).tobytes() == np.concatenate(part).tobytes()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.floats(0, 0.3))
def test_an_unknown_value_is_a_row_that_is_not_there(
    seed: int, averaged: bool, share: float
) -> None:
    """Each of the two sensors has its own rows, bit for bit."""
    table, edges = rows(seed, 300, averaged), np.arange(4) * SECOND * 3 // 4
    rng = np.random.default_rng(seed + 1)
    lost = {name: rng.random(len(table)) < share for name in ("accel_y_mps2", "gyro_z_radps")}
    found = imu.interval_means(
        table.replace(**{n: np.where(gone, np.nan, table[n]) for n, gone in lost.items()}),
        edges[:-1],
        edges[1:],
    )
    for mean, which, gone in zip(found, ("force_mps2", "rate_radps"), lost.values(), strict=True):
        expected = getattr(imu.interval_means(table.take(~gone), edges[:-1], edges[1:]), which)
        assert mean.tobytes() == expected.tobytes()


def test_sensors_that_tick_apart_are_as_good_as_together() -> None:
    """Accelerometer and gyroscope in turn, at 100 Hz each: all of the time is covered, and
    standstill is known.
    """
    time_ns = np.arange(1, 1001) * SECOND // 200
    even = np.arange(1000) % 2 == 0
    columns = {name: np.where(even == name.startswith("accel"), 1e-3, np.nan) for name in NAMES}
    table, edges = Table("imu", time_ns, columns), np.arange(5) * SECOND
    found = imu.interval_means(table, edges[:-1], edges[1:])
    np.testing.assert_allclose(np.concatenate(found), 1e-3, rtol=1e-12)
    assert imu.is_stationary(table, edges[2:], imu.Standstill()).tolist() == [1, 1, 1]


def test_too_many_unknown_values_have_no_mean() -> None:
    table = rows(4, 300, averaged=True)
    values = table["accel_y_mps2"].copy()
    values[120:170] = np.nan
    found = imu.interval_means(
        table.replace(accel_y_mps2=values), np.array([0, SECOND]), np.array([SECOND, 2 * SECOND])
    )
    assert np.isnan(found.force_mps2).tolist() == [[False] * 3, [True] * 3]
    assert not np.isnan(found.rate_radps).any()


def test_one_row_per_second_is_no_mean() -> None:
    table = Table("imu", np.arange(1, 20) * SECOND, dict.fromkeys(NAMES, np.ones(19)))
    found = imu.interval_means(table, np.arange(1, 10) * SECOND, np.arange(2, 11) * SECOND)
    assert np.isnan(found.force_mps2).all()


@pytest.mark.parametrize(
    ("force", "rate", "still"),
    [(0.0, 0.0, 1), (1.0, 0.0, 0), (0.0, 0.05, 0), (np.nan, 0.0, np.nan)],
)
def test_standing_still(force: float, rate: float, still: float) -> None:
    """A swing of 0.5 Hz in specific force, or a steady turn, is motion; neither is standstill."""
    time_ns = np.arange(1, 1000) * SECOND // 100
    swing = force * np.sin(np.pi * time_ns / 1e9)
    columns = {
        **dict.fromkeys(NAMES, np.zeros(time_ns.size)),
        "accel_z_mps2": -9.8 + swing,
        "gyro_z_radps": np.full(time_ns.size, rate),
    }
    found = imu.is_stationary(
        Table("imu", time_ns, columns), np.arange(2, 9) * SECOND, imu.Standstill()
    )
    np.testing.assert_array_equal(found, np.full(7, still))


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_standstill_is_the_spread_of_smoothed_force_and_the_rms_of_rate(seed: int) -> None:
    table = rows(seed, 400, averaged=True)
    for end in (SECOND * 3 // 2, 2 * SECOND, 3 * SECOND):
        blocks = [
            [
                literal_mean(table, name, end - (k + 1) * SECOND // 5, end - k * SECOND // 5)
                for name in NAMES[:3]
            ]
            for k in range(5)
        ]
        spread = math.sqrt(sum(np.var([block[axis] for block in blocks]) for axis in range(3)))
        squared = table.replace(gyro_x_radps=sum(table[name] ** 2 for name in NAMES[3:]))
        rms = math.sqrt(literal_mean(squared, "gyro_x_radps", end - SECOND, end))
        for force_limit, rate_limit in ((1.001, 1.001), (0.999, 1.001), (1.001, 0.999)):
            rest = imu.Standstill(
                force_std_mps2=force_limit * spread, rate_rms_radps=rate_limit * rms
            )
            expected = force_limit > 1 and rate_limit > 1
            assert imu.is_stationary(table, np.array([end]), rest).tolist() == [expected]


def test_a_running_engine_is_smoothed_away() -> None:
    rng, time_ns = np.random.default_rng(5), np.arange(1, 1000) * SECOND // 100
    columns = {
        **dict.fromkeys(NAMES, np.zeros(time_ns.size)),
        "accel_x_mps2": np.sin(2 * np.pi * 25 * time_ns / 1e9) + rng.normal(0, 0.1, 999),
    }
    assert imu.is_stationary(
        Table("imu", time_ns, columns), np.array([5 * SECOND]), imu.Standstill()
    ).tolist() == [1]


@given(st.integers(0, 2**32 - 1), st.sampled_from([8.0, 100.0]), st.floats(0, 0.6))
def test_held_means_against_a_loop(seed: int, rate_hz: float, lag_s: float) -> None:
    """The integral of a staircase: each sample holds back to the one before it, the last one on to
    the edge.
    """
    rng = np.random.default_rng(seed)
    time_s = np.round(np.cumsum(rng.uniform(0.8, 1.2, 300) / rate_hz), 9)
    force = rng.normal(9.8, 1, 300)
    force[rng.random(300) < 0.05] = np.nan
    time_s[150:] += 0.6
    edges = np.arange(0, time_s[-1] + 1, 0.5) - lag_s
    got = imu.held_means(
        np.round(time_s * 1e9).astype(np.int64), force, np.round(edges * 1e9).astype(np.int64), 0.25
    )
    kept = ~np.isnan(force)
    t, f = time_s[kept], force[kept]

    def integral(edge: float) -> float:
        total = sum(f[j] * (t[j] - t[j - 1]) for j in range(1, t.size) if t[j] <= edge)
        last = max(j for j in range(t.size) if t[j] <= edge)
        return float(total + f[last] * (edge - t[last]))

    for n in range(1, edges.size):
        a, b = edges[n - 1], edges[n]
        before = [j for j in range(t.size) if t[j] <= a]
        upto = [j for j in range(t.size) if t[j] <= b]
        silent = not before or a - t[before[-1]] > 0.25 or b - t[upto[-1]] > 0.25
        silent = silent or any(t[j] - t[j - 1] > 0.25 for j in upto if j > before[-1])
        if silent:
            assert math.isnan(got[n])
        else:
            assert got[n] == pytest.approx((integral(b) - integral(a)) / (b - a), abs=1e-7)


def test_the_interval_is_open_at_its_start_and_closed_at_its_end() -> None:
    time_s = np.arange(1, 41) * 0.1
    force = np.where(np.round(time_s, 3) <= 2.0, -9.0, -11.0)
    got = imu.held_means(
        np.round(time_s * 1e9).astype(np.int64), force, np.array([1, 2, 3]) * SECOND, 0.25
    )
    np.testing.assert_allclose(got, [np.nan, -9.0, -11.0], rtol=1e-12)


@pytest.mark.parametrize(
    ("axes", "direction", "axis", "sign"),
    [
        ("frd", "up", 2, -1),
        ("frd", "forward", 0, 1),
        ("rfu", "forward", 1, 1),
        ("ULB", "forward", 2, -1),
        ("ulb", "up", 0, 1),
    ],
)
def test_axes_along_directions(axes: str, direction: str, axis: int, sign: int) -> None:
    assert imu.axis_along(axes, direction) == (axis, sign)


@pytest.mark.parametrize("axes", ["", "fr", "ffd", "xyz", "frdd", "fbu"])
def test_unknown_axes_are_refused(axes: str) -> None:
    with pytest.raises(RecordingError, match="say where x, y and z point"):
        imu.axis_along(axes, "up")


def test_the_axes_are_those_of_the_primary_imu() -> None:
    table = rows(0, 5, averaged=False)
    tables = {"/a/imu": table, "/b/imu": table}
    about = {"primary": {"imu": "b"}, "source/a": {"axes": "flu"}, "source/b": {"axes": "rfu"}}
    assert imu.imu_axes(Recording(tables, about)) == "rfu"
    assert imu.imu_axes(Recording({"/a/imu": table}, {})) == "frd"
    with pytest.raises(RecordingError, match="no 'imu'"):
        imu.imu_axes(Recording({}, {}))


@given(st.lists(st.integers(0, 20), max_size=15), st.lists(st.integers(-2, 22), max_size=15))
def test_the_last_row_is_the_newest_that_is_not_in_the_future(
    times: list[int], wanted: list[int]
) -> None:
    times.sort()
    found = imu.last_row(np.array(times, np.int64), np.array(wanted, np.int64))
    assert found.tolist() == [sum(t <= at for t in times) - 1 for at in wanted]
