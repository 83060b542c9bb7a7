"""The detector as a whole: it keeps its contract, is quiet on clean drives, alerts on spoofed ones."""

from dataclasses import replace
from typing import Any

import pytest
from spoofbench_innovation import InnovationMonitor

from spoofbench.detecting import detect
from spoofbench.testing import check_detector, spoofed_drive

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
