"""The whole detector against a loop over epochs, and laws of its statistics."""

import math
from typing import Any

import numpy as np
import pytest
from spoofbench_correlation import Correlation

from spoofbench.detector import Decisions, detect
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import drive, spoofed_drive

PVT, IMU = "/gnss0/gnss/pvt", "/imu0/imu"


def values(decisions: Decisions, threshold: float = 0.7) -> np.ndarray:
    return 1 - decisions.score * (1 - threshold)


def means(imu: Table, start: int, end: int) -> np.ndarray:
    """Mean force and rate of rows in (start, end], all of one interval; NaN if they cover less than
    80 %.
    """
    rows = (imu.time_ns > start) & (imu.time_ns <= end)
    if rows.sum() * 0.01 < 0.8 * (end - start) / 1e9:
        return np.full(6, np.nan)
    return np.array([imu[name][rows].mean() for name in list(imu)[:6]])


def literal(
    recording: Recording, statistic: str, window: int, lag_s: float, gravity_s: float
) -> list[float]:
    """Eq (2) to (9) epoch by epoch, gravity by low-pass, at 1 Hz without gaps."""
    pvt, imu = recording[PVT], recording[IMU]
    time, v = (
        pvt.time_ns.tolist(),
        np.stack([pvt["vel_n_mps"], pvt["vel_e_mps"], pvt["vel_d_mps"]], axis=1),
    )
    gravity: np.ndarray | None = None
    pairs: list[tuple[float, float]] = []
    found = [math.nan]
    for n in range(1, len(time)):
        dt, lag = (time[n] - time[n - 1]) / 1e9, round(lag_s * 1e9)
        mean = means(imu, time[n - 1] - lag, time[n] - lag)
        if not np.isnan(mean).any():
            gain = 1 - math.exp(-dt / gravity_s)
            gravity = mean[:3] if gravity is None else gravity + gain * (mean[:3] - gravity)
        acceleration = (v[n] - v[n - 1]) / dt
        turn = (
            math.remainder(
                math.atan2(v[n][1], v[n][0]) - math.atan2(v[n - 1][1], v[n - 1][0]), 2 * math.pi
            )
            / dt
        )
        turn = 0.0 if min(math.hypot(*v[n][:2]), math.hypot(*v[n - 1][:2])) < 1 else turn
        known = np.full(3, np.nan) if gravity is None else gravity
        up = known / np.linalg.norm(known)
        pairs.append(
            {
                "M_acc": (
                    float(np.linalg.norm(mean[:3] - known)),
                    float(np.linalg.norm(acceleration)),
                ),
                "M_ag": (float(np.linalg.norm(mean[3:])), abs(turn)),
                "H_acc": (
                    float(np.linalg.norm(np.cross(mean[:3], up))),
                    math.hypot(*acceleration[:2]),
                ),
                "H_ag": (-float(mean[3:] @ up), turn),
            }[statistic]
        )
        valid = np.array([pair for pair in pairs[-window:] if not np.isnan(pair).any()]).T
        enough = valid.size and valid.shape[1] >= 0.8 * window and valid.std(axis=1).min() > 0
        found.append(float(np.corrcoef(valid)[0, 1]) if enough else math.nan)
    return found


def on_the_second(recording: Recording) -> Recording:
    """Epochs at whole seconds, so that the literal count of terms is the window's seconds."""
    table = recording[PVT]
    start = int(table.time_ns[0])
    time_ns = start + np.rint((table.time_ns - start) / 1e9).astype(np.int64) * 1_000_000_000
    return recording.replace(
        {PVT: Table("gnss/pvt", time_ns, {name: table.column(name) for name in table})}
    )


