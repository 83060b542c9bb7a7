"""What Borio prints or says of his figures, beside ours."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spoofbench.reproducing import Cell, Verdict
from spoofbench_correlation.borio_recordings import WINDOWS_S, Session
from spoofbench_correlation.borio_statistics import (
    FALSE_ALERTS,
    FOUR,
    QUINTILES,
    THRESHOLD,
    Row,
    Series,
    Values,
    below,
    bootstrap,
    parked,
    unrelated,
)

SPORADIC = 0.05
PHONES = ("iphone-2", "iphone-3", "iphone-5")
LAG = "another car than the paper's, with its receiver's lag of 0.34 s taken out"
# What the project wants of the drive, from its notes on the paper's ambiguities.
MEDIANS = {"M_acc": (0.91, 0.03), "M_ag": (0.985, 0.01), "H_acc": (0.91, 0.03), "H_ag": (0.99, 0.01)}


@dataclass(frozen=True, slots=True)
class Findings:
    """Sessions by name, the values of each statistic, and the tables that are written."""

    sessions: Mapping[str, Session]
    values: Values
    tables: Mapping[str, Sequence[Row]]

    def row(self, table: str, **wanted: Any) -> Row:
        """Return the one row of a table that has these values."""
        return next(row for row in self.tables[table] if all(row[key] == value for key, value in wanted.items()))

    @property
    def long(self) -> list[str]:
        """Sessions whose window is the paper's."""
        return [name for name, session in self.sessions.items() if session.inertial and session.window_s == WINDOWS_S[0]]

    def pooled(self, names: Sequence[str], statistic: str) -> Any:
        """Values of a statistic in all cases of the sessions in which GNSS is of another time or run."""
        return np.concatenate([self.values[name, case, statistic].value for name in names for case in unrelated(self.values, name)])


def cells(findings: Findings) -> list[Cell]:
    """Return each statement of the paper that can be asked of the recordings, then what the project wants of the drive."""
    found: list[Cell] = []
    if "drive" in findings.sessions:
        found += [*_genuine(findings), *_spoofed(findings), *_threshold(findings)]
    found += [*_steady(findings), *_phones(findings)]
    if "drive" in findings.sessions:
        found += [*_standstill(findings), *_refined(findings), *_wanted(findings)]
    return found


def _genuine(findings: Findings) -> Iterator[Cell]:
    window_s = findings.sessions["drive"].window_s
    series = {statistic: findings.values["drive", "genuine", statistic] for statistic in FOUR}
    for statistic in FOUR:
        share = [1 - value if value is not None else None for value in bootstrap(series[statistic], window_s, below(0.8))]
        low, high = share[1], share[0]
        holds = low is not None and low > 0.5
        yield Cell(
            f"text to Fig 8: share of the time with {statistic} above 0.8", "most", 1 - below(0.8)(series[statistic].value), low, high,
            "matches after calibration" if holds else "not reproduced", LAG,
        )  # fmt: skip
    for kind in "MH":
        rate, force = _together(series[f"{kind}_ag"], series[f"{kind}_acc"])
        yield _share(
            f"text to Fig 8: {kind}_ag is above {kind}_acc", Series(rate.time_s, (rate.value > force.value).astype(float)), window_s,
            "share of the epochs; on this car too the gyroscope is the better sensor",
        )  # fmt: skip
    norm, level = _together(series["M_acc"], series["H_acc"])
    gap = float(np.median(np.abs(norm.value - level.value)))
    yield Cell(
        "text to Fig 8: M_acc and H_acc are very close", "very close", gap, None, None, "trend only" if gap < 0.02 else "not reproduced",
        f"median of their absolute difference; 95 % of the epochs within {np.percentile(np.abs(norm.value - level.value), 95):.3f}",
    )  # fmt: skip
    still = parked(findings.sessions["drive"], series["M_acc"])
    if still.any():
        low, high = (float(np.median(series["M_acc"].value[which])) for which in (still, ~still))
        yield Cell(
            "text to Fig 8: the statistics are lower while the vehicle is static", "lower", low, None, None,
            "trend only" if low < high else "not reproduced",
            f"median M_acc of windows that stand still for four fifths, {high:.2f} of the others; M_ag and H_ag are unavailable there",
        )  # fmt: skip


