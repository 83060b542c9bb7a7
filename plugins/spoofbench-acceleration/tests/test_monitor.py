"""The monitor as a whole: it keeps its contract, is quiet on clean drives, alerts on spoofed
ones.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from spoofbench_acceleration import AccelerationMonitor

from spoofbench.detector import detect
from spoofbench.errors import PluginError, RecordingError
from spoofbench.plugins import DETECTORS, make
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import check_detector, drive, spoofed_drive

CAR = AccelerationMonitor(axis="along_track", pitch=True)


@check_detector("acceleration")
def test_as_published(check: Any) -> None:
    check()


@check_detector(
    "acceleration",
    executive="simple",
    axis="along_track",
    pitch=True,
    averaging="time_constant",
    lag_s=0.34,
)
def test_for_a_car(check: Any) -> None:
    check()


@check_detector("acceleration", acceleration_from="position", roll=True, stride=3, gate=False)
def test_from_positions(check: Any) -> None:
    check()


@pytest.mark.parametrize("executive", ["simple", "multi"])
@pytest.mark.parametrize("gnss_hz", [1.0, 10.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_quiet_before_the_attack_and_loud_within(executive: Any, gnss_hz: float, seed: int) -> None:
    recording = spoofed_drive(seed, 240.0, gnss_hz)
    decisions = detect(replace(CAR, executive=executive), recording)
    attacked = decisions.time_ns >= recording["/truth/attack"]["start_ns"][0]
    assert not decisions.alert[~attacked].any()
    assert decisions.available[~attacked].mean() > 0.6
    assert decisions.alert[attacked].mean() > 0.2


def test_the_multi_condition_monitor_alerts_wherever_the_simple_one_does() -> None:
    recording = spoofed_drive(1, 240.0, 10.0)
    simple, multi = (
        detect(replace(CAR, executive=executive), recording) for executive in ("simple", "multi")
    )
    assert np.all(multi.score[multi.available] >= simple.score[simple.available])


def test_pitch_lifts_the_along_track_correlation() -> None:
    recording = drive(4, 240.0)
    with_pitch, without = (
        _correlation(replace(CAR, pitch=pitch), recording) for pitch in (True, False)
    )
    assert with_pitch > 0.99
    assert without < with_pitch


def test_a_lag_is_taken_out() -> None:
    """A receiver whose stamps are late by 0.3 s shows what the IMU felt 0.3 s before."""
    recording = drive(5, 240.0)
    table = recording["/gnss0/gnss/pvt"]
    columns = {name: table.column(name) for name in table}
    late = recording.replace(
        {"/gnss0/gnss/pvt": Table("gnss/pvt", table.time_ns + 300_000_000, columns)}
    )
    right = _correlation(CAR, recording)
    assert _correlation(CAR, late) < right - 0.005
    assert _correlation(replace(CAR, lag_s=0.3), late) == pytest.approx(right, abs=1e-6)


@pytest.mark.parametrize("axes", ["rfu", "bld", "dlf"])
def test_an_imu_mounted_otherwise_gives_the_same_decisions(axes: str) -> None:
    recording = spoofed_drive(6, 120.0)
    expected = detect(CAR, recording)
    turned = _remounted(recording, axes)
    for decisions in (
        detect(CAR, turned),
        detect(replace(CAR, axes=axes), turned.with_metadata({"source/imu0": {"axes": "frd"}})),
    ):
        np.testing.assert_allclose(decisions.score, expected.score, rtol=1e-9)


def test_a_mounting_pitch_is_taken_out() -> None:
    """An IMU tilted back by 3 deg feels half a m/s^2 forward at rest: the mean-difference test
    flags always.
    """
    recording = drive(7, 240.0)
    tilted = _tilted(recording, np.radians(3.0))
    assert _offset(CAR, tilted) == pytest.approx(9.8 * np.sin(np.radians(3)), abs=0.06)
    assert _offset(replace(CAR, mounting_pitch_deg=3.0), tilted) == pytest.approx(
        _offset(CAR, recording), abs=0.01
    )


def test_the_gate_leaves_out_epochs_without_a_fix() -> None:
    recording = drive(8, 120.0, flaws=False)
    table = recording["/gnss0/gnss/pvt"]
    row = np.arange(len(table)) == 60
    dropout = table.replace(
        fix_type=np.where(row, 1, table["fix_type"]),
        vel_d_mps=np.where(row, 30.0, table["vel_d_mps"]),
    )
    broken = recording.replace({"/gnss0/gnss/pvt": dropout})
    monitor = AccelerationMonitor()
    assert not detect(monitor, broken).alert.any()
    assert detect(replace(monitor, gate=False), broken).alert[60:].any()


def test_no_motion_yet_is_unavailable_along_track() -> None:
    parked = drive(9, 60.0, 10.0).until(1_700_000_000_000_000_000 + 9 * 10**9)
    assert not detect(CAR, parked).available.any()
    assert detect(replace(CAR, axis="vertical"), parked).available.any()


def test_an_alert_does_not_outlast_its_memory() -> None:
    recording = drive(10, 240.0, flaws=False)
    table = recording["/gnss0/gnss/pvt"]
    false = np.arange(len(table)) == 80
    jumped = recording.replace(
        {"/gnss0/gnss/pvt": table.replace(vel_n_mps=table["vel_n_mps"] + 30.0 * false)}
    )
    for averaging in ("span", "time_constant"):
        monitor = replace(CAR, averaging=averaging)
        alerts = np.flatnonzero(detect(monitor, jumped).alert)
        assert alerts[0] >= 80
        assert alerts[-1] - 81 <= monitor.memory_s


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"executive": "both"}, "executive = 'both' must be one of 'simple', 'multi'"),
        ({"lag_s": -0.1}, "lag_s must be at least 0"),
        ({"samples": 1}, "samples must be at least 2"),
        ({"sigma_mps2": 0.0}, "sigma_mps2 must be above 0"),
        ({"window": 5}, "has no parameter 'window'"),
    ],
)
def test_wrong_parameters_are_refused(parameters: dict[str, Any], reason: str) -> None:
    with pytest.raises(PluginError, match=reason):
        make(DETECTORS, "acceleration", parameters)


def test_unknown_axes_are_refused() -> None:
    with pytest.raises(RecordingError, match="'unknown'"):
        detect(CAR, drive(0, 60.0).with_metadata({"source/imu0": {"axes": "unknown"}}))


def _correlation(monitor: AccelerationMonitor, recording: Recording) -> float:
    comparison = monitor.compare(recording)
    both = ~np.isnan(comparison.sensed_mps2 + comparison.expected_mps2)
    return float(np.corrcoef(comparison.sensed_mps2[both], comparison.expected_mps2[both])[0, 1])


def _offset(monitor: AccelerationMonitor, recording: Recording) -> float:
    comparison = monitor.compare(recording)
    return float(np.nanmean(comparison.sensed_mps2 - comparison.expected_mps2))


def _remounted(recording: Recording, axes: str) -> Recording:
    """The same motion felt by an IMU whose x, y, z point elsewhere."""
    imu = recording["/imu0/imu"]
    forward_right_down = [imu[f"accel_{axis}_mps2"] for axis in "xyz"]
    places = {"f": (0, 1), "b": (0, -1), "r": (1, 1), "l": (1, -1), "d": (2, 1), "u": (2, -1)}
    columns = {
        f"accel_{x}_mps2": places[letter][1] * forward_right_down[places[letter][0]]
        for x, letter in zip("xyz", axes, strict=True)
    }
    return recording.replace({"/imu0/imu": imu.replace(**columns)}).with_metadata(
        {"source/imu0": {"axes": axes}}
    )


def _tilted(recording: Recording, pitch_rad: float) -> Recording:
    imu = recording["/imu0/imu"]
    x, z = imu["accel_x_mps2"], imu["accel_z_mps2"]
    cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
    return recording.replace(
        {"/imu0/imu": imu.replace(accel_x_mps2=x * cos - z * sin, accel_z_mps2=z * cos + x * sin)}
    )
