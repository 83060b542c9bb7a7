"""Fitting finds what a car's installation was given, and the noise that is left."""

from dataclasses import replace

import numpy as np
import pytest
from spoofbench_acceleration import AccelerationMonitor

from spoofbench.detector import Trainable, detect
from spoofbench.errors import NotApplicable
from spoofbench.navigation.imu import FORCE, RATE
from spoofbench.recording import Recording
from spoofbench.testing import drive

CAR = AccelerationMonitor(axis="along_track", pitch=True)


def installed(seed: int, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> Recording:
    """A drive with a receiver 0.3 s late and an IMU that is turned to the right, then nose up."""
    recording = drive(seed, 300.0, lag_s=0.3)
    imu = recording["/imu0/imu"]
    pitch, yaw = np.radians([pitch_deg, yaw_deg])
    up = [[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]]
    right = [[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    columns = {
        name: values
        for names in (FORCE, RATE)
        for name, values in zip(
            names, np.array(right) @ np.array(up) @ np.stack([imu[n] for n in names]), strict=True
        )
    }
    return recording.replace({"/imu0/imu": imu.replace(**columns)}).blind()


@pytest.mark.parametrize("pitch_deg", [-4.0, 3.0])
def test_lag_and_mounting_are_found(pitch_deg: float) -> None:
    assert isinstance(CAR, Trainable)
    fitted = CAR.fit([installed(seed, pitch_deg) for seed in (1, 2)], [])
    assert fitted.lag_s == pytest.approx(0.3, abs=0.05)
    assert fitted.mounting_pitch_deg == pytest.approx(pitch_deg, abs=0.3)
    assert fitted.axes == ""


def test_mounting_is_left_alone_where_pitch_is() -> None:
    clean = [installed(seed, 3.0) for seed in (1, 2)]
    for monitor in (replace(CAR, pitch=False), AccelerationMonitor()):
        assert monitor.fit(clean, []).mounting_pitch_deg == 0


def test_an_offset_becomes_the_bias() -> None:
    clean = [installed(seed, 3.0) for seed in (1, 2)]
    level = replace(CAR, pitch=False).fit(clean, [])
    assert level.bias_mps2 > 9.81 * np.sin(np.radians(2.0))
    assert CAR.fit(clean, []).bias_mps2 < 0.1


def test_sigma_is_that_of_the_averaged_difference() -> None:
    clean = [installed(seed) for seed in (1, 2, 3)]
    fitted = CAR.fit(clean, [])
    loud = [
        one.replace(
            {
                "/imu0/imu": one["/imu0/imu"].replace(
                    accel_x_mps2=one["/imu0/imu"]["accel_x_mps2"]
                    + 20 * np.random.default_rng(7).normal(size=len(one["/imu0/imu"]))
                )
            }
        )
        for one in clean
    ]
    # 100 samples a second, averaged by 1/3 per epoch: 20 / 10 sqrt(1/5)
    expected = np.hypot(fitted.sigma_mps2, 20 / 10 * np.sqrt(1 / 5))
    assert CAR.fit(loud, []).sigma_mps2 == pytest.approx(expected, rel=0.25)


def test_an_imu_that_looks_back_gets_its_axes() -> None:
    fitted = CAR.fit([installed(seed, yaw_deg=180.0) for seed in (1, 2)], [])
    assert fitted.axes == "bld"
    assert fitted.lag_s == pytest.approx(0.3, abs=0.05)
    with pytest.raises(NotApplicable, match="the lag cannot be fitted"):
        replace(CAR, axes="frd").fit([installed(seed, yaw_deg=180.0) for seed in (1, 2)], [])


def test_a_fitted_monitor_is_quiet_on_another_clean_drive() -> None:
    fitted = CAR.fit([installed(seed, 4.0) for seed in (1, 2, 3)], [])
    other = installed(4, 4.0)
    quiet, loud = (np.nanmean(detect(one, other).score) for one in (fitted, CAR))
    assert quiet < loud / 2


def test_a_receiver_that_is_ahead_gets_no_lag() -> None:
    assert CAR.fit([drive(seed, 300.0, lag_s=-0.3).blind() for seed in (1, 2)], []).lag_s == 0