@pytest.mark.parametrize("statistic", ["M_acc", "M_ag", "H_acc", "H_ag"])
@pytest.mark.parametrize(("window", "lag_s", "gravity_s"), [(60, 0.0, 30.0), (20, 0.34, 8.0)])
def test_is_the_paper_s_arithmetic(
    statistic: Any, window: int, lag_s: float, gravity_s: float
) -> None:
    recording = on_the_second(drive(4, 200.0, flaws=False))
    found = detect(
        Correlation(statistic, window_s=window, lag_s=lag_s, gravity_s=gravity_s), recording
    )
    expected = literal(recording, statistic, window, lag_s, gravity_s)
    assert np.count_nonzero(found.available) > 50
    assert values(found) == pytest.approx(expected, rel=1e-9, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("combined", "parts"), [("M", ("M_acc", "M_ag")), ("H", ("H_acc", "H_ag"))]
)
def test_combinations_are_weighted_sums(combined: Any, parts: tuple[Any, Any]) -> None:
    recording = drive(5)
    acceleration, rate = (
        values(detect(Correlation(part, window_s=40), recording)) for part in parts
    )
    for alpha in (0.0, 0.3, 1.0):
        found = values(detect(Correlation(combined, alpha, window_s=40), recording))
        np.testing.assert_allclose(found, (1 - alpha) * acceleration + alpha * rate, atol=1e-12)


def test_adaptive_weighting_stays_between_its_parts_and_follows_the_dynamics() -> None:
    recording = drive(5)
    acceleration, rate, adaptive, lean = (
        values(detect(Correlation(window_s=40, **parameters), recording))
        for parameters in (
            {"alpha": 0.0},
            {"alpha": 1.0},
            {"adaptive": True},
            {"adaptive": True, "alpha": 0.9},
        )
    )
    both = ~np.isnan(adaptive)
    weight = ((adaptive - acceleration) / (rate - acceleration))[both]
    assert weight.min() >= 0
    assert weight.max() <= 1
    assert np.ptp(weight) > 0.1
    assert np.all(((lean - acceleration) / (rate - acceleration))[both] > weight)


@pytest.mark.parametrize("statistic", ["M_acc", "M_ag", "H_acc", "H_ag"])
@pytest.mark.parametrize("gravity", ["low_pass", "constant", "descent"])
def test_how_the_sensor_is_mounted_does_not_matter(statistic: Any, gravity: Any) -> None:
    recording = drive(6, 200.0)
    turned, _ = np.linalg.qr(np.random.default_rng(1).normal(0, 1, (3, 3)))
    turned *= np.linalg.det(turned)
    imu = recording[IMU]
    accel = turned @ np.stack([imu[f"accel_{axis}_mps2"] for axis in "xyz"])
    gyro = turned @ np.stack([imu[f"gyro_{axis}_radps"] for axis in "xyz"])
    columns = {f"accel_{axis}_mps2": row for axis, row in zip("xyz", accel, strict=True)}
    columns |= {f"gyro_{axis}_radps": row for axis, row in zip("xyz", gyro, strict=True)}
    detector = Correlation(statistic, window_s=40, gravity=gravity)
    straight, askew = (
        detect(detector, recording),
        detect(detector, recording.replace({IMU: imu.replace(**columns)})),
    )
    assert straight.available.any()
    np.testing.assert_allclose(askew.score, straight.score, rtol=1e-6, atol=1e-6)


def test_a_turn_to_the_other_side_is_contradiction() -> None:
    recording = drive(7)
    table = recording[PVT]
    mirrored = recording.replace({PVT: table.replace(vel_e_mps=-table["vel_e_mps"])})
    genuine, wrong = (
        values(detect(Correlation("H_ag", window_s=60), r)) for r in (recording, mirrored)
    )
    np.testing.assert_allclose(wrong, -genuine, atol=1e-12)
    assert np.nanmedian(genuine) > 0.9