def _spoofed(findings: Findings) -> Iterator[Cell]:
    runs = [
        (name, case)
        for name, case, statistic in findings.values
        if case.startswith("meacon") and statistic == "H" and name in findings.long
    ]
    route = [(n, c) for n, c in runs if findings.sessions[c.removeprefix("meacon-")].log.route == findings.sessions[n].log.route]
    for words, pairs in (("another run of the same route", route), ("the drive's own past, 60 s and 300 s before", _past(findings))):
        if not pairs:
            continue
        values = np.concatenate([findings.values[name, case, statistic].value for name, case in pairs for statistic in FOUR])
        share = below(0.6)(values)
        yield Cell(
            f"text to Figs 9 and 12: values below 0.6 with sporadic exceptions, GNSS of {words}", "all but sporadic", share, None, None,
            "matches" if share >= 1 - SPORADIC else "not reproduced",
            f"share of the values of the four statistics, {len(pairs)} pairs; the highest value is {values.max():.2f}",
        )  # fmt: skip
    both = [
        min(float(force.value[k]), float(rate.value[k]))
        for name in findings.long
        for case in unrelated(findings.values, name)
        for kind in "MH"
        for force, rate in [_together(findings.values[name, case, f"{kind}_acc"], findings.values[name, case, f"{kind}_ag"])]
        for k in range(force.value.size)
    ]
    yield Cell(
        "text to Fig 9: high values of acceleration and of angular rate do not coincide", "not observed",
        float((np.array(both) > 0.6).mean()), None, None, "matches" if max(both) <= 0.6 else "not reproduced",
        f"share of epochs with both above 0.6, MAV and HoC, over all recordings of 120 s windows; the highest pair is above {max(both):.2f}",
    )  # fmt: skip


def _past(findings: Findings) -> list[tuple[str, str]]:
    return [("drive", case) for case in unrelated(findings.values, "drive") if case.startswith("replay")]


def _threshold(findings: Findings) -> Iterator[Cell]:
    genuine = findings.values["drive", "genuine", "H"]
    false, detected = below(THRESHOLD)(genuine.value), below(THRESHOLD)(findings.pooled(["drive"], "H"))
    low, high = bootstrap(genuine, findings.sessions["drive"].window_s, below(THRESHOLD))
    yield Cell(
        "text to Fig 9: a threshold of about 0.7 tells normal from spoofed (good IMU)", 0.7, false, low, high,
        "matches after calibration" if false < SPORADIC and detected > 1 - SPORADIC else "not reproduced",
        f"share of genuine epochs with H below 0.7; {100 * detected:.1f} % of the epochs with GNSS of another time or run are; {LAG}",
    )  # fmt: skip
    others = [name for name in findings.long if name != "drive"]
    if not others:
        return
    shares = {name: below(THRESHOLD)(findings.values[name, "genuine", "H"].value) for name in others}
    worst = max(shares, key=lambda name: shares[name])
    yield Cell(
        "text to Fig 9: the threshold depends on the IMU", None, f"{100 * min(shares.values()):.0f} to {100 * shares[worst]:.0f} %", None, None,
        "trend only" if shares[worst] > SPORADIC else "not reproduced",
        f"genuine epochs with H below 0.7 on {len(others)} other recordings, most on {worst}: 0.7 does not transfer",
    )  # fmt: skip
    fitted = {row["fitted_on"]: row["threshold"] for row in findings.tables["transfer"] if row["statistic"] == "H"}
    yield Cell(
        f"the same: thresholds on H that {100 * FALSE_ALERTS:g} % of genuine epochs fall below", None,
        f"{min(fitted[n] for n in findings.long):.2f} to {max(fitted[n] for n in findings.long):.2f}", None, None, "trend only",
        "the least and the greatest over the recordings of 120 s windows; transfer.parquet has all pairs",
    )  # fmt: skip


