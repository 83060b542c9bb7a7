"""What a detector did: false alerts, detections, events. Pure functions on arrays; None where there
is nothing to measure.

Arrays have shape ``(n,)``, one value per epoch of the scoring grid unless said otherwise. An alert
where the detector is unavailable is none.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Interval
from spoofbench.scoring.statistics import poisson_rate

Times = NDArray[np.int64]
Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]

APART_NS = 10_000_000_000
"""Alerts less than this apart are one episode."""

AGAIN_NS = 60_000_000_000
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
        return (
            None
            if self.detection_ns is None
            else (self.detection_ns - self.interval.start_ns) / 1e9
        )

    @property
    def observed_s(self) -> float:
        """Time to first detection, censored at the attack's length."""
        ttfd_s = self.ttfd_s
        return self.interval.duration_s if ttfd_s is None else ttfd_s


def share(part: Flags, whole: Flags) -> float | None:
    """Return which share of the epochs of ``whole`` are in ``part`` too."""
    return int((part & whole).sum()) / int(whole.sum()) if whole.any() else None


def count_episodes(time_ns: Times, alert: Flags, counted: Flags, epoch_ns: int) -> int:
    """Count alarm episodes on the counted epochs.

    Alerts less than 10 s apart are one episode, and an episode counts again for every 60 s from its
    first to its last alert. Both run on a clock that stands still at epochs that do not count, such
    as unavailable ones: they neither split nor prolong an episode, as they do not add to the hours
    that it is divided by.
    """
    clock_ns = np.cumsum(np.where(counted, _steps_ns(time_ns, epoch_ns), 0))
    on_ns = clock_ns[alert & counted]
    if on_ns.size == 0:
        return 0
    begins = np.flatnonzero(np.append(True, np.diff(on_ns) >= APART_NS))
    ends = np.append(begins[1:], on_ns.size) - 1
    return int((1 + (on_ns[ends] - on_ns[begins]) // AGAIN_NS).sum())


def false_alerts(
    time_ns: Times, alert: Flags, counted: Flags, epoch_ns: int, raised: Flags | None = None
) -> FalseAlerts:
    """Return the false alerts on the available clean epochs, which ``counted`` marks.

    Each epoch stands for the time since the one before it, the first for ``epoch_ns``. ``raised``
    marks epochs since whose predecessor any decision was an alert: what may count as a detection
    counts as a false alert.
    """
    hours = int(_steps_ns(time_ns, epoch_ns)[counted].sum()) / 3.6e12
    alarm = alert if raised is None else alert | raised
    return false_alert_rate(
        count_episodes(time_ns, alarm, counted, epoch_ns), hours, share(alert, counted)
    )


def _steps_ns(time_ns: Times, epoch_ns: int) -> Times:
    """Time since the epoch before, int64 ``(n,)``."""
    return np.diff(time_ns, prepend=time_ns[:1] - epoch_ns)


def raised_since(time_ns: Times, at_ns: Times, alert: Flags) -> Flags:
    """Whether an alert was decided after the epoch before and up to each epoch, bool ``(n,)``.

    Args:
        time_ns: epochs, ``(n,)``.
        at_ns, alert: decisions, ``(m,)``.
    """
    alerts = np.concatenate([[0], np.cumsum(alert)])[np.searchsorted(at_ns, time_ns, "right")]
    raised: Flags = np.diff(alerts, prepend=alerts[:1]) > 0
    return raised


def false_alert_rate(episodes: int, hours: float, epoch: float | None) -> FalseAlerts:
    """Return the false-alert rate of so many episodes in so many available clean hours."""
    rate = poisson_rate(episodes, hours)
    if rate is None:
        return FalseAlerts(episodes, hours, None, None, None, None, epoch)
    return FalseAlerts(episodes, hours, rate.value, rate.lo, rate.hi, 3 / hours, epoch)


def detection_pct(
    alert: Flags, available: Flags, spoofed: Flags
) -> tuple[float | None, float | None]:
    """Return the alerted percentage of all spoofed epochs, and of those at which the detector was
    available.

    In the first, unavailable epochs count as missed (Lo et al. 2017, Table 2).
    """
    return _pct(alert & available, spoofed), _pct(alert, spoofed & available)


def find_events(
    time_ns: Times, alert: Flags, available: Flags, intervals: Sequence[Interval]
) -> list[Event]:
    """Find the first detection of each attack interval.

    The arrays are the detector's decisions at their own times. A detection is a rising edge: where
    an alert is already on when the attack begins, a new one after a decision without alert.
    Unavailable decisions clear nothing.
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
    return (
        None if row < 0 or not np.isfinite(position_error_m[row]) else float(position_error_m[row])
    )


def largest_error(position_error_m: Floats, epochs: Flags) -> float | None:
    """Return the largest known position error over these epochs, such as spoofed ones without
    alert.
    """
    known = position_error_m[epochs & np.isfinite(position_error_m)]
    return float(known.max()) if known.size else None


def _pct(part: Flags, whole: Flags) -> float | None:
    return 100 * int((part & whole).sum()) / int(whole.sum()) if whole.any() else None
