"""What the reproduction of Borio makes of recordings: velocities, lags, attacked stretches, shares
and intervals.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_papers import borio
from spoofbench_papers.borio import recordings, standstill, statistics
from spoofbench_papers.borio.statistics import Series

from spoofbench.errors import NotApplicable, SpoofbenchError
from spoofbench.recording import Recording
from spoofbench.table import Table

SECOND = 1_000_000_000
SEMI_MAJOR_M, ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3  # WGS 84
START = 1_700_000_000 * SECOND
LOG = recordings.FieldLog("made", (), "made", "made")


def drive(seconds: int, seed: int, lag_s: float = 0.0) -> Recording:
    """A level car: accelerations and turns of smooth noise, IMU at 50 Hz (FRD), velocity and
    position at 1 Hz that are late.
    """
    rng = np.random.default_rng(seed)
    steps = seconds * 50
    smooth = np.exp(-np.arange(400) / 100)
    along, turn = (np.convolve(rng.normal(0, 1, steps), smooth, "same") for _ in range(2))
    along, turn = along / along.std(), 0.1 * turn / turn.std()
    speed, heading = 15 + np.cumsum(along - along.mean()) / 50, np.cumsum(turn) / 50
    time_ns = START + np.arange(1, steps + 1) * (SECOND // 50)
    force = {
        "accel_x_mps2": along - along.mean(),
        "accel_y_mps2": speed * turn,
        "accel_z_mps2": np.full(steps, -9.81),
    }
    rate = {"gyro_x_radps": np.zeros(steps), "gyro_y_radps": np.zeros(steps), "gyro_z_radps": turn}
    rows = np.arange(49, steps, 50)
    north, east = (speed * np.cos(heading))[rows], (speed * np.sin(heading))[rows]
    pvt = Table(
        "gnss/pvt",
        time_ns[rows] + round(lag_s * SECOND),
        {"vel_n_mps": north, "vel_e_mps": east, "vel_d_mps": np.zeros(rows.size)},
    )
    return Recording(
        {"/imu0/imu": Table("imu", time_ns, {**force, **rate}), "/gnss0/gnss/pvt": pvt}
    )


def session(seed: int, seconds: int = 480) -> recordings.FieldSession:
    return recordings.FieldSession(LOG, drive(seconds, seed), "the receiver's", "IMU", 0.0, 60)


@settings(max_examples=30)
@given(st.floats(-70, 70), st.floats(-179, 179), st.floats(-180, 179.9), st.floats(1, 60))
def test_positions_give_the_velocity_between_them(
    lat_deg: float, lon_deg: float, course_deg: float, speed_mps: float
) -> None:
    """Against steps of a sphere that touches the ellipsoid: its radii of curvature by central
    differences of the meridian.
    """
    steps = np.arange(30)
    lat = np.radians(lat_deg)
    normal = SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY_2 * np.sin(lat) ** 2)
    north, east = (
        speed_mps * np.cos(np.radians(course_deg)),
        speed_mps * np.sin(np.radians(course_deg)),
    )
    table = Table(
        "gnss/pvt",
        START + steps * SECOND,
        {
            "lat_deg": lat_deg + np.degrees(steps * north / _meridian_radius(lat)),
            "lon_deg": lon_deg + np.degrees(steps * east / (normal * np.cos(lat))),
        },
    )
    found, words = recordings.with_velocity(table)
    assert words == "differences of positions"
    assert np.isnan(found["vel_n_mps"][0])
    np.testing.assert_allclose(found["vel_n_mps"][1:], north, atol=2e-3 * speed_mps)
    np.testing.assert_allclose(found["vel_e_mps"][1:], east, atol=2e-3 * speed_mps)


def _meridian_radius(lat: float) -> float:
    def point(angle: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        normal = SEMI_MAJOR_M / np.sqrt(1 - ECCENTRICITY_2 * np.sin(angle) ** 2)
        return normal * np.array([np.cos(angle), (1 - ECCENTRICITY_2) * np.sin(angle)])

    return float(np.linalg.norm(point(lat + 5e-5) - point(lat - 5e-5)) / 1e-4)


def test_a_position_that_is_repeated_says_no_course() -> None:
    columns = {
        "lat_deg": [50, 50.0001, 50.0001, 50.0002],
        "lon_deg": [8.0] * 4,
        "speed_mps": [10.0, 10, 10, 10],
    }
    found, words = recordings.with_velocity(
        Table("gnss/pvt", START + np.arange(4) * SECOND, columns)
    )
    assert words == "the receiver's speed, the course of its positions"
    np.testing.assert_allclose(found["vel_n_mps"], [np.nan, 10, np.nan, 10], atol=1e-9)


def test_a_receiver_with_time_alone_has_no_velocity() -> None:
    with pytest.raises(NotApplicable, match="neither velocity nor position"):
        recordings.with_velocity(
            Table("gnss/pvt", START + np.arange(4) * SECOND, {"height_m": [1.0] * 4})
        )


@given(st.sampled_from([4, 5, 10, 20]), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_fast_receiver_is_brought_to_one_row_a_second(rate_hz: int, seed: int) -> None:
    jitter = np.random.default_rng(seed).integers(-5_000_000, 5_000_000, 60 * rate_hz)
    time_ns = START + np.arange(60 * rate_hz) * (SECOND // rate_hz) + jitter
    kept = recordings.at_1_hz(
        Table("gnss/pvt", time_ns, {"speed_mps": np.arange(time_ns.size, dtype=float)})
    ).time_ns
    assert kept.size == 60
    assert np.abs(np.diff(kept) / SECOND - 1).max() < 0.02


def test_a_slow_receiver_keeps_all_rows() -> None:
    time_ns = START + np.cumsum([1_000_000_000, 800_000_000, 1_200_000_000] * 10)
    assert len(recordings.at_1_hz(Table("gnss/pvt", time_ns, {"speed_mps": np.ones(30)}))) == 30


@pytest.mark.parametrize("lag_s", [-0.6, 0.0, 0.4, 1.1])
def test_the_lag_that_fits_is_the_receivers(lag_s: float) -> None:
    found = drive(300, 7, lag_s)
    assert recordings.fitted_lag_s(found["/imu0/imu"], found["/gnss0/gnss/pvt"], 60) == lag_s


def test_preparing_takes_the_lag_out() -> None:
    late, prompt = (recordings.prepared(LOG, drive(300, 7, lag_s)) for lag_s in (0.4, 0.0))
    assert (late.lag_s, late.window_s) == (0.4, 120)
    one, other = (statistics.series_of(s.recording, "H", 120) for s in (late, prompt))
    np.testing.assert_allclose(one.value, other.value, atol=1e-9)


def test_attacked_stretches_have_the_imu_of_now_and_gnss_of_then() -> None:
    victim, donor = (
        session(1),
        recordings.FieldSession(
            recordings.FieldLog("run", (), "made", ""), drive(480, 2), "", "", 0.0, 60
        ),
    )
    found = dict(statistics.cases(victim, [victim, donor]))
    assert list(found) == [
        "genuine",
        *(f"replay-{delay_s}s" for delay_s in statistics.DELAYS_S),
        "meacon-run",
    ]
    for case, recording in found.items():
        now, felt = recording.primary("gnss/pvt"), recording.primary("imu")
        clean = victim.recording["/imu0/imu"].between(
            int(felt.time_ns[0]), int(felt.time_ns[-1]) + 1
        )
        assert clean == felt
        delay_s = 0 if case == "genuine" else int(case[7:-1]) if case.startswith("replay") else None
        then = (donor if delay_s is None else victim).recording["/gnss0/gnss/pvt"]
        rows = np.searchsorted(then.time_ns, now.time_ns - (delay_s or 0) * SECOND)
        np.testing.assert_allclose(now["vel_n_mps"], then["vel_n_mps"][rows], atol=1e-3)


def test_a_session_too_short_for_two_windows_of_attack_has_none() -> None:
    short = session(3, 120)
    assert list(dict(statistics.cases(short, [short]))) == ["genuine"]
    reasons = dict(statistics.outcomes(short, [short]))
    assert (
        reasons["replay-10s"] == "109 s can be attacked, less than two windows of 60 s"
    )  # 120 epochs span 119 s
    assert "less than the 300 s of history" in str(reasons["replay-300s"])


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_an_interval_holds_the_mean_of_its_blocks_and_is_none_of_few(seed: int) -> None:
    rng = np.random.default_rng(seed)
    series = Series(
        np.arange(1200.0), np.repeat(rng.normal(0, 1, 10), 120) + rng.normal(0, 0.1, 1200)
    )
    low, high = statistics.bootstrap(series, 120, lambda values: float(values.mean()))
    assert low is not None
    assert high is not None
    assert low < series.value.mean() < high
    # ten blocks that hardly vary within: the interval is that of ten numbers, not of 1200
    assert (high - low) / (2 * 1.96) == pytest.approx(
        series.value.reshape(10, 120).mean(axis=1).std() / np.sqrt(10), rel=0.25
    )
    assert statistics.bootstrap(Series(series.time_s[:480], series.value[:480]), 120, np.mean) == (
        None,
        None,
    )


def test_a_threshold_gives_its_own_recording_its_false_alerts() -> None:
    made = {name: session(seed) for seed, name in enumerate(("a", "b"))}
    values = {}
    for name, each in made.items():
        for case, recording in statistics.cases(each, [each]):
            for statistic in statistics.STATISTICS:
                values[name, case, statistic] = statistics.series_of(
                    recording, statistic, each.window_s
                )
    rows = statistics.transfer(values)
    assert len(rows) == 2 * 2 * len(statistics.STATISTICS)
    for row in rows:
        genuine = values[row["applied_to"], "genuine", row["statistic"]].value
        assert row["false_alert_share"] == np.mean(genuine < row["threshold"])
        if row["fitted_on"] == row["applied_to"]:
            assert row["false_alert_share"] == pytest.approx(
                statistics.FALSE_ALERTS, abs=1 / genuine.size
            )


def test_a_parked_car_is_parked_and_its_gyroscope_at_rest() -> None:
    time_ns = START + np.arange(1, 400 * 50 + 1) * (SECOND // 50)
    columns = {
        f"{s}_{a}": np.zeros(time_ns.size)
        for s, unit in (("accel", "mps2"), ("gyro", "radps"))
        for a in (f"{x}_{unit}" for x in "xyz")
    }
    columns["gyro_z_radps"] = np.full(time_ns.size, 0.02)
    north = np.where(np.arange(400) < 200, 0.0, 5.0 + np.sin(np.arange(400) / 5))
    pvt = Table(
        "gnss/pvt",
        time_ns[49::50],
        {"vel_n_mps": north, "vel_e_mps": np.zeros(400), "vel_d_mps": np.zeros(400)},
    )
    found = recordings.FieldSession(
        LOG,
        Recording({"/imu0/imu": Table("imu", time_ns, columns), "/gnss0/gnss/pvt": pvt}),
        "",
        "IMU",
        0.0,
        60,
    )
    times = np.arange(100.0, 399.0)
    assert standstill.parked(found, Series(times, times)).tolist() == (times < 200).tolist()
    (row,) = standstill.at_rest([found])
    assert (row["epochs"], row["force_still_share"], row["rate_still_share"]) == (199, 1, 0)


def test_without_any_log_there_is_a_reason_and_no_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent() -> Path:
        raise SpoofbenchError("the drive is not installed")

    monkeypatch.setattr(recordings, "drive_bag", absent)
    found = borio.reproduce(tmp_path, tmp_path, False, lambda share: None)
    assert found.cells == []
    assert "drive is left out: the drive is not installed." in found.notes
    assert (
        sum("is left out: the folder of logs has no" in note for note in found.notes)
        == len(recordings.LOGS) - 1
    )
