"""What Borio says of his figures (Section IV), beside what the sessions gave."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spoofbench.arrays import Floats
from spoofbench_papers.borio.recordings import WINDOWS_S, FieldSession
from spoofbench_papers.borio.standstill import parked
from spoofbench_papers.borio.statistics import (
    FALSE_ALERTS,
    FOUR,
    QUINTILES,
    THRESHOLD,
    Row,
    Series,
    Values,
    below,
    bootstrap,
    unrelated,
)
from spoofbench_papers.reproduction import Cell

DRIVE = "drive"


@dataclass(frozen=True, slots=True)
class Findings:
    """Sessions by name, the values of each statistic, and the tables that are written."""

    sessions: Mapping[str, FieldSession]
    values: Values
    tables: Mapping[str, Sequence[Row]]

    def row(self, table: str, **wanted: Any) -> Row:
        """Return the one row of a table that has these values."""
        return next(
            row
            for row in self.tables[table]
            if all(row[key] == value for key, value in wanted.items())
        )

    def median(self, name: str, statistic: str) -> float:
        """Genuine median of a statistic that is available."""
        return float(np.median(self.values[name, "genuine", statistic].value))

    @property
    def long(self) -> list[str]:
        """Sessions whose window is the paper's."""
        return [
            name
            for name, session in self.sessions.items()
            if session.inertial and session.window_s == WINDOWS_S[0]
        ]

    @property
    def telling(self) -> list[str]:
        """Those of them whose genuine medians all exceed the paper's threshold: elsewhere a low
        value says nothing of spoofing.
        """
        return [
            name
            for name in self.long
            if min(self.median(name, statistic) for statistic in FOUR) > THRESHOLD
        ]

    def pooled(self, pairs: Sequence[tuple[str, str]], statistics: Sequence[str]) -> Floats:
        """Return the values of statistics in pairs of session and case, one after another,
        ``(n,)``.
        """
        return np.concatenate(
            [
                self.values[name, case, statistic].value
                for name, case in pairs
                for statistic in statistics
            ]
        )

    def unrelated(self, names: Sequence[str]) -> list[tuple[str, str]]:
        """Sessions and their cases in which GNSS is of another time or run."""
        return [(name, case) for name in names for case in unrelated(self.values, name)]


def together(a: Series, b: Series) -> tuple[Series, Series]:
    """Both at the times at which both are available."""
    _, i, j = np.intersect1d(a.time_s, b.time_s, return_indices=True)
    return Series(a.time_s[i], a.value[i]), Series(b.time_s[j], b.value[j])


SPORADIC = 0.05
PHONES = ("iphone-2", "iphone-3", "iphone-5")
LAG = "another car than the paper's, with its receiver's lag of 0.34 s taken out"


def cells(findings: Findings) -> list[Cell]:
    """Return each statement of the paper that can be asked of the recordings, then what the project
    expects of the drive.
    """
    found: list[Cell] = []
    if DRIVE in findings.sessions:
        found += [
            *_genuine(findings),
            *_nature(findings),
            *_spoofed(findings),
            *_threshold(findings),
        ]
    if "phone-car" in findings.sessions:
        found += [*_steady(findings), _phone(findings)]
    return [*found, *_low_end(findings)]


def _genuine(findings: Findings) -> Iterator[Cell]:
    window_s = findings.sessions[DRIVE].window_s
    for statistic in FOUR:
        series = findings.values[DRIVE, "genuine", statistic]
        low, high = bootstrap(series, window_s, lambda values: 1 - below(0.8)(values))
        yield Cell(
            f"text to Fig 8: share of the time with {statistic} above 0.8", "most",
            1 - below(0.8)(series.value), low, high,
            "matches after calibration" if low is not None and low > 0.5 else "not reproduced", LAG,
        )  # fmt: skip


def _nature(findings: Findings) -> Iterator[Cell]:
    window_s = findings.sessions[DRIVE].window_s
    series = {statistic: findings.values[DRIVE, "genuine", statistic] for statistic in FOUR}
    for kind in "MH":
        rate, force = together(series[f"{kind}_ag"], series[f"{kind}_acc"])
        above = Series(rate.time_s, (rate.value > force.value).astype(float))
        low, high = bootstrap(above, window_s, lambda values: float(values.mean()))
        yield Cell(
            f"text to Fig 8: {kind}_ag is above {kind}_acc", None, float(above.value.mean()), low,
            high,
            "trend only" if low is not None and low > 0.5 else "not reproduced",
            "share of the epochs",
        )  # fmt: skip
    norm, level = together(series["M_acc"], series["H_acc"])
    gap = np.abs(norm.value - level.value)
    yield Cell(
        "text to Fig 8: M_acc and H_acc are very close", "very close", float(np.median(gap)), None,
        None,
        "trend only" if np.median(gap) < 0.02 else "not reproduced",
        (
            "median of their absolute difference; 95 % of the epochs are within "
            f"{np.percentile(gap, 95):.3f}"
        ),
    )  # fmt: skip
    still = parked(findings.sessions[DRIVE], series["M_acc"])
    if still.any():
        low, high = (float(np.median(series["M_acc"].value[which])) for which in (still, ~still))
        yield Cell(
            "text to Fig 8: the statistics are lower while the vehicle is static", "lower", low,
            None, None,
            "trend only" if low < high else "not reproduced",
            f"median M_acc of windows without motion, {high:.2f} of the others: a few moving "
            "seconds within the window are enough. M_ag "
            "and H_ag are unavailable there, since a car at rest has no heading",
        )  # fmt: skip


