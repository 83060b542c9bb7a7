"""What a detector did: false alerts, detections, events. Pure functions on arrays.

Arrays have shape ``(n,)``, one value per epoch of the scoring grid unless said otherwise; times are
nanoseconds on the recording's clock. Where a detector is unavailable it does not alert. Where there
is nothing to measure, functions return None.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Floats, Times
from spoofbench.recording import Interval
from spoofbench.scoring.statistics import poisson_rate

MIN_SEPARATION_NS = 10_000_000_000
"""Alerts less than this apart are one episode."""

MAX_EPISODE_NS = 60_000_000_000
"""An episode counts again whenever it has lasted this much longer."""


@dataclass(frozen=True, slots=True)
class FalseAlerts:
    """False alerts on clean epochs.

    Attributes:
        episodes: see :func:`count_episodes`.
        hours: time of the available clean epochs.
        per_hour, per_hour_lo, per_hour_hi: episodes per hour and its exact (Garwood) 95 % interval.
        floor_per_hour: 3 / hours, the 95 % upper bound that no episode at all would give ("rule of
            three").
        epoch: alerted share of the available clean epochs.
    """

    episodes: int
    hours: float
    per_hour: float | None
    per_hour_lo: float | None
    per_hour_hi: float | None
    floor_per_hour: float | None
    epoch: float | None


@dataclass(frozen=True, slots=True)
class Event:
    """One attack interval and its first detection.

    Attributes:
        interval: the attack.
        alert_before: an alert was on when it began.
        detection_ns: time of the first detection within it; None where it was missed.
    """

    interval: Interval
    alert_before: bool
    detection_ns: int | None

    @property
    def detected(self) -> bool:
        return self.detection_ns is not None

    @property
    def ttfd_s(self) -> float | None:
        """Time to first detection: first alert minus start."""
        at_ns = self.detection_ns
        return None if at_ns is None else (at_ns - self.interval.start_ns) / 1e9


def share(part: Bools, whole: Bools) -> float | None:
    """Return the share of the epochs of ``whole`` that are in ``part`` too, 0 to 1."""
    return int((part & whole).sum()) / int(whole.sum()) if whole.any() else None


def count_episodes(time_ns: Times, alert: Bools, counted: Bools, epoch_ns: int) -> int:
    """Count the alarm episodes on the epochs that ``counted`` marks.

    Alerts less than 10 s apart are one episode, and an episode counts again for every 60 s from its
    first to its last alert. Both run on a clock that stands still at epochs that do not count, such
    as unavailable ones: they neither split nor prolong an episode, as they do not add to the hours
    that it is divided by.
    """
    clock_ns = np.cumsum(np.where(counted, _steps_ns(time_ns, epoch_ns), 0))
    on_ns = clock_ns[alert & counted]
    if on_ns.size == 0:
        return 0
    begins = np.flatnonzero(np.append(True, np.diff(on_ns) >= MIN_SEPARATION_NS))
    ends = np.append(begins[1:], on_ns.size) - 1
    return int((1 + (on_ns[ends] - on_ns[begins]) // MAX_EPISODE_NS).sum())


def false_alerts(
    time_ns: Times, alert: Bools, counted: Bools, epoch_ns: int, raised: Bools | None = None
) -> FalseAlerts:
    """Return the false alerts on the available clean epochs.

    Each epoch stands for the time since the one before it, the first for ``epoch_ns``.

    Args:
        time_ns: epochs, increasing.
        alert: whether the detector alerts at each.
        counted: whether the detector is available and the epoch clean.
        epoch_ns: nominal interval of the grid.
        raised: whether any decision since the epoch before was an alert: what may count as a
            detection counts as a false alert. Default: ``alert``.
    """
    hours = int(_steps_ns(time_ns, epoch_ns)[counted].sum()) / 3.6e12
    alarm = alert if raised is None else alert | raised
    return false_alert_rate(
        count_episodes(time_ns, alarm, counted, epoch_ns), hours, share(alert, counted)
    )


def _steps_ns(time_ns: Times, epoch_ns: int) -> Times:
    """Time since the epoch before, int64 ``(n,)``."""
    return np.diff(time_ns, prepend=time_ns[:1] - epoch_ns)


def raised_since(time_ns: Times, at_ns: Times, alert: Bools) -> Bools:
    """Whether an alert was decided after the epoch before and up to each epoch, bool ``(n,)``.

    Args:
        time_ns: epochs, ``(n,)``.
        at_ns, alert: decisions, ``(m,)``.
    """
    alerts = np.concatenate([[0], np.cumsum(alert)])[np.searchsorted(at_ns, time_ns, "right")]
    raised: Bools = np.diff(alerts, prepend=alerts[:1]) > 0
    return raised


def false_alert_rate(episodes: int, hours: float, epoch: float | None) -> FalseAlerts:
    """Return the false-alert rate of so many episodes in so many available clean hours.

    ``epoch`` is the alerted share of the epochs, handed on as it is.
    """
    rate = poisson_rate(episodes, hours)
    if rate is None:
        return FalseAlerts(episodes, hours, None, None, None, None, epoch)
    return FalseAlerts(episodes, hours, rate.value, rate.lo, rate.hi, 3 / hours, epoch)


def detection_pct(
    alert: Bools, available: Bools, spoofed: Bools
) -> tuple[float | None, float | None]:
    """Return the alerted percentage of all spoofed epochs and of the available spoofed epochs.

    In the first, unavailable epochs count as missed (Lo et al. 2017, Table 2).
    """
    return _pct(alert & available, spoofed), _pct(alert, spoofed & available)


def find_events(
    time_ns: Times, alert: Bools, available: Bools, intervals: Sequence[Interval]
) -> list[Event]:
    """Find the first detection of each attack interval.

    A detection is a rising edge: where an alert is already on when the attack begins, a new one
    after a decision without alert. Unavailable decisions clear nothing.

    Args:
        time_ns, alert, available: the detector's decisions at their own times, shape ``(m,)``.
        intervals: of the attacks.
    """
    time_ns, alert = time_ns[available], alert[available]
    rising = alert & ~np.append(False, alert[:-1])
    events = []
    for interval in intervals:
        first, end = np.searchsorted(time_ns, (interval.start_ns, interval.end_ns))
        edges = np.flatnonzero(rising[first:end])
        detection_ns = int(time_ns[first + edges[0]]) if edges.size else None
        events.append(Event(interval, bool(first > 0 and alert[first - 1]), detection_ns))
    return events


def error_at(time_ns: Times, position_error_m: Floats, at_ns: int) -> float | None:
    """Return the position error at the latest epoch at or before a time."""
    row = int(np.searchsorted(time_ns, at_ns, "right")) - 1
    known = row >= 0 and np.isfinite(position_error_m[row])
    return float(position_error_m[row]) if known else None


def largest_error(position_error_m: Floats, epochs: Bools) -> float | None:
    """Return the largest known position error over these epochs."""
    known = position_error_m[epochs & np.isfinite(position_error_m)]
    return float(known.max()) if known.size else None


def _pct(part: Bools, whole: Bools) -> float | None:
    return 100 * int((part & whole).sum()) / int(whole.sum()) if whole.any() else None
