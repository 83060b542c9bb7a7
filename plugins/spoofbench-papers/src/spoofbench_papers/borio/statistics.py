"""Borio's statistics on each session: genuine, replayed and meaconed, and what decides them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from spoofbench_correlation import windows
from spoofbench_correlation.correlation import Correlation
from spoofbench_correlation.series import acceleration, receiver_velocity
from spoofbench_correlation.zero_velocity import ZeroVelocity

from spoofbench.arrays import Floats, Indices
from spoofbench.attacks.contract import Attack, attackable_span, make_variant
from spoofbench.attacks.replay import Meacon, Replay
from spoofbench.detector import detect
from spoofbench.errors import NotApplicable
from spoofbench.navigation.imu import RATE
from spoofbench.recording import Interval, Recording
from spoofbench_papers.borio.recordings import EPOCH_S, FieldSession

Row = dict[str, Any]

FOUR = ("M_acc", "M_ag", "H_acc", "H_ag")
STATISTICS = (*FOUR, "M", "H")
DELAYS_S = (1, 2, 3, 5, 10, 60, 300)
THRESHOLD = 0.7  # the paper's, for its best IMU
FALSE_ALERTS = 0.01  # share of genuine epochs below a fitted threshold
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "low-pass": {},
    "constant": {"gravity": "constant"},
    "descent": {"gravity": "descent"},
    "median 3": {"median_filter": 3},
    "median 5": {"median_filter": 5},
    "median 7": {"median_filter": 7},
    "adaptive": {"adaptive": True},
}
GYRO_NOISES_RADPS = (0.0, 0.02, 0.05, 0.1, 0.2)  # of the means over an epoch
OTHER_VEHICLES = {"drive": "rtk-drive"}
"""Donors where no recording shares the group; for the others it is the drive."""
MOVING_MPS = 5.0
QUINTILES = 5
DRAWS, MIN_BLOCKS = 1000, 5


class Series(NamedTuple):
    """Available values of a statistic, shapes ``(n,)``: seconds since the session's first epoch,
    and coefficients in [-1, 1].
    """

    time_s: Floats
    value: Floats


Values = Mapping[tuple[str, str, str], Series]
"""By session, case and statistic."""


def series_of(recording: Recording, statistic: str, window_s: float, **parameters: Any) -> Series:
    """Return a statistic's values where it is available."""
    detector = Correlation(**{"statistic": statistic, "window_s": window_s, **parameters})
    decisions = detect(detector, recording)
    time_s = (
        decisions.time_ns[decisions.available] - recording.primary("gnss/pvt").time_ns[0]
    ) / 1e9
    return Series(time_s, 1 - decisions.score[decisions.available] * (1 - detector.threshold))


def outcomes(
    session: FieldSession, all_sessions: Sequence[FieldSession]
) -> Iterator[tuple[str, Recording | str]]:
    """Yield the genuine recording and its falsified stretches, each under attack from end to end,
    or why there is none.

    A replay is the receiver's own past; meaconing takes another recording of the group, or where
    there is none another vehicle's.
    """
    yield "genuine", session.recording
    for delay_s in DELAYS_S:
        yield f"replay-{delay_s}s", _attacked("replay", Replay(float(delay_s)), session, ())
    group = [
        other
        for other in all_sessions
        if other.log.group == session.log.group and other is not session
    ]
    wanted = OTHER_VEHICLES.get(session.name, "drive")
    for donor in group or [other for other in all_sessions if other.name == wanted]:
        yield f"meacon-{donor.name}", _attacked("meacon", Meacon(), session, (donor.recording,))


def cases(
    session: FieldSession, all_sessions: Sequence[FieldSession]
) -> Iterator[tuple[str, Recording]]:
    """Yield the outcomes that are recordings."""
    for case, outcome in outcomes(session, all_sessions):
        if isinstance(outcome, Recording):
            yield case, outcome


def _attacked(
    name: str, attack: Attack, session: FieldSession, donors: Sequence[Recording]
) -> Recording | str:
    clean = session.recording
    try:
        window = attackable_span(attack, clean, donors)
        if donors:
            epochs = donors[0].primary("gnss/pvt").time_ns
            start_ns = int(clean.primary("gnss/pvt").time_ns[0])
            window = Interval(
                start_ns, min(window.end_ns, start_ns + int(epochs[-1] - epochs[0]) + 1)
            )
        if window.duration_s < 2 * session.window_s:
            return (
                f"{window.duration_s:.0f} s can be attacked, less than two windows of "
                f"{session.window_s:g} s"
            )
        return make_variant(name, attack, clean, window, 0, donors).between(
            window.start_ns, window.end_ns
        )
    except NotApplicable as error:
        return str(error)


