"""What is estimated of an installation is what was built in."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.arrays import Floats
from spoofbench.errors import NotApplicable
from spoofbench.navigation.imu import FORCE, RATE, turned_axes
from spoofbench.navigation.installation import (
    LagSeries,
    MotionSeries,
    best_lag,
    imu_heading_rad,
    jackknife_std,
    motion_series,
    trimmed_mean,
)
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing import drive

SERIES = get_args(MotionSeries)


def series_of(recordings: list[Recording], which: MotionSeries) -> list[LagSeries]:
    return [motion_series(one.blind(), which) for one in recordings]


def with_imu(recording: Recording, change: Callable[[Table], Table]) -> Recording:
    return recording.replace({"/imu0/imu": change(recording["/imu0/imu"])})


@pytest.mark.parametrize("which", SERIES)
@settings(max_examples=8, deadline=None)
@given(lag_s=st.floats(-0.5, 2.0), gnss_hz=st.sampled_from([1.0, 4.0]), seed=st.integers(0, 50))
def test_the_lag_is_found_within_its_uncertainty(
    which: MotionSeries, lag_s: float, gnss_hz: float, seed: int
) -> None:
    """Whatever its sign, over gaps, jitter and standstill."""
    recordings = [drive(seed + number, 300.0, gnss_hz, lag_s=lag_s) for number in range(2)]
    found = best_lag(series_of(recordings, which))
    assert abs(found.lag_s - lag_s) < 5 * found.std_s + 0.02
    assert found.std_s < 0.2
    assert found.correlation > 0.5


@pytest.mark.parametrize("which", SERIES)
def test_means_over_a_second_tell_the_lag_too(which: MotionSeries) -> None:
    """Phones log at 1 Hz."""

    def second_by_second(imu: Table) -> Table:
        rows = imu.time_ns[0] + np.arange(1, 290) * 10**9
        edges = np.searchsorted(imu.time_ns, np.append(imu.time_ns[0], rows), "right")
        means = {
            name: np.add.reduceat(imu[name], edges[:-1]) / np.diff(edges) for name in FORCE + RATE
        }
        return Table("imu", rows, {**means, "interval_s": np.ones(rows.size)})

    whole = [drive(seed, 300.0, flaws=False, lag_s=0.4) for seed in range(4)]
    found = best_lag(series_of([with_imu(one, second_by_second) for one in whole], which))
    assert found.lag_s == pytest.approx(0.4, abs=0.15)


def test_the_heading_of_the_imu_is_found() -> None:
    """Turned by 150 degrees clockwise, forward points back and to the right."""
    angle = np.radians(150.0)
    turn = np.array(
        [[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )

    def turned(imu: Table) -> Table:
        columns = {
            name: values
            for names in (FORCE, RATE)
            for name, values in zip(names, turn @ np.stack([imu[n] for n in names]), strict=True)
        }
        return imu.replace(**columns)

    recordings = [with_imu(drive(seed, 240.0), turned).blind() for seed in (1, 2)]
    assert imu_heading_rad(recordings, 0.0) == pytest.approx(angle, abs=0.1)
    lags = [best_lag(series_of(recordings, which)).lag_s for which in SERIES]
    assert lags == pytest.approx([0.0, 0.0], abs=0.1)


def test_axes_turn_by_quarters() -> None:
    assert [turned_axes("frd", quarters) for quarters in range(5)] == [
        "frd", "rbd", "bld", "lfd", "frd",
    ]  # fmt: skip
    assert turned_axes("RUB", 2) == "luf"


@dataclass(frozen=True)
class Wave:
    """Two noisy series of which the IMU's is this much early."""

    lag_s: float = 0.5
    noise: float = 0.1
    minutes: int = 20

    def series(self, seed: int) -> LagSeries:
        rng = np.random.default_rng(seed)
        time_s = np.arange(60.0 * self.minutes)
        phases, rates = rng.uniform(0, 2 * np.pi, 20), rng.uniform(0.05, 1.0, 20)

        def motion(at_s: Floats) -> Floats:
            return np.asarray(np.sin(np.outer(at_s, rates) + phases).sum(axis=1)[None])

        noise = rng.normal(0, self.noise, (2, time_s.size))
        return LagSeries(
            (time_s * 1e9).astype(np.int64),
            motion(time_s) + noise[:1],
            lambda lag_s: motion(time_s + self.lag_s - lag_s) + noise[1:],
        )