def _spoofed(findings: Findings) -> Iterator[Cell]:
    pairs = findings.unrelated(findings.telling)
    runs = [pair for pair in pairs if _is_run(findings, *pair)]
    past = [(n, c) for n, c in pairs if c.startswith("replay")]
    for words, chosen in (
        ("of another run of the route", runs),
        ("of the same receiver, 60 s or 300 s before", past),
    ):
        if chosen:
            values = findings.pooled(chosen, FOUR)
            share = below(0.6)(values)
            names = ", ".join(dict.fromkeys(name for name, _ in chosen))
            yield Cell(
                f"text to Figs 9 and 12: values below 0.6 with sporadic exceptions, GNSS {words}",
                "all but sporadic", share, None, None,
                "matches" if share >= 1 - SPORADIC else "not reproduced",
                f"share of the values of the four statistics, highest {values.max():.2f}, on the "
                "recordings whose genuine medians are all "
                f"above {THRESHOLD}: {names}",
            )  # fmt: skip
    yield from _untelling(findings)
    both = [_lesser(findings, name, case, kind) for name, case in pairs for kind in "MH"]
    coinciding = np.concatenate(both)
    yield Cell(
        "text to Fig 9: high values of acceleration and of angular rate do not coincide",
        "not observed", 1 - below(0.6)(coinciding), None,
        None, "matches" if coinciding.max() <= 0.6 else "not reproduced",
        (
            "share of epochs with both above 0.6, MAV and HoC, on the same recordings; at most "
            f"both are {coinciding.max():.2f}"
        ),
    )  # fmt: skip


def _is_run(findings: Findings, name: str, case: str) -> bool:
    """Whether GNSS is of another recording of the group."""
    donor = findings.sessions.get(case.removeprefix("meacon-"))
    return donor is not None and donor.log.group == findings.sessions[name].log.group


def _untelling(findings: Findings) -> Iterator[Cell]:
    """The same where it says little, for that the genuine values are low too."""
    names = [name for name in findings.long if name not in findings.telling]
    runs = [pair for pair in findings.unrelated(names) if _is_run(findings, *pair)]
    if runs:
        spoofed = findings.pooled(runs, FOUR)
        low = below(0.6)(findings.pooled([(name, "genuine") for name in names], FOUR))
        yield Cell(
            (
                "text to Figs 9 and 12: the same, GNSS of another run, on recordings whose genuine "
                "values are low"
            ),
            "all but sporadic", below(0.6)(spoofed), None, None,
            "trend only" if below(0.6)(spoofed) >= 1 - SPORADIC else "not reproduced",
            (
                f"highest {spoofed.max():.2f}, on {', '.join(names)}; of their genuine values "
                f"{100 * low:.0f} % are below 0.6 too"
            ),
        )  # fmt: skip