def all_values(
    sessions: Sequence[FieldSession], progress: Callable[[float], None]
) -> tuple[dict[tuple[str, str, str], Series], list[Row]]:
    """Return the values of each statistic for each session with an IMU and each case, and per case
    null or why it could not be made.
    """
    found: dict[tuple[str, str, str], Series] = {}
    rows = []
    for number, session in enumerate(sessions):
        progress(number / len(sessions))
        if session.inertial:
            for case, outcome in outcomes(session, sessions):
                rows.append(
                    {
                        "recording": session.name,
                        "case": case,
                        "left_out": outcome if isinstance(outcome, str) else None,
                    }
                )
                if isinstance(outcome, Recording):
                    for statistic in STATISTICS:
                        found[session.name, case, statistic] = series_of(
                            outcome, statistic, session.window_s
                        )
    return found, rows


def bootstrap(
    series: Series, window_s: float, measure: Callable[[Floats], float]
) -> tuple[float | None, float | None]:
    """Return the 95 % interval of a measure over resampled blocks of one window each; None of fewer
    than five blocks.

    Windows that overlap share their pairs: an epoch is no sample of its own.

    Args:
        series: of ``n`` values.
        window_s: length of a block.
        measure: from values of any number, shape ``(m,)``, to a scalar.
    """
    block = np.floor(series.time_s / window_s)
    blocks = [series.value[block == number] for number in np.unique(block)]
    if len(blocks) < MIN_BLOCKS:
        return None, None
    rng = np.random.default_rng(0)
    drawn = [
        measure(np.concatenate([blocks[k] for k in rng.integers(len(blocks), size=len(blocks))]))
        for _ in range(DRAWS)
    ]
    low, high = np.percentile(drawn, [2.5, 97.5]).tolist()
    return low, high


def below(limit: float) -> Callable[[Floats], float]:
    """Return the measure that gives the share of values, ``(m,)``, below a limit."""
    return lambda values: float((values < limit).mean())


def summaries(values: Values, sessions: Mapping[str, FieldSession]) -> list[Row]:
    """Return the distribution of each statistic by session and case; null where it is never
    available.
    """
    rows = []
    for (name, case, statistic), series in values.items():
        known = series.value.size > 0
        quantiles = np.percentile(series.value, [5, 50, 95, 99]).tolist() if known else [None] * 4
        shares = {
            f"share_below_{str(limit).replace('.', '_')}": below(limit)(series.value)
            if known
            else None
            for limit in (0.6, 0.7, 0.8)
        }
        rows.append(
            {
                "recording": name,
                "statistic": statistic,
                "case": case,
                "window_s": sessions[name].window_s,
                "epochs": series.value.size,
            }
            | dict(zip(("p05", "median", "p95", "p99"), quantiles, strict=True))
            | shares
        )
    return rows


def unrelated(values: Values, name: str) -> list[str]:
    """Return the cases of a session in which GNSS is of another time or run: meaconing, and replays
    by a minute or more.
    """
    return sorted(
        {
            case
            for who, case, _ in values
            if who == name and (case.startswith("meacon") or case in ("replay-60s", "replay-300s"))
        }
    )


def transfer(values: Values) -> list[Row]:
    """Return, for a threshold fitted to one session's genuine values, the alerts in each session;
    null where unavailable.
    """
    names = list(dict.fromkeys(name for name, _, _ in values))
    rows = []
    for fitted_on in names:
        for statistic in STATISTICS:
            genuine = values[fitted_on, "genuine", statistic].value
            if not genuine.size:
                continue
            threshold = float(np.quantile(genuine, FALSE_ALERTS))
            for name in names:
                false = values[name, "genuine", statistic].value
                pooled = [values[name, case, statistic].value for case in unrelated(values, name)]
                attacked = np.concatenate(pooled) if pooled else np.empty(0)
                rows.append(
                    {
                        "fitted_on": fitted_on,
                        "applied_to": name,
                        "statistic": statistic,
                        "threshold": threshold,
                        "false_alert_share": below(threshold)(false) if false.size else None,
                        "detection_share": below(threshold)(attacked) if attacked.size else None,
                    }
                )
    return rows


def settings(sessions: Sequence[FieldSession]) -> list[Row]:
    """Return genuine medians for other ways to estimate gravity, to filter, to weigh, and with the
    lag not taken out.
    """
    rows = []
    for session in sessions:
        if not session.inertial:
            continue
        variants = [(name, session.recording, parameters) for name, parameters in SETTINGS.items()]
        variants.append(("lag not taken out", moved(session.recording, -session.lag_s), {}))
        for name, recording, parameters in variants:
            for statistic in STATISTICS:
                value = series_of(recording, statistic, session.window_s, **parameters).value
                median = float(np.median(value)) if value.size else None
                rows.append(
                    {
                        "recording": session.name,
                        "setting": name,
                        "statistic": statistic,
                        "median": median,
                    }
                )
    return rows