def test_the_standard_deviation_is_that_of_repetitions() -> None:
    found = [best_lag([Wave(noise=1.0).series(seed)]) for seed in range(40)]
    errors = np.array([one.lag_s for one in found]) - 0.5
    stated = np.mean([one.std_s for one in found])
    assert 0.6 < errors.std() / stated < 1.6
    assert abs(errors.mean()) < 4 * stated / np.sqrt(40)


def test_recordings_that_disagree_make_it_uncertain() -> None:
    """Blocks alone would not see that one session's receiver is later than another's."""
    together = best_lag([Wave(0.2).series(1), Wave(0.6).series(2), Wave(0.4).series(3)])
    assert together.std_s > 10 * best_lag([Wave(0.4).series(3)]).std_s
    assert together.lag_s == pytest.approx(0.4, abs=0.1)


def test_wild_minutes_do_not_decide() -> None:
    """A phone that is taken in the hand, or a leap of GNSS."""
    calm = Wave(0.5).series(4)
    shaken = np.where(np.arange(1200) // 60 == 3, 100.0, 0.0)
    rng = np.random.default_rng(5)
    noise = shaken * rng.normal(size=(2, 1200))
    wild = [
        LagSeries(calm.time_ns, calm.gnss + noise[:1], calm.imu),
        LagSeries(calm.time_ns, calm.gnss, lambda lag_s: calm.imu(lag_s) + noise[1:]),
    ]
    for one in wild:
        assert best_lag([one]).lag_s == pytest.approx(best_lag([calm]).lag_s, abs=0.03)


def test_equally_good_lags_give_their_middle() -> None:
    """Rows of a second at the times of the epochs: only whole seconds can be told apart."""
    fine = Wave(0.8, 0.0).series(6)
    steps = LagSeries(fine.time_ns, fine.gnss, lambda lag_s: fine.imu(np.ceil(lag_s - 1e-6)))
    found = best_lag([steps])
    assert found.lag_s == pytest.approx(0.55)
    assert found.std_s == pytest.approx(0.9 / np.sqrt(12))


@pytest.mark.parametrize(
    ("series", "reason"),
    [
        ([], "known together in 0 minutes, and 3 are needed"),
        ([Wave(minutes=2).series(0)], "known together in 2 minutes"),
        ([Wave(noise=100.0).series(0)], "is -?0.[01][0-9] at the best, and 0.3 is needed"),
        ([Wave(lag_s=5.0).series(0)], "at the best|agree best at"),
    ],
)
def test_what_does_not_tell_the_lag_is_refused(series: list[LagSeries], reason: str) -> None:
    with pytest.raises(NotApplicable, match=reason):
        best_lag(series)


def test_standstill_and_silence_are_refused() -> None:
    recording = drive(1, 300.0)
    pvt, imu = recording["/gnss0/gnss/pvt"], recording["/imu0/imu"]
    still = pvt.replace(**{f"vel_{axis}_mps": np.zeros(len(pvt)) for axis in "ned"})
    for change in ({"/gnss0/gnss/pvt": still}, {"/imu0/imu": imu.take(slice(0, 1))}):
        for which in SERIES:
            with pytest.raises(NotApplicable, match="the lag cannot be fitted"):
                best_lag(series_of([recording.replace(change)], which))


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(0).normal(size=50)
    without = (values.sum() - values) / 49
    assert jackknife_std(without) == pytest.approx(values.std(ddof=1) / np.sqrt(50))


@given(st.integers(0, 100), st.floats(-1e6, 1e6))
def test_a_trimmed_mean_ignores_outliers(seed: int, outlier: float) -> None:
    values = np.random.default_rng(seed).normal(size=100)
    assert abs(trimmed_mean(np.append(values, [outlier] * 4)) - values.mean()) < 0.2