def _steady(findings: Findings) -> Iterator[Cell]:
    """Section IV-B: steady cruise, on the recording that is mostly motorway."""
    if "phone-car" not in findings.sessions:
        return
    fall = {}
    for statistic in FOUR:
        calm, lively = (
            findings.row("dynamics", recording="phone-car", statistic=statistic, quintile=number)["median"] for number in (1, QUINTILES)
        )
        fall[statistic] = lively - calm
    words = ", ".join(f"{statistic} {value:.2f}" for statistic, value in fall.items())
    reason = f"phone-car, a motorway: fall of the median from the liveliest fifth of the windows to the calmest: {words}"
    for item, value, holds in (
        ("statistics fall where the driver keeps speed and lane", min(fall.values()), min(fall.values()) > 0),
        ("M_ag is the most affected", fall["M_ag"], fall["M_ag"] == max(fall.values())),
        ("H_ag is the least affected", fall["H_ag"], fall["H_ag"] == min(fall.values())),
    ):
        yield Cell(f"text to Fig 11: {item}", None, value, None, None, "trend only" if holds else "not reproduced", reason)


def _phones(findings: Findings) -> Iterator[Cell]:
    if "phone-car" in findings.sessions:
        own = findings.row("transfer", fitted_on="phone-car", applied_to="phone-car", statistic="H")
        yield Cell(
            "text to Fig 13: a phone's IMU can verify GNSS", None, own["detection_share"], None, None,
            "trend only" if own["detection_share"] > 0.9 else "not reproduced",
            f"share of epochs with GNSS of another time or run that a threshold on H finds which 1 % of this phone's genuine ones fall below "
            f"({own['threshold']:.2f}); fitted and judged on one recording, so at best",
        )  # fmt: skip
    poor = [name for name in PHONES if name in findings.sessions]
    if poor:
        medians = {n: [float(np.median(findings.values[n, "genuine", s].value)) for s in ("H_acc", "H_ag")] for n in poor}
        holds = all(force > rate for force, rate in medians.values())
        words = ", ".join(f"{name} {force:.2f} and {rate:.2f}" for name, (force, rate) in medians.items())
        yield Cell(
            "text to Fig 14: a low-end phone: acceleration shows the trend, angular rate is of no use", None,
            max(rate for _, rate in medians.values()), None, None, "trend only" if holds else "not reproduced",
            f"the greatest median H_ag; medians of H_acc and H_ag: {words}. The cause is another: an IMU decimated to 5 Hz, courses of positions",
        )  # fmt: skip


def _standstill(findings: Findings) -> Iterator[Cell]:
    genuine, replayed = (findings.row("contradictions", recording="drive", case=case, kind="either") for case in ("genuine", "replay-300s"))
    yield Cell(
        "Section V-A: GNSS and IMU record the same static periods", "the same", genuine["per_min"], None, None,
        "trend only" if 5 * genuine["per_min"] < replayed["per_min"] else "not reproduced",
        f"contradicted seconds per minute on the drive, {replayed['per_min']:.1f} when replayed by 300 s; the detector's thresholds are ours",
    )  # fmt: skip
    rates = {
        row["recording"]: row["per_min"]
        for row in findings.tables["contradictions"]
        if row["case"] == "genuine" and row["kind"] == "either" and row["recording"] in findings.long and row["per_min"] is not None
    }
    if len(rates) > 1:
        good = [name for name, rate in rates.items() if rate < 5]
        yield Cell(
            "Section V-A: the same, on other recordings", "the same", f"{len(good)} of {len(rates)}", None, None,
            "trend only" if len(good) == len(rates) else "not reproduced",
            "recordings with less than 5 contradicted seconds per minute: " + ", ".join(f"{n} {r:.1f}" for n, r in rates.items())
            + ". Ours are thresholds for the drive's IMU: elsewhere engines and 5 Hz samples keep a parked car moving",
        )  # fmt: skip


