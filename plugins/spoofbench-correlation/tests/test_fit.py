"""Fitting finds the receiver's lag, and what standstill is for an IMU."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from spoofbench_correlation import Correlation, ZeroVelocity
from spoofbench_correlation.correlation import CorrelationStatistic

from spoofbench.detector import Trainable, detect
from spoofbench.errors import NotApplicable
from spoofbench.navigation.imu import FORCE, RATE
from spoofbench.recording import Recording
from spoofbench.testing import drive

IMU, PVT = "/imu0/imu", "/gnss0/gnss/pvt"


def late(seed: int) -> Recording:
    return drive(seed, 300.0, lag_s=0.4).blind()


@pytest.mark.parametrize("statistic", get_args(CorrelationStatistic))
def test_each_statistic_finds_its_lag(statistic: CorrelationStatistic) -> None:
    detector = Correlation(statistic)
    assert isinstance(detector, Trainable)
    fitted = detector.fit([late(1), late(2)], [])
    assert fitted.lag_s == pytest.approx(0.4, abs=0.15)
    assert replace(fitted, lag_s=0.0) == detector


def test_a_fitted_lag_lifts_the_correlation_of_another_drive() -> None:
    detector, other = Correlation("H"), late(3)
    found = [detect(one, other) for one in (detector, detector.fit([late(1), late(2)], []))]
    assert np.nanmean(found[1].score) < np.nanmean(found[0].score) / 2


def shaken(recording: Recording, factor: float) -> Recording:
    """An engine shakes the IMU, at all times alike."""
    imu, rng = recording[IMU], np.random.default_rng(3)
    noise = {name: 0.05 * factor * rng.normal(size=len(imu)) for name in FORCE}
    noise |= {name: 0.01 * factor * rng.normal(size=len(imu)) for name in RATE}
    return recording.replace(
        {IMU: imu.replace(**{name: imu[name] + noise[name] for name in noise})}
    )


def test_limits_of_standstill_follow_the_vibration() -> None:
    clean = [shaken(late(seed), 1.0) for seed in (1, 2)]
    fitted = ZeroVelocity().fit(clean, [])
    assert fitted.lag_s == pytest.approx(0.4, abs=0.1)
    assert fitted.rate_rms_radps > 0.01 * np.sqrt(3)
    unfitted = replace(fitted, force_std_mps2=0.15, rate_rms_radps=0.01, lag_s=0.0)
    assert unfitted == ZeroVelocity()
    other = shaken(late(3), 1.0)
    assert np.nanmean(detect(fitted, other).score) < np.nanmean(detect(unfitted, other).score) / 2


def test_a_drive_without_a_stop_does_not_tell_what_standstill_is() -> None:
    recording = late(1)
    pvt = recording[PVT]
    moving = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"]) > 1.0
    with pytest.raises(NotApplicable, match="GNSS stands still over 0 pairs of epochs and moves"):
        ZeroVelocity().fit([recording.replace({PVT: pvt.take(moving)})], [])