def test_the_lag_of_a_late_receiver_is_taken_out() -> None:
    recording = drive(8, 200.0, 5.0, flaws=False)
    table = recording[PVT]
    late = recording.replace(
        {
            PVT: Table(
                "gnss/pvt",
                table.time_ns + 400_000_000,
                {name: table.column(name) for name in table},
            )
        }
    )
    on_time, corrected, raw = (
        detect(Correlation(window_s=60, lag_s=lag), r)
        for lag, r in ((0.0, recording), (0.4, late), (0.0, late))
    )
    np.testing.assert_allclose(corrected.score, on_time.score, rtol=1e-9)
    assert np.nanmedian(raw.score) > 1.2 * np.nanmedian(on_time.score)


def test_a_replay_alerts_and_the_drive_itself_does_not() -> None:
    recording = spoofed_drive(1, 400.0)
    decisions = detect(Correlation(window_s=60), recording)
    start = int(recording["/truth/attack"]["start_ns"][0])
    before, long_after = decisions.time_ns < start, decisions.time_ns > start + 70_000_000_000
    assert not decisions.alert[before].any()
    assert decisions.alert[long_after & decisions.available].all()


def test_the_score_is_one_at_the_threshold() -> None:
    recording = drive(9)
    found = detect(Correlation(window_s=60), recording)
    middle = float(np.nanmedian(values(found)))
    again = detect(Correlation(window_s=60, threshold=middle), recording)
    assert np.nanmedian(again.score) == pytest.approx(1)
    assert again.alert.tolist() == (values(found) < middle).tolist()


def test_a_parked_car_gives_nothing_to_correlate() -> None:
    recording = drive(10)
    table = recording[PVT]
    parked = recording.replace(
        {
            PVT: table.replace(
                **{f"vel_{axis}_mps": 0.01 * table[f"vel_{axis}_mps"] for axis in "ned"}
            )
        }
    )
    assert not detect(Correlation("H", window_s=40), parked).available.any()
    assert detect(Correlation("H_acc", window_s=40), parked).available.any()


def test_long_gaps_are_no_pairs_and_too_many_of_them_no_statistic() -> None:
    recording = drive(11, 240.0)
    table = recording[PVT]
    start = table.time_ns[0]
    sparse = recording.replace(
        {
            PVT: table.take(
                (table.time_ns < start + 120_000_000_000) | (np.arange(len(table)) % 3 == 0)
            )
        }
    )
    decisions = detect(Correlation(window_s=40), sparse)
    assert decisions.available[decisions.time_ns < start + 90_000_000_000].any()
    assert not decisions.available[decisions.time_ns > start + 150_000_000_000].any()


def test_descent_does_not_know_gravity_before_the_first_stop_unless_told() -> None:
    recording = drive(12)
    imu = recording[IMU]
    shaken = imu.replace(gyro_x_radps=imu["gyro_x_radps"] + 0.02 * (-1.0) ** np.arange(len(imu)))
    restless = recording.replace({IMU: shaken})
    assert not detect(Correlation(window_s=40, gravity="descent"), restless).available.any()
    assert detect(Correlation(window_s=40, gravity="descent", g=9.81), restless).available.any()


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_too_few_epochs_are_unavailable(rows: int) -> None:
    recording = drive(13, 60.0)
    few = recording.replace({PVT: recording[PVT].take(slice(0, rows))})
    assert detect(Correlation(), few).available.tolist() == [False] * rows


@pytest.mark.parametrize(
    "parameters",
    [
        {"statistic": "X"},
        {"gravity": "none"},
        {"alpha": 1.1},
        {"threshold": 1.0},
        {"window_s": 0},
        {"window_s": math.inf},
        {"gravity_s": -1},
        {"w": -1},
        {"g": 0},
        {"lag_s": -0.1},
        {"median_filter": 2},
        {"median_filter": 3.0},
        {"min_share": 0},
    ],
    ids=str,
)
def test_refuses_parameters_that_make_no_sense(parameters: dict[str, Any]) -> None:
    (name, value), *_ = parameters.items()
    with pytest.raises(ValueError, match=f"{name} must be .*{value!r}"):
        Correlation(**parameters)
