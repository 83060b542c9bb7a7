"""The figures of one detector at one operating point, from its rows of the tables of scores and
events.

Sessions are the unit of every interval: what is known of one session counts once, however many
windows it has.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.scoring.statistics import (
    Estimate,
    SurvivalCurve,
    rate_interval,
    session_means,
    share_interval,
    survival_curve,
    too_few_episodes,
)


@dataclass(frozen=True, slots=True)
class Figures:
    """What a detector does at one operating point; unknown is None.

    False alerts are counted on unattacked recordings (and on what was reviewed and found clean of
    really attacked ones), detections on the support. ``lo`` and ``hi`` are ends of 95 % intervals
    over sessions; None between 2 and 4 sessions, and for shares below 5.

    Attributes:
        episodes, clean_h, clean_sessions: alarm episodes, and the available hours and the sessions
            in which they were counted.
        far_per_hour: episodes per available clean hour.
        far_floor_per_hour: the lowest rate that so many hours can resolve, 3/T.
        has_few_episodes: fewer than 5 episodes per session, so that the interval says little.
        alarm_share: share of the available clean time in alarm, 0 to 1.
        availability: available share of the clean epochs, 0 to 1.
        detected, attacks: attack intervals with a rising edge within them, of how many.
        detected_share: the mean over sessions.
        placebo_detected, placebo_attacks: the same windows on the unattacked recordings; None and 0
            where there are none, as for real attacks.
        detection_pct: alerted percentage of all spoofed epochs; unavailable ones count as missed.
        placebo_pct: the same epochs of the unattacked recordings.
        restricted_mean_ttfd_s: mean time to first detection up to the longest attack, a miss
            censored.
        ttfd_median_s, ttfd_p90_s: Kaplan-Meier; None where fewer than that share are ever detected.
        longest_attack_s: length of the longest attack.
        error_before_alert_median_m, error_before_alert_p95_m, error_before_alert_largest_m:
            largest position error up to the first alert, or over the whole attack where it was
            missed, over the attacks of which errors are known.
        persisted_median_s: how long the alarm of a first detection goes on within the attack.
        retrust_median_s: from the release to the end of the alarm, over attacks whose alarm was on
            at the release; Kaplan-Meier, one whose end was not seen censored out.
        warned, hazardous: of the attacks whose error exceeds the suite's alert limit, those that
            are detected in time, and all of them; 0 and 0 where the suite has no limit.
    """

    episodes: int
    clean_h: float
    clean_sessions: int
    far_per_hour: float | None
    far_per_hour_lo: float | None
    far_per_hour_hi: float | None
    far_floor_per_hour: float | None
    has_few_episodes: bool
    alarm_share: float | None
    availability: float | None
    detected: int
    attacks: int
    detected_share: float | None
    detected_share_lo: float | None
    detected_share_hi: float | None
    placebo_detected: int | None
    placebo_attacks: int
    detection_pct: float | None
    detection_pct_lo: float | None
    detection_pct_hi: float | None
    placebo_pct: float | None
    restricted_mean_ttfd_s: float | None
    ttfd_median_s: float | None
    ttfd_p90_s: float | None
    longest_attack_s: float | None
    error_before_alert_median_m: float | None
    error_before_alert_p95_m: float | None
    error_before_alert_largest_m: float | None
    persisted_median_s: float | None
    retrust_median_s: float | None
    warned: int
    hazardous: int


Columns = Mapping[str, Any]
"""Columns of a table by name, ``(n,)``: numbers and flags as float64, NaN where unknown, and
``session`` as codes.
"""


def figures(clean: Columns, faced: Columns) -> Figures:
    """Return the figures of one detector at one operating point.

    Args:
        clean: its scores on recordings that have false-alert rates, as ``scores.parquet``, columns
            ``(n,)``.
        faced: an attack interval of the support per row, as ``events.parquet``, columns ``(m,)``;
            NaN where the detector has no result, which is a miss.
    """
    hits: Bools = faced["detected"] == 1
    length_s = faced["length_s"]
    observed_s = np.asarray(np.where(hits, faced["ttfd_s"], length_s), np.float64)
    curve = survival_curve(observed_s, hits)
    longest_s = float(length_s.max()) if length_s.size else None
    share = _over_sessions(np.where(hits, 1.0, 0.0), faced)
    detection = _over_sessions(100 * np.nan_to_num(faced["alerted_share"]), faced, 100.0)
    placebo = _known(faced["placebo_detected"])
    error_m = _known(faced["largest_error_before_alert_m"])
    return Figures(
        **_false_alerts(clean),
        detected=int(hits.sum()),
        attacks=hits.size,
        detected_share=_value(share),
        detected_share_lo=_lo(share),
        detected_share_hi=_hi(share),
        placebo_detected=int(placebo.sum()) if placebo.size else None,
        placebo_attacks=placebo.size,
        detection_pct=_value(detection),
        detection_pct_lo=_lo(detection),
        detection_pct_hi=_hi(detection),
        placebo_pct=_mean(100 * _known(faced["placebo_share"])),
        restricted_mean_ttfd_s=curve.restricted_mean_s(longest_s)
        if curve is not None and longest_s is not None
        else None,
        ttfd_median_s=_quantile(curve, 0.5),
        ttfd_p90_s=_quantile(curve, 0.9),
        longest_attack_s=longest_s,
        error_before_alert_median_m=float(np.median(error_m)) if error_m.size else None,
        error_before_alert_p95_m=float(np.quantile(error_m, 0.95)) if error_m.size else None,
        error_before_alert_largest_m=float(error_m.max()) if error_m.size else None,
        persisted_median_s=_median(_known(faced["persisted_s"])),
        retrust_median_s=_retrust_median_s(faced),
        warned=int(_known(faced["warned"]).sum()),
        hazardous=int(_known(faced["hazardous"]).sum()),
    )


def _false_alerts(clean: Columns) -> dict[str, Any]:
    hours_h = np.nan_to_num(clean["available_clean_h"])
    counted = hours_h > 0
    names, session = np.unique(clean["session"][counted], return_inverse=True)
    episodes, hours = (
        np.bincount(session, values[counted], names.size) for values in (clean["episodes"], hours_h)
    )
    rate = rate_interval(episodes, hours)
    total_h = float(hours.sum())
    return {
        "episodes": int(episodes.sum()),
        "clean_h": total_h,
        "clean_sessions": names.size,
        "far_per_hour": float(episodes.sum()) / total_h if total_h else None,
        "far_per_hour_lo": _lo(rate),
        "far_per_hour_hi": _hi(rate),
        "far_floor_per_hour": 3 / total_h if total_h else None,
        "has_few_episodes": rate is not None and too_few_episodes(episodes, hours),
        "alarm_share": _weighted(clean["far_epoch"], hours_h),
        "availability": _weighted(clean["availability"], clean["epochs"]),
    }


def _over_sessions(values: Floats, faced: Columns, largest: float = 1.0) -> Estimate | None:
    """The mean over sessions of their own means, with its interval where there are enough."""
    if not values.size:
        return None
    sessions = faced["session"]
    means = session_means(values, sessions, np.unique(sessions))
    return share_interval(means, largest) or Estimate(float(means.mean()), np.nan, np.nan)


def _retrust_median_s(faced: Columns) -> float | None:
    """The median over alarms that are on at the release; one whose end was not seen is censored."""
    ended, censored = faced["retrust_s"] > 0, faced["retrust_censored"] == 1
    if not (ended | censored).any():
        return None
    longest_s = faced["retrust_s"][ended].max(initial=0.0)
    time_s = np.where(ended, faced["retrust_s"], longest_s)[ended | censored]
    return _quantile(survival_curve(time_s, ended[ended | censored]), 0.5)


def _quantile(curve: SurvivalCurve | None, share: float) -> float | None:
    return None if curve is None else curve.quantile_s(share)


def _known(values: Floats) -> Floats:
    return values[~np.isnan(values)]


def _median(values: Floats) -> float | None:
    return float(np.median(values)) if values.size else None


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if values.size else None


def _weighted(values: Floats, weights: Floats) -> float | None:
    known = ~np.isnan(values) & ~np.isnan(weights)
    total = float(weights[known].sum())
    return float(values[known] @ weights[known]) / total if total else None


def _value(estimate: Estimate | None) -> float | None:
    return None if estimate is None else estimate.value


def _lo(estimate: Estimate | None) -> float | None:
    return None if estimate is None or np.isnan(estimate.lo) else estimate.lo


def _hi(estimate: Estimate | None) -> float | None:
    return None if estimate is None or np.isnan(estimate.hi) else estimate.hi