def moved(recording: Recording, by_s: float) -> Recording:
    """Return the recording with its IMU's times moved."""
    topic = recording.topics("imu")[0]
    imu = recording[topic]
    columns = {name: imu.column(name) for name in imu}
    return recording.replace({topic: type(imu)("imu", imu.time_ns + round(by_s * 1e9), columns)})


def noisy_gyro(session: FieldSession) -> list[Row]:
    """Return H_ag, and H with fixed and adaptive weights, with white noise added to the gyroscope,
    genuine and replayed by 300 s.
    """
    rng = np.random.default_rng(0)
    recordings = dict(case for case in cases(session, ()) if case[0] in ("genuine", "replay-300s"))
    topic = session.recording.topics("imu")[0]
    rows = []
    for noise in GYRO_NOISES_RADPS:
        for case, recording in recordings.items():
            imu = recording[topic]
            per_epoch = EPOCH_S * (len(imu) - 1) / ((imu.time_ns[-1] - imu.time_ns[0]) / 1e9)
            noisy = imu.replace(
                **{
                    name: imu[name] + rng.normal(0, noise * np.sqrt(per_epoch), len(imu))
                    for name in RATE
                }
            )
            for statistic, adaptive in (("H_ag", False), ("H", False), ("H", True)):
                value = series_of(
                    recording.replace({topic: noisy}),
                    statistic,
                    session.window_s,
                    adaptive=adaptive,
                ).value
                low, median, high = np.percentile(value, [5, 50, 95]).tolist()
                row = {
                    "gyro_noise_radps": noise,
                    "case": case,
                    "statistic": statistic,
                    "adaptive": adaptive,
                }
                rows.append(row | {"p05": low, "median": median, "p95": high})
    return rows


def dynamics(sessions: Sequence[FieldSession], values: Values) -> list[Row]:
    """Return the median of each genuine statistic by quintile of the window's dynamics, over
    windows that move on average.

    Dynamics is the root mean square of the horizontal acceleration that GNSS claims.
    """
    rows = []
    for session in sessions:
        if not session.inertial:
            continue
        time_s, rms, speed, _ = window_motion(session)
        for statistic in FOUR:
            series = values[session.name, "genuine", statistic]
            at = np.searchsorted(time_s, series.time_s)
            moving = (speed[at] >= MOVING_MPS) & ~np.isnan(rms[at])
            if moving.sum() < QUINTILES:
                continue
            level, value = rms[at][moving], series.value[moving]
            quintile = np.searchsorted(
                np.quantile(level, np.arange(1, QUINTILES) / QUINTILES), level, "right"
            )
            for number in range(QUINTILES):
                chosen = quintile == number
                if chosen.any():
                    row = {
                        "recording": session.name,
                        "statistic": statistic,
                        "quintile": number + 1,
                    }
                    rows.append(
                        row
                        | {
                            "acceleration_mps2": float(level[chosen].mean()),
                            "median": float(np.median(value[chosen])),
                        }
                    )
    return rows


def window_motion(session: FieldSession) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the motion over the window that each pair of epochs ends, from ``n`` epochs.

    Returns:
        Four arrays of shape ``(n - 1,)``: seconds since the first epoch, rms horizontal
        acceleration (m/s^2), mean speed (m/s), and share of pairs with a slow end.
    """
    velocity = receiver_velocity(session.recording.primary("gnss/pvt"))
    start_ns, end_ns = velocity.time_ns[:-1], velocity.time_ns[1:]
    first = windows.first_of_window(start_ns, end_ns, session.window_s)
    squared = (acceleration(velocity)[:2] ** 2).sum(axis=0)
    speed = velocity.speed_mps[1:]
    slow = np.where(np.isnan(speed), np.nan, speed < ZeroVelocity.speed_mps)
    rms = np.sqrt(_trailing_mean(squared, first))
    return (
        (end_ns - velocity.time_ns[0]) / 1e9,
        rms,
        _trailing_mean(speed, first),
        _trailing_mean(slow, first),
    )


def _trailing_mean(values: Floats, first: Indices) -> Floats:
    known = ~np.isnan(values)
    total, count = (
        np.concatenate(([0.0], np.cumsum(column)))
        for column in (np.where(known, values, 0.0), known)
    )
    counted = count[1:] - count[first]
    mean: Floats = np.divide(
        total[1:] - total[first], counted, out=np.full(values.size, np.nan), where=counted > 0
    )
    return mean