def _lesser(
    findings: Findings, name: str, case: str, kind: str
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """The lesser of the two statistics of MAV or HoC, where both are available."""
    force, rate = together(
        findings.values[name, case, f"{kind}_acc"], findings.values[name, case, f"{kind}_ag"]
    )
    return np.minimum(force.value, rate.value)


def _threshold(findings: Findings) -> Iterator[Cell]:
    genuine = findings.values[DRIVE, "genuine", "H"]
    false, detected = (
        below(THRESHOLD)(genuine.value),
        below(THRESHOLD)(findings.pooled(findings.unrelated([DRIVE]), ["H"])),
    )
    low, high = bootstrap(genuine, findings.sessions[DRIVE].window_s, below(THRESHOLD))
    yield Cell(
        "text to Fig 9: 0.7 tells normal from spoofed; share of genuine H below it",
        "0.7 can be adopted", false, low, high,
        (
            "matches after calibration"
            if false < SPORADIC and detected > 1 - SPORADIC
            else "not reproduced"
        ),
        f"{100 * detected:.1f} % of the epochs with GNSS of another time or run are below; {LAG}",
    )  # fmt: skip
    others = [name for name in findings.long if name != DRIVE]
    if not others:
        return
    shares = {
        name: 100 * below(THRESHOLD)(findings.values[name, "genuine", "H"].value) for name in others
    }
    yield Cell(
        "text to Fig 9: the threshold depends on the IMU", "depends",
        f"{min(shares.values()):.0f} to {max(shares.values()):.0f} %", None,
        None, "trend only" if max(shares.values()) > 100 * SPORADIC else "not reproduced",
        "genuine epochs with H below 0.7: "
        + ", ".join(f"{name} {share:.0f} %" for name, share in shares.items()),
    )  # fmt: skip
    fitted = {
        row["fitted_on"]: row["threshold"]
        for row in findings.tables["transfer"]
        if row["statistic"] == "H"
    }
    limits = [fitted[name] for name in findings.long]
    yield Cell(
        f"the same: thresholds on H that {100 * FALSE_ALERTS:g} % of genuine epochs fall below",
        "depends",
        f"{min(limits):.2f} to {max(limits):.2f}", None, None, "trend only",
        (
            "the least and the greatest over the recordings of 120 s windows; transfer.parquet has "
            "all pairs of recordings"
        ),
    )  # fmt: skip


def _steady(findings: Findings) -> Iterator[Cell]:
    """Section IV-B: steady cruise, on the recording that is mostly motorway."""
    fall = {}
    for statistic in FOUR:
        ends = [
            findings.row("dynamics", recording="phone-car", statistic=statistic, quintile=number)
            for number in (QUINTILES, 1)
        ]
        fall[statistic] = ends[0]["median"] - ends[1]["median"]
    words = ", ".join(f"{statistic} {value:.2f}" for statistic, value in fall.items())
    reason = (
        "fall of the median from the liveliest fifth of phone-car's windows to the calmest: "
        f"{words}"
    )
    for item, value, holds in (
        (
            "the statistics fall where the driver keeps speed and lane",
            min(fall.values()),
            min(fall.values()) > 0,
        ),
        ("M_ag is the most affected", fall["M_ag"], fall["M_ag"] == max(fall.values())),
        ("H_ag is the least affected", fall["H_ag"], fall["H_ag"] == min(fall.values())),
    ):
        yield Cell(
            f"text to Fig 11: {item}",
            None,
            value,
            None,
            None,
            "trend only" if holds else "not reproduced",
            reason,
        )


def _phone(findings: Findings) -> Cell:
    own = findings.row("transfer", fitted_on="phone-car", applied_to="phone-car", statistic="H")
    return Cell(
        "text to Fig 13: a phone's IMU can verify GNSS", None, own["detection_share"], None, None,
        "trend only" if own["detection_share"] > 0.9 else "not reproduced",
        "share of epochs with GNSS of another time or run that H finds below "
        f"{own['threshold']:.2f}, as 1 % of phone-car's genuine epochs "
        "are: fitted and judged on one recording, so at best",
    )  # fmt: skip


def _low_end(findings: Findings) -> Iterator[Cell]:
    poor = [name for name in PHONES if name in findings.sessions]
    if poor:
        medians = {
            name: (findings.median(name, "H_acc"), findings.median(name, "H_ag")) for name in poor
        }
        listed = ", ".join(
            f"{name} {force:.2f} and {rate:.2f}" for name, (force, rate) in medians.items()
        )
        yield Cell(
            (
                "text to Fig 14: on a low-end phone acceleration shows the trend and angular rate "
                "is of no use"
            ),
            None, max(rate for _, rate in medians.values()), None, None,
            (
                "trend only"
                if all(force > rate for force, rate in medians.values())
                else "not reproduced"
            ),
            (
                f"greatest median of H_ag; H_acc and H_ag: {listed}. The cause is another: an IMU "
                "decimated to 5 Hz, courses of positions"
            ),
        )  # fmt: skip
    noisy = [
        row
        for row in findings.tables["gyro_noise"]
        if (row["case"], row["statistic"]) == ("genuine", "H_ag")
    ]
    lost = [row["gyro_noise_radps"] for row in noisy if row["median"] < THRESHOLD]
    if lost:
        yield Cell(
            (
                "text to Fig 14: a gyroscope can be too noisy to be used; rad/s of noise on the "
                "drive's at which H_ag is lost"
            ),
            None, min(lost), None, None, "trend only",
            "white noise of the mean over an epoch, at which the genuine median is below 0.7: "
            + ", ".join(f"{row['median']:.2f} at {row['gyro_noise_radps']:g}" for row in noisy),
        )  # fmt: skip
