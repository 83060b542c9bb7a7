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
"""Alerts less than this apart are one episode, where epochs are not further apart themselves."""

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
    """One attack interval and what the detector's decisions made of it; see :func:`find_events`.

    Attributes:
        interval: the attack.
        alert_before: the last decision before it was an alert.
        detection_ns: time of the first detection within it; None where it was missed.
        persisted_s: how long the alarm of that detection goes on within the attack; None where it
            was missed.
        retrust_s: from the release to the end of the alarm that is on then, 0 where none is; None
            where that end was not seen.
        retrust_censored: whether ``retrust_s`` is None because something else came first: the end
            of the recording, the next attack, or a part that was not reviewed.
    """

    interval: Interval
    alert_before: bool
    detection_ns: int | None
    persisted_s: float | None
    retrust_s: float | None
    retrust_censored: bool

    @property
    def detected(self) -> bool:
        return self.detection_ns is not None

    @property
    def ttfd_s(self) -> float | None:
        """Time to first detection: first alert minus start."""
        at_ns = self.detection_ns
        return None if at_ns is None else (at_ns - self.interval.start_ns) / 1e9


@dataclass(frozen=True, slots=True)
class Harm:
    """What an attack did to the position while the detector did what it did; see :func:`harm`.

    Errors are 3-D, in metres, over the epochs of the grid where they are known; None where they
    are nowhere.

    Attributes:
        alerted_share: alerted share of the epochs of the attack, 0 to 1, where unavailable is not
            alerted; None where no epoch lies within it.
        error_at_detection_m: at the latest epoch at or before the detection; None where missed.
        largest_error_before_alert_m: over the epochs of the attack up to and including the time of
            its detection, or, where none came before it, the error at detection; over the whole
            attack where it was missed.
        largest_error_while_silent_m: over the epochs of the attack without an alert, those after a
            detection included; None where every one is alerted.
        hazard_ns: the first epoch of the attack whose error exceeds the alert limit; None where
            none does.
        hazardous: whether there is one; None where no error is known.
        warned: whether a detection came at most the time to alert after ``hazard_ns``; None where
            the attack is not hazardous.
    """

    alerted_share: float | None
    error_at_detection_m: float | None
    largest_error_before_alert_m: float | None
    largest_error_while_silent_m: float | None
    hazard_ns: int | None
    hazardous: bool | None
    warned: bool | None


def share(part: Bools, whole: Bools) -> float | None:
    """Return the share of the epochs of ``whole`` that are in ``part`` too, 0 to 1."""
    return int((part & whole).sum()) / int(whole.sum()) if whole.any() else None


