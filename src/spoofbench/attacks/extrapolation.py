"""Attacks that predict the present from what the receiver said a moment ago (Lo et al. 2017)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from spoofbench.arrays import Bools, Floats, Indices
from spoofbench.attacks.pvt import (
    PVT,
    DelayedAttack,
    GeodeticMotion,
    delayed_rows,
    epochs_s,
    interval_s,
    motion_of,
    require_delay,
    rows_within,
    span_with_history,
    with_motion,
    with_rows_of,
)
from spoofbench.recording import Interval, Recording
from spoofbench.table import Table


@dataclass(frozen=True, slots=True)
class Extrapolate(DelayedAttack):
    """Linear extrapolation over the delay d: ``y(t) = y(t-d) + d (y(t-d) - y(t-d-dt)) / dt``.

    The slope is taken over one sample of the delayed series: one 10 Hz sample in Lo et al. (2017;
    inferred from their results), one sample of whatever rate the data have here. Position and
    velocity are extrapolated alike, so that velocity stays the derivative of position and
    acceleration is the extrapolated delayed one. Accuracies and counts are those of the delayed
    row. An epoch without delayed rows is deleted.
    """

    delay_s: float = 2.0

    attack_class: ClassVar[str] = "extrapolation"

    def attackable_span(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        return span_with_history(clean, _history_s(clean, self.delay_s))

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        return _predicted(clean, window, self.delay_s, 0.0)


@dataclass(frozen=True, slots=True)
class ExtrapolateSmooth(Extrapolate):
    """The extrapolation, averaged over the last ``smooth_s`` to tame its noise (Lo et al. 2017; 3
    to 5 s, inferred).

    The mean over the epochs of ``(t - smooth_s, t]`` is taken of position and velocity alike. An
    epoch is deleted where one of these is missing.
    """

    smooth_s: float = 4.0

    def __post_init__(self) -> None:
        DelayedAttack.__post_init__(self)
        if not (np.isfinite(self.smooth_s) and self.smooth_s > 0):
            raise ValueError(f"smooth_s must be finite and above 0, not {self.smooth_s!r}")

    def attackable_span(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        return span_with_history(clean, _history_s(clean, self.delay_s) + self.smooth_s)

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        return _predicted(clean, window, self.delay_s, self.smooth_s)


def _history_s(clean: Recording, delay_s: float) -> float:
    return delay_s + (1.5 * interval_s(clean.primary(PVT)) if clean.topics(PVT) else 0.0)


def _predicted(clean: Recording, window: Interval, delay_s: float, smooth_s: float) -> Recording:
    require_delay(clean, delay_s)
    tables: dict[str, Table | None] = {
        topic: _predicted_table(clean[topic], window, delay_s, smooth_s)
        for topic in clean.topics(PVT)
    }
    return clean.replace(tables)


def _predicted_table(table: Table, window: Interval, delay_s: float, smooth_s: float) -> Table:
    rows = rows_within(table, window)
    if rows.size == 0:
        return table
    samples = max(1, round(smooth_s / interval_s(table)))
    delayed = delayed_rows(table, np.arange(len(table)), delay_s)
    motion, epoch = motion_of(table), epochs_s(table)
    series, exists = _extrapolated(motion, epoch, delayed)
    if smooth_s:
        series, exists = _trailing_mean(series, exists, epoch, samples)
    # a delayed row without a fix makes a row without one; only where a fix cannot be extrapolated
    # is there nothing to say
    replayed = with_rows_of(table, rows, table, np.where(exists[rows], delayed[rows], -1))
    kept = np.concatenate(
        [np.arange(rows[0]), rows[exists[rows]], np.arange(rows[-1] + 1, len(table))]
    )
    inside = np.isin(kept, rows)
    moved = motion_of(replayed)
    moved.position[inside] = series.position[kept[inside]]
    moved.rate[inside] = series.rate[kept[inside]]
    return with_motion(replayed, moved)


def _extrapolated(
    motion: GeodeticMotion, epoch: Floats, delayed: Indices
) -> tuple[GeodeticMotion, Bools]:
    """Return the extrapolation at every row, and where it exists, ``(n,)``.

    Args:
        motion: of all rows.
        epoch: their times, s, ``(n,)``.
        delayed: the row that each extrapolates from, -1 where there is none, ``(n,)``.
    """
    before = delayed - 1
    step = epoch[delayed] - epoch[before]
    known = (before >= 0) & (step > 0)
    ahead = np.where(known, (epoch - epoch[delayed]) / np.where(known, step, 1.0), np.nan)[:, None]
    position, rate = (
        y[delayed] + ahead * (y[delayed] - y[before]) for y in (motion.position, motion.rate)
    )
    extrapolated = GeodeticMotion(position, rate)
    return extrapolated, known & ~_loses_components(motion[delayed], extrapolated)


def _trailing_mean(
    series: GeodeticMotion, exists: Bools, epoch: Floats, samples: int
) -> tuple[GeodeticMotion, Bools]:
    """Return the mean over the last ``samples`` rows, and where it exists, ``(n,)``: where all of
    them do, and there is no gap between them.
    """
    if len(exists) < samples:
        return series, np.zeros_like(exists)
    nominal = float(np.median(np.diff(epoch)))
    whole = sliding_window_view(exists, samples).all(axis=1)
    whole &= epoch[samples - 1 :] - epoch[: epoch.size - samples + 1] < (samples - 0.5) * nominal
    ahead = np.full((samples - 1, 3), np.nan)
    position, rate = (
        np.concatenate([ahead, sliding_window_view(y, samples, axis=0).mean(axis=-1)])
        for y in (series.position, series.rate)
    )
    mean = GeodeticMotion(position, rate)
    exists = np.concatenate([np.zeros(samples - 1, bool), whole])
    return mean, exists & ~_loses_components(series, mean)


def _loses_components(before: GeodeticMotion, after: GeodeticMotion) -> Bools:
    """Return which rows have a component no longer that they had before, ``(n,)``."""
    pairs = ((before.position, after.position), (before.rate, after.rate))
    lost = [np.isfinite(was) & ~np.isfinite(now) for was, now in pairs]
    return np.asarray(np.any(lost, axis=(0, 2)), bool)
