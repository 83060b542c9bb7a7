"""The monitor on a real car: 43 minutes at 1 Hz, IMU at 100 Hz, receiver's stamps late by about a
third of a second.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spoofbench_innovation import InnovationMonitor, nis

from spoofbench.codec import read
from spoofbench.recording import Recording

pytestmark = pytest.mark.drive

CAR = InnovationMonitor(lag_s=0.34)


@pytest.fixture(scope="module")
def real_drive(converted_drive: Path) -> Recording:
    return read(converted_drive)


@pytest.mark.parametrize("statistic", ["windowed", "cumulative", "per-epoch"])
def test_quiet_on_the_genuine_drive(real_drive: Recording, statistic: Any) -> None:
    decisions = replace(CAR, statistic=statistic).detect(real_drive)
    assert not decisions.alert.any()
    assert decisions.available[180:].all()


def test_the_lag_matters(real_drive: Recording) -> None:
    """Untold of it the filter takes turns and braking for errors of GNSS."""
    assert replace(CAR, lag_s=0.0).detect(real_drive).alert.mean() > 0.2


def test_the_innovations_are_not_white(real_drive: Recording) -> None:
    """Position errors last longer than a minute, so the covariance that covers them leaves single
    epochs too quiet.
    """
    numbers = nis.measure(real_drive, CAR, 600.0)
    assert numbers["raw"]["mean_per_measurement"]["position"] < 0.3
    assert 0.4 < numbers["raw"]["mean_per_measurement"]["velocity"] < 0.7
    assert numbers["autocorrelation"]["x"]["1"] > 0.95
    assert numbers["cumulative"]["variance_factor"] > 2
    assert numbers["inflated"]["exceeding"]["windowed"] > numbers["raw"]["exceeding"]["windowed"]


def test_the_innovations_are_those_of_a_filter_that_navigates(real_drive: Recording) -> None:
    _, found = CAR.filtered(real_drive)
    spread = np.nanstd(found.value[found.run >= 0], axis=0)
    assert (spread[:3] < 2.0).all()
    assert (spread[3:] < 0.1).all()
