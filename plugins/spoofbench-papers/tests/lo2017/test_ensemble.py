"""The vectorised monitors against the detector's own statistics, the spoofers' laws, and the
paper's printed minima.
"""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_acceleration import statistics as s
from spoofbench_papers.lo2017 import ensemble, tables
from spoofbench_papers.lo2017.approach import APPROACHES, AVERAGING_S, CHOSEN, RATE_HZ, averaged

Array = np.ndarray[Any, Any]
START, EPOCHS = 40, 160


@st.composite
def differences(draw: st.DrawFn) -> Array:
    """Averaged differences of a few runs, ``(epochs, runs)``, loud enough to flag now and then,
    some of them missing.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = draw(st.sampled_from([0.1, 0.3, 1.0])) * np.cumsum(
        rng.normal(0, 0.3, (EPOCHS, 3)), axis=0
    )
    values[rng.random(values.shape) < draw(st.sampled_from([0, 0.02]))] = np.nan
    return values


@given(differences(), st.integers(1, 4), st.sampled_from(["simple", "multi"]))
@settings(max_examples=60)
def test_alerts_are_those_of_the_detector(
    values: Array, stride: int, executive: s.Executive
) -> None:
    alerts = ensemble.flags(values, START, stride).alerts(executive)
    for run, series in enumerate(values.T):
        assert alerts[:, run].tolist() == _alerts(series, stride, executive)


def _alerts(series: Array, stride: int, executive: s.Executive) -> list[bool]:
    paper = ensemble.PAPER
    mean, variance = s.sample_statistics(
        series, np.zeros(series.size, np.int64), paper.samples, stride
    )
    z = s.mean_difference(mean, paper.bias_mps2, paper.sigma_mps2) / paper.z_threshold
    chi2 = s.chi_square(variance, paper.samples, paper.sigma_mps2) / paper.chi2_threshold
    time_s = np.arange(series.size - START) / RATE_HZ
    shares = (paper.flagged_share, paper.flagged_share_alone)
    return (
        s.executive_margin(time_s, z[START:], chi2[START:], paper.window_s, shares, executive) > 1
    ).tolist()


@given(st.integers(0, 2**32 - 1), st.sampled_from([8, 10]))
def test_the_average_is_the_detectors(seed: int, rate_hz: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 1, (120, 2))
    values[rng.random(values.shape) < 0.1] = np.nan
    values[0] = 0.5
    ours = averaged(values, rate_hz)
    for run, series in enumerate(values.T):
        expected, _ = s.exponential_average(
            np.arange(series.size) / rate_hz, series, AVERAGING_S, "span"
        )
        np.testing.assert_allclose(ours[:, run], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("delay_s", [0.5, 2.0])
def test_spoofers_on_a_ramp(delay_s: float) -> None:
    """Repeat-back lags by its delay, extrapolation not at all, and smoothing by half its window."""
    time_s = np.arange(200)[:, None] / RATE_HZ
    lags = {
        "repeat": delay_s,
        "extrapolate": 0.0,
        "extrapolate & smooth": (CHOSEN.smoothing_s - 1 / RATE_HZ) / 2,
    }
    for spoofer, lag_s in lags.items():
        np.testing.assert_allclose(
            ensemble.spoofed(time_s, spoofer, delay_s)[100:], time_s[100:] - lag_s, atol=1e-9
        )  # type: ignore[arg-type]
    assert not ensemble.spoofed(time_s, "zero", delay_s).any()


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["repeat", "extrapolate", "extrapolate & smooth"]),
    st.sampled_from([0.5, 2.0]),
)
def test_a_spoofer_knows_nothing_younger_than_its_delay(
    seed: int, spoofer: ensemble.Spoofer, delay_s: float
) -> None:
    values = np.random.default_rng(seed).normal(0, 1, (100, 2))
    altered, known = values.copy(), 60
    altered[known:] += 1
    late = known + round(delay_s * RATE_HZ)
    before, after = (ensemble.spoofed(x, spoofer, delay_s) for x in (values, altered))
    np.testing.assert_array_equal(before[:late], after[:late])
    assert (before[late] != after[late]).all()


def test_the_printed_minima_come_out() -> None:
    """Flags at every epoch: 0.4 and 0.7 s, and the percentages printed beside these times."""
    for approach in APPROACHES:
        epochs = round(approach.duration_s * RATE_HZ)
        always = np.ones((epochs, 1), np.bool_)
        both, alone = ensemble.Flags(always, always), ensemble.Flags(~always, always)
        assert ensemble.first_detection_s(both.alerts("simple")).item() == pytest.approx(0.4)
        assert ensemble.first_detection_s(alone.alerts("multi")).item() == pytest.approx(0.7)
    percentages = {  # approach and time: percentage
        (place, time): case.detection_pct[monitor][place]
        for case in tables.CASES
        for monitor in ("simple", "multi")
        for place, time in enumerate(case.ttfd_s[monitor])
        if case.name == "extrapolate 2 s" and time in (0.4, 0.7)
    }
    assert len(percentages) == 4
    for (place, time), percent in percentages.items():
        epochs = round(APPROACHES[place].duration_s * RATE_HZ)
        alerts = np.arange(epochs)[:, None] >= round(time * RATE_HZ) - 1
        assert ensemble.percentage(alerts).item() == pytest.approx(percent, abs=0.05)
        assert ensemble.first_detection_s(alerts).item() == pytest.approx(time)


def test_no_alert_is_no_time() -> None:
    assert ensemble.first_detection_s(np.zeros((5, 2), np.bool_)).tolist() == [np.inf, np.inf]


def test_flags_leave_the_window_after_fifty_epochs() -> None:
    flagged = np.zeros((120, 1), np.bool_)
    flagged[10] = True
    counts, _ = ensemble.Flags(flagged, flagged).counts()
    assert np.flatnonzero(counts[:, 0]).tolist() == list(range(10, 60))
    assert all(later - earlier in (-1, 0, 1) for earlier, later in pairwise(counts[:, 0].tolist()))