def separation_ns(epoch_ns: int) -> int:
    """Return the time from which on two alerts are two episodes: 10 s, or 1.5 epochs if longer.

    The grid has an epoch at least every 1.5 nominal intervals: alerts at neighbouring epochs are
    one episode at any rate.
    """
    return max(MIN_SEPARATION_NS, 3 * epoch_ns // 2)


def count_episodes(time_ns: Times, alert: Bools, counted: Bools, epoch_ns: int) -> int:
    """Count the alarm episodes on the epochs that ``counted`` marks.

    Alerts less than :func:`separation_ns` apart are one episode, and an episode counts again for
    every 60 s from its first to its last alert. Both run on the recording's clock: what happens
    at epochs that do not count, such as unavailable ones, is not looked at, and a stretch of them
    that lasts as long as the separation ends an episode.
    """
    on_ns = time_ns[alert & counted]
    if on_ns.size == 0:
        return 0
    begins = np.flatnonzero(np.append(True, np.diff(on_ns) >= separation_ns(epoch_ns)))
    ends = np.append(begins[1:], on_ns.size) - 1
    return int((1 + (on_ns[ends] - on_ns[begins]) // MAX_EPISODE_NS).sum())


def false_alerts(
    time_ns: Times, alert: Bools, counted: Bools, epoch_ns: int, raised: Bools | None = None
) -> FalseAlerts:
    """Return the false alerts on the available clean epochs.

    Args:
        time_ns: epochs, increasing.
        alert: whether the detector alerts at each.
        counted: whether the detector is available and the epoch clean.
        epoch_ns: nominal interval of the grid.
        raised: whether there was an alert at each or since the one before, see
            :func:`alarm_level`. Default: ``alert``.
    """
    hours = int(steps_ns(time_ns, epoch_ns)[counted].sum()) / 3.6e12
    alarm = alert if raised is None else raised
    return false_alert_rate(
        count_episodes(time_ns, alarm, counted, epoch_ns), hours, share(alert, counted)
    )


def steps_ns(time_ns: Times, epoch_ns: int) -> Times:
    """Return the time that each epoch stands for: since the one before, int64 ``(n,)``."""
    return np.diff(time_ns, prepend=time_ns[:1] - epoch_ns)


def alarm_level(time_ns: Times, score: Floats, at_ns: Times, decided: Floats) -> Floats:
    """Return the level of each epoch, ``(n,)``: it has a false alert at a factor below it alone.

    It is the largest of the score that holds at the epoch and of those decided since the epoch
    before, so that whatever may count as a detection counts as a false alert. It is NaN, and the
    epoch unavailable for false alerts, where the detector decided nothing of all that.

    Args:
        time_ns: epochs, ``(n,)``.
        score: that holds at each, NaN where unavailable, ``(n,)``.
        at_ns, decided: times and scores of the decisions, NaN where unavailable, ``(m,)``.
    """
    epoch = np.searchsorted(time_ns, at_ns)
    since = (epoch > 0) & (epoch < time_ns.size)
    level = score.copy()
    np.fmax.at(level, epoch[since], decided[since])
    return level


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
    time_ns: Times,
    alert: Bools,
    intervals: Sequence[Interval],
    *,
    hold_s: float,
    end_ns: int,
    unreviewed_ns: Times,
) -> list[Event]:
    """Find what the detector made of each attack interval, at the times of its own decisions.

    A detection is a rising edge within the interval: an alert after a decision that was none,
    whether it was silent or unavailable, or the first decision of all. An alarm goes on through
    alerts at most ``hold_s`` apart; it ends at the next decision that is no alert, or when its
    last alert is older than ``hold_s``. One that merely ran out has not been taken back: the next
    alert is no rising edge.

    The alarm that is on at the release is that of the last decision before it. It is followed
    until another attack is on, an unreviewed epoch comes, or the recording ends.

    Args:
        time_ns: of the decisions, ``(m,)``.
        alert: whether each is available and above the threshold, ``(m,)``.
        intervals: of the attacks.
        hold_s: how long a decision stands.
        end_ns: of the recording.
        unreviewed_ns: epochs of which it is not known whether they are attacked, ``(k,)``.
    """
    rising = alert & ~np.append(False, alert[:-1])
    hold_ns = round(hold_s * 1e9)
    events = []
    for interval in intervals:
        first, end = np.searchsorted(time_ns, (interval.start_ns, interval.end_ns))
        edges = first + np.flatnonzero(rising[first:end])
        detection_ns = persisted_s = None
        if edges.size:
            detection_ns = int(time_ns[edges[0]])
            off_ns = _alarm_end_ns(time_ns, alert, int(edges[0]), hold_ns)
            alarm_ns = min(off_ns, interval.end_ns) - detection_ns
            persisted_s = alarm_ns / 1e9
        release_ns = interval.end_ns
        off_ns = release_ns
        if end and alert[end - 1]:
            off_ns = max(_alarm_end_ns(time_ns, alert, int(end) - 1, hold_ns), release_ns)
        attacked_ns = [
            max(other.start_ns, release_ns) for other in intervals if other.end_ns > release_ns
        ]
        unknown_ns = unreviewed_ns[unreviewed_ns >= release_ns]
        censored = off_ns > release_ns and off_ns >= min([end_ns, *attacked_ns, *unknown_ns[:1]])
        events.append(
            Event(
                interval=interval,
                alert_before=bool(first > 0 and alert[first - 1]),
                detection_ns=detection_ns,
                persisted_s=persisted_s,
                retrust_s=None if censored else (off_ns - release_ns) / 1e9,
                retrust_censored=censored,
            )
        )
    return events


def _alarm_end_ns(time_ns: Times, alert: Bools, index: int, hold_ns: int) -> int:
    """When the alarm that is on at this decision ends."""
    goes_on = alert[index + 1 :] & (np.diff(time_ns[index:]) <= hold_ns)
    last = index + int(np.argmin(np.append(goes_on, False)))
    runs_out_ns = int(time_ns[last]) + hold_ns
    return min(int(time_ns[last + 1]), runs_out_ns) if last + 1 < time_ns.size else runs_out_ns


def harm(
    event: Event,
    time_ns: Times,
    position_error_m: Floats,
    alert: Bools,
    *,
    alert_limit_m: float,
    time_to_alert_s: float,
) -> Harm:
    """Return what an attack did to the position.

    Args:
        event: what the decisions made of it.
        time_ns, position_error_m, alert: epochs of the grid, ``(n,)``; errors NaN where unknown,
            alerts of the held score.
        alert_limit_m: position error that is hazardous.
        time_to_alert_s: how long after the error exceeds it a detection still warns.
    """
    inside = event.interval.covers(time_ns)
    at_ns = event.detection_ns
    at_m = None if at_ns is None else error_at(time_ns, position_error_m, at_ns)
    before_m = largest_error(
        position_error_m, inside if at_ns is None else inside & (time_ns <= at_ns)
    )
    over = np.flatnonzero(inside & (position_error_m > alert_limit_m))
    known = bool(np.isfinite(position_error_m[inside]).any())
    hazard_ns = int(time_ns[over[0]]) if over.size else None
    return Harm(
        alerted_share=share(alert, inside),
        error_at_detection_m=at_m,
        largest_error_before_alert_m=at_m if before_m is None else before_m,
        largest_error_while_silent_m=largest_error(position_error_m, inside & ~alert),
        hazard_ns=hazard_ns,
        hazardous=over.size > 0 if known else None,
        warned=None
        if hazard_ns is None
        else at_ns is not None and at_ns <= hazard_ns + round(time_to_alert_s * 1e9),
    )


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
