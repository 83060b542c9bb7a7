"""The comparison on a real car: 43 minutes at 1 Hz, IMU at 100 Hz, receiver's stamps late by about
a third of a second.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spoofbench_acceleration import AccelerationMonitor

from spoofbench.codec import read
from spoofbench.recording import Recording

pytestmark = pytest.mark.drive

CAR = AccelerationMonitor(axis="along_track", pitch=True, lag_s=0.34)


@pytest.fixture(scope="module")
def real_drive(converted_drive: Path) -> Recording:
    return read(converted_drive)


def _correlation(monitor: AccelerationMonitor, recording: Recording) -> float:
    comparison = monitor.compare(recording)
    both = ~np.isnan(comparison.sensed_mps2 + comparison.expected_mps2)
    assert both.mean() > 0.9
    return float(np.corrcoef(comparison.sensed_mps2[both], comparison.expected_mps2[both])[0, 1])


def test_the_along_track_axis_works_with_pitch_alone(real_drive: Recording) -> None:
    assert _correlation(CAR, real_drive) >= 0.98
    assert _correlation(replace(CAR, pitch=False), real_drive) <= 0.90


def test_the_vertical_axis_says_little_on_the_road(real_drive: Recording) -> None:
    assert _correlation(replace(CAR, axis="vertical"), real_drive) < 0.75


def test_the_mounting_is_seen_and_taken_out(real_drive: Recording) -> None:
    """The IMU's forward axis points up by about 3 deg against the direction of travel."""
    tilt = np.degrees(np.arcsin(_offset(CAR, real_drive) / CAR.gravity_mps2))
    assert 2.5 < tilt < 3.5
    assert abs(_offset(replace(CAR, mounting_pitch_deg=float(tilt)), real_drive)) < 0.02


def _offset(monitor: AccelerationMonitor, recording: Recording) -> float:
    comparison = monitor.compare(recording)
    return float(np.nanmean(comparison.sensed_mps2 - comparison.expected_mps2))