def _refined(findings: Findings) -> Iterator[Cell]:
    medians: dict[tuple[str, str, str], float] = {
        (row["recording"], row["setting"], row["statistic"]): row["median"]
        for row in findings.tables["settings"]
        if row["median"] is not None
    }
    names = [name for name in findings.long if (name, "low-pass", "H") in medians]

    def compared(item: str, statistic: str, setting: str, other: str, reason: str) -> Cell:
        pairs = {
            n: (medians[n, other, statistic], medians[n, setting, statistic])
            for n in names
            if (n, setting, statistic) in medians and (n, other, statistic) in medians
        }
        better = sum(new > old for old, new in pairs.values())
        words = ", ".join(f"{name} {old:.3f} to {new:.3f}" for name, (old, new) in pairs.items())
        return Cell(
            item, None, f"{better} of {len(pairs)}", None, None, "trend only" if 2 * better > len(pairs) else "not reproduced",
            f"{reason}; medians of {statistic}: {words}",
        )  # fmt: skip

    yield compared(
        "Section V-B: a median filter removes outliers", "H_acc", "median 3", "low-pass", "recordings whose genuine H_acc gains by length 3"
    )
    yield compared(
        "Section V-B: an excessive length removes features", "H", "median 3", "median 7", "recordings with more H at length 3 than at 7"
    )
    yield compared("Section V-C: adaptive weights", "H", "adaptive", "low-pass", "recordings whose genuine H gains; the formula is ours")
    yield compared(
        "Section II-D: gravity by descent (Eq 13 and 14)", "H_acc", "descent", "low-pass",
        "recordings whose genuine H_acc is above that of a 30 s low-pass; unavailable where no standstill tells g",
    )  # fmt: skip


def _wanted(findings: Findings) -> Iterator[Cell]:
    """What the project wants of the drive; the lag is what it measured."""
    for statistic, (wanted, tolerance) in MEDIANS.items():
        series = findings.values["drive", "genuine", statistic]
        median = float(np.median(series.value))
        low, high = bootstrap(series, findings.sessions["drive"].window_s, lambda values: float(np.median(values)))
        yield _check(f"genuine median of {statistic}", f"{wanted} +- {tolerance}", median, abs(median - wanted) <= tolerance, (low, high))
    for statistic in FOUR:
        row = findings.row("statistics", recording="drive", case="replay-300s", statistic=statistic)
        yield _check(f"replay by 300 s: |median| of {statistic}", "< 0.1", abs(row["median"]), abs(row["median"]) < 0.1)
        if statistic.endswith("acc"):
            yield _check(f"replay by 300 s: 99th percentile of {statistic}", "< 0.5", row["p99"], row["p99"] < 0.5)
    for kind in ("gnss_still", "imu_still", "either"):
        genuine, replayed = (
            findings.row("contradictions", recording="drive", case=c, kind=kind)["per_min"] for c in ("genuine", "replay-300s")
        )
        yield _check(f"contradicted seconds per minute, {kind}, genuine", "< 1", genuine, genuine < 1)
        yield _check(f"contradicted seconds per minute, {kind}, replay by 300 s", "> 5", replayed, replayed > 5)
    for delay, item, found in ((1, "is not detected", False), (3, "is detected", True)):
        share = findings.row("statistics", recording="drive", case=f"replay-{delay}s", statistic="H")["share_below_0_7"]
        yield _check(
            f"replay by {delay} s {item}: share with H < 0.7", "> 0.9" if found else "< 0.5", share, share > 0.9 if found else share < 0.5
        )


def _check(item: str, wanted: str, ours: float, holds: bool, interval: tuple[float | None, float | None] = (None, None)) -> Cell:
    verdict: Verdict = "matches after calibration" if holds else "not reproduced"
    return Cell(f"check on the drive: {item}", wanted, ours, *interval, verdict, "the project's own check, not the paper's number")


def _share(item: str, series: Series, window_s: float, reason: str) -> Cell:
    low, high = bootstrap(series, window_s, lambda values: float(values.mean()))
    return Cell(item, None, float(series.value.mean()), low, high, "trend only" if (low or 0) > 0.5 else "not reproduced", reason)


def _together(a: Series, b: Series) -> tuple[Series, Series]:
    """Both at the times at which both are available."""
    _, i, j = np.intersect1d(a.time_s, b.time_s, return_indices=True)
    return Series(a.time_s[i], a.value[i]), Series(b.time_s[j], b.value[j])
