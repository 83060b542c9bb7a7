"""The detector as a whole: it keeps its contract, is quiet on clean drives, alerts on spoofed
ones.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from spoofbench_innovation import InnovationMonitor, gains
from spoofbench_innovation.error_model import GRADES
from spoofbench_innovation.filtering import Innovations
from spoofbench_innovation.monitor import ratio, thresholds_squared

from spoofbench.detector import Trainable, detect
from spoofbench.errors import NotApplicable, PluginError
from spoofbench.navigation.preintegration import rotations
from spoofbench.plugins import DETECTORS, make
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import check_detector, drive, spoofed_drive

MONITOR = InnovationMonitor()


@check_detector("innovation")
def test_windowed(check: Any) -> None:
    check()


@check_detector("innovation", statistic="cumulative", grade="tactical", lag_s=0.1, reported=True)
def test_cumulative(check: Any) -> None:
    check()


@check_detector("innovation", statistic="per-epoch", restart_s=3.0, grade="consumer", inflation=2.0)
def test_per_epoch(check: Any) -> None:
    check()


@pytest.mark.parametrize("statistic", ["windowed", "cumulative", "per-epoch"])
@pytest.mark.parametrize("gnss_hz", [1.0, 10.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_quiet_before_the_attack_and_loud_within(statistic: Any, gnss_hz: float, seed: int) -> None:
    recording = spoofed_drive(seed, 240.0, gnss_hz)
    decisions = detect(replace(MONITOR, statistic=statistic), recording)
    attacked = decisions.time_ns >= recording["/truth/attack"]["start_ns"][0]
    assert not decisions.alert[~attacked].any()
    assert decisions.available[attacked].mean() > 0.9
    assert decisions.alert[attacked].any()


def test_a_lag_is_taken_out() -> None:
    """A receiver whose stamps are late by 0.3 s is foreseen as well as one that is in time, if the
    lag is known.
    """
    recording = drive(5, 240.0)
    table = recording["/gnss0/gnss/pvt"]
    late = recording.replace(
        {
            "/gnss0/gnss/pvt": Table(
                "gnss/pvt",
                table.time_ns + 300_000_000,
                {name: table.column(name) for name in table},
            )
        }
    )
    right = _mean(MONITOR, recording)
    assert _mean(replace(MONITOR, lag_s=0.3), late) == pytest.approx(right, rel=1e-6)
    assert _mean(MONITOR, late) > 3 * right


def test_the_mounting_does_not_matter() -> None:
    recording = spoofed_drive(6, 120.0)
    imu = recording["/imu0/imu"]
    turn = rotations(np.array([0.3, -1.2, 2.0]))
    columns = {}
    for sensor, unit in (("accel", "mps2"), ("gyro", "radps")):
        turned = turn @ np.stack([imu[f"{sensor}_{axis}_{unit}"] for axis in "xyz"])
        columns |= {
            f"{sensor}_{axis}_{unit}": values for axis, values in zip("xyz", turned, strict=True)
        }
    expected = detect(MONITOR, recording)
    score = detect(MONITOR, recording.replace({"/imu0/imu": imu.replace(**columns)})).score
    np.testing.assert_allclose(score, expected.score, rtol=1e-5)


def test_positions_alone_are_monitored() -> None:
    recording = spoofed_drive(7, 240.0)
    without = dict.fromkeys(["vel_n_mps", "vel_e_mps", "vel_d_mps"])
    alone = recording.replace({"/gnss0/gnss/pvt": recording["/gnss0/gnss/pvt"].replace(**without)})
    decisions = detect(MONITOR, alone)
    attacked = decisions.time_ns >= recording["/truth/attack"]["start_ns"][0]
    assert decisions.available[attacked].mean() > 0.9
    assert not decisions.alert[~attacked].any()
    assert decisions.alert[attacked].any()


def test_a_long_gap_starts_anew() -> None:
    """After it nothing is known until the filter is aligned again; a short one is bridged."""
    recording = drive(8, 240.0, flaws=False)
    table = recording["/gnss0/gnss/pvt"]
    hole = table.take((table.time_ns < table.time_ns[100]) | (table.time_ns > table.time_ns[130]))
    broken = recording.replace({"/gnss0/gnss/pvt": hole})
    bridged, anew = detect(MONITOR, broken), detect(replace(MONITOR, restart_s=20.0), broken)
    assert bridged.available[99:].all()
    assert not anew.available[100]
    assert anew.available[-1]
    assert not (bridged.alert | anew.alert).any()


@pytest.mark.parametrize("statistic", ["windowed", "per-epoch"])
def test_an_alert_does_not_outlast_its_memory(statistic: Any) -> None:
    """After a minute of a track that is 300 m off and turned by a right angle."""
    recording = drive(10, 900.0, flaws=False)
    table = recording["/gnss0/gnss/pvt"]
    off = (np.arange(len(table)) >= 200) & (np.arange(len(table)) < 260)
    north, east = (
        np.where(off, -table["vel_e_mps"], table["vel_n_mps"]),
        np.where(off, table["vel_n_mps"], table["vel_e_mps"]),
    )
    moved = table.replace(vel_n_mps=north, vel_e_mps=east, lat_deg=table["lat_deg"] + 0.0027 * off)
    monitor = replace(MONITOR, statistic=statistic)
    alerts = np.flatnonzero(detect(monitor, recording.replace({"/gnss0/gnss/pvt": moved})).alert)
    assert alerts[0] == 200
    assert 259 < alerts[-1] < 260 + monitor.memory_s


@given(st.data())
@settings(max_examples=25)
def test_absurd_values_give_decisions(data: st.DataObject) -> None:
    """Whatever a damaged log holds: no error, no warning, no NaN where available."""
    recording = drive(0, 60.0)
    for topic in ("/gnss0/gnss/pvt", "/imu0/imu"):
        table = recording[topic]
        name = data.draw(
            st.sampled_from(sorted(name for name in table if table[name].dtype.kind == "f"))
        )
        row, value = data.draw(st.integers(0, len(table) - 1)), data.draw(st.floats(width=32))
        recording = recording.replace(
            {
                topic: table.replace(
                    **{name: np.where(np.arange(len(table)) == row, value, table[name])}
                )
            }
        )
    decisions = detect(replace(MONITOR, reported=True), recording)
    assert decisions.time_ns.size


def test_fitting_finds_the_lag() -> None:
    late = [drive(seed, 240.0, lag_s=0.3).blind() for seed in (0, 1)]
    assert MONITOR.fit(late, []).lag_s == pytest.approx(0.3, abs=0.1)


def test_fitting_raises_the_inflation_to_the_mean_of_clean_recordings_and_never_lowers_it() -> None:
    assert isinstance(MONITOR, Trainable)
    clean = [drive(seed, 240.0).blind() for seed in (0, 1)]
    optimistic = replace(MONITOR, velocity_mps=0.005, climb_mps=0.005)
    fitted = optimistic.fit(clean, [])
    optimistic = replace(optimistic, lag_s=fitted.lag_s)
    found = [optimistic.filtered(recording)[1] for recording in clean]
    mean = sum(one.squared[one.run >= 0].sum() for one in found) / sum(
        one.measured[one.run >= 0].sum() for one in found
    )
    assert fitted == replace(optimistic, inflation=mean)
    assert mean > 1
    assert MONITOR.fit(clean, []).inflation == 1


def test_what_does_not_move_cannot_be_fitted() -> None:
    with pytest.raises(NotApplicable, match="the lag cannot be fitted"):
        MONITOR.fit([drive(0, 60.0).blind()], [])


def test_variants_share_what_the_imu_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """The covariance recursion runs once for a recording and its variants, and once more where
    other rows are missing.
    """
    runs = []
    recursion = gains.recursion
    monkeypatch.setattr(gains, "recursion", lambda *given: runs.append(1) or recursion(*given))
    clean, spoofed = drive(9, 240.0), spoofed_drive(9, 240.0)
    imu = clean["/imu0/imu"]
    spoofed = spoofed.replace({"/imu0/imu": imu})
    detect(MONITOR, clean)
    detect(MONITOR, spoofed)
    assert len(runs) == 1
    table = spoofed["/gnss0/gnss/pvt"]
    detect(MONITOR, spoofed.replace({"/gnss0/gnss/pvt": table.replace(vel_d_mps=None)}))
    assert len(runs) == 2


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        (
            {"statistic": "mean"},
            "statistic = 'mean' must be one of 'cumulative', 'windowed', 'per-epoch'",
        ),
        ({"grade": "toy"}, "grade = 'toy' must be one of"),
        ({"p_fa": 0.0}, "p_fa must lie between 0 and 1"),
        ({"lag_s": -0.1}, "lag_s must be 0 or more"),
        ({"gyro_bias_radps": -1.0}, "gyro_bias_radps must be positive"),
        ({"restart_s": 1.0}, "restart_s must be finite and at least 2"),
        ({"window": 5}, "has no parameter 'window'"),
    ],
)
def test_wrong_parameters_are_refused(parameters: dict[str, Any], reason: str) -> None:
    with pytest.raises(PluginError, match=reason):
        make(DETECTORS, "innovation", parameters)


def test_parameters_override_the_grade() -> None:
    monitor = replace(MONITOR, grade="navigation", accel_bias_mps2=0.5)
    assert monitor.imu_errors == replace(GRADES["navigation"], accel_bias_mps2=0.5)


def _mean(monitor: InnovationMonitor, recording: Recording) -> float:
    found = monitor.filtered(recording)[1]
    return float(found.squared[found.run >= 0].mean())


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["cumulative", "windowed", "per-epoch"]),
    st.floats(0.5, 20),
)
def test_sums_against_a_loop(seed: int, statistic: Any, window_s: float) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 40))
    time_ns = np.cumsum(rng.integers(1, 3 * 10**9, size))
    value = rng.normal(0, 1, (size, 6))
    value[rng.random((size, 6)) < 0.3] = np.nan
    run = np.sort(rng.integers(-1, 3, size))
    spread = rng.normal(0, 1, (size, 6, 6))
    covariance = spread @ spread.swapaxes(1, 2) + np.eye(6)
    for k in range(size):
        absent = np.isnan(value[k])
        covariance[k][absent, :] = covariance[k][:, absent] = 0
        covariance[k][absent, absent] = 1
    got = ratio(time_ns, Innovations(value, covariance, run), statistic, window_s, 1e-3)
    for k in range(size):
        known = ~np.isnan(value[k])
        if run[k] < 0 or not known.any():
            assert np.isnan(got[k])
            continue
        q, degrees = 0.0, 0
        for i in range(k + 1):
            young = (
                statistic == "cumulative"
                or (statistic == "windowed" and time_ns[i] > time_ns[k] - round(window_s * 1e9))
                or i == k
            )
            rows = ~np.isnan(value[i])
            if run[i] == run[k] and young and rows.any():
                q += float(
                    value[i, rows]
                    @ np.linalg.inv(covariance[i][np.ix_(rows, rows)])
                    @ value[i, rows]
                )
                degrees += int(rows.sum())
        assert got[k] == pytest.approx(q / stats.chi2.isf(1e-3, degrees), rel=1e-8)


@given(
    st.lists(st.integers(1, 20_000), min_size=1, max_size=20),
    st.sampled_from([1e-9, 1e-6, 1e-3, 0.5]),
)
def test_thresholds(degrees: list[int], p_fa: float) -> None:
    np.testing.assert_allclose(
        thresholds_squared(np.array(degrees, float), p_fa), stats.chi2.isf(p_fa, degrees), rtol=1e-9
    )


def test_the_papers_threshold() -> None:
    """Tanil et al. (2018): T = 56.4 for 281 epochs of 10 measurements at 1e-6."""
    assert thresholds_squared(np.array([2810.0]), 1e-6)[0] ** 0.5 == pytest.approx(56.399, abs=1e-3)


def test_the_largest_innovations_leave_later_windows_as_they_are() -> None:
    found = Innovations(np.full((3, 6), 1e8), np.tile(np.eye(6), (3, 1, 1)), np.zeros(3, int))
    found.value[1:] = 0.1
    after = ratio(np.arange(3) * 10**9, found, "windowed", 1.0, 1e-6)
    assert after[0] > 1e7
    np.testing.assert_allclose(after[1:], 0.06 / stats.chi2.isf(1e-6, 6), atol=1e-4)
