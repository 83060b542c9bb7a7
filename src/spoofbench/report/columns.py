"""The columns of the leaderboard, declared once.

Each says what stands over it, what it means and what a row shows in it. Terminal, Markdown and page
render that; they decide about layout alone. Nothing is computed here: figures are those of
:mod:`spoofbench.scoring.leaderboard`.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from spoofbench.formatting import NONE, between, percent, rate, seconds, share_percent
from spoofbench.report.marks import marks
from spoofbench.scoring.figures import Figures
from spoofbench.scoring.leaderboard import BoardTable, LeaderboardRow


@dataclass(frozen=True, slots=True)
class Entry:
    """What a row shows in a column.

    Attributes:
        text: the figure.
        sort: what it sorts by, a number as text; "" is unknown, and last.
        interval: its 95 % interval, a dash where there is none.
        remark: what must be said of the interval, or "".
    """

    text: str
    sort: str
    interval: str = NONE
    remark: str = ""


@dataclass(frozen=True, slots=True)
class LeaderboardColumn:
    """One column of the leaderboard.

    Attributes:
        title, unit: over the column.
        entry: what a row of a table shows.
        definition: what the title means; "" where another column of the title says it.
        has_interval: whether an interval stands beside its figures.
        first: the order that the first click on the page asks for.
        is_text: whether it holds words, which are set left.
        is_name: whether it holds the detector's name.
        asks_for_several: whether it is left out of a table of a single window: of one attack there
            is no percentage, mean or quantile.
        is_rare: whether it is left out where no row has anything to show.
        is_published: whether it is left out of a table that ranks at published thresholds, where
            it would repeat another.
    """

    title: str
    unit: str
    entry: Callable[[BoardTable, LeaderboardRow], Entry]
    definition: str = ""
    has_interval: bool = False
    first: Literal["ascending", "descending"] = "descending"
    is_text: bool = False
    is_name: bool = False
    asks_for_several: bool = False
    is_rare: bool = False
    is_published: bool = False

    @property
    def heading(self) -> str:
        """Title and unit in one line."""
        return f"{self.title}, {self.unit}" if self.unit else self.title


def _entry(text: str, value: float | None, interval: str = NONE, remark: str = "") -> Entry:
    return Entry(text, "" if value is None else repr(float(value)), interval, remark)


def of(count: int | None, total: int) -> str:
    """Return ``n/N``, a dash where there is nothing to count."""
    return NONE if count is None or not total else f"{count}/{total}"


def outcome(figures: Figures) -> str:
    """Return what became of the one attack of a table that has a single window."""
    if not figures.attacks:
        return NONE
    if not figures.detected:
        return f"missed in {seconds(figures.longest_attack_s)} s"
    return f"detected after {seconds(figures.restricted_mean_ttfd_s)} s"


def detected(table: BoardTable, figures: Figures) -> str:
    """Return how many attacks are detected; of a single one, when."""
    return outcome(figures) if table.windows == 1 else of(figures.detected, figures.attacks)


def _false_alerts(figures: Figures) -> Entry:
    interval = between(rate(figures.far_per_hour_lo), rate(figures.far_per_hour_hi))
    remark = "too few episodes" if figures.has_few_episodes else ""
    return _entry(rate(figures.far_per_hour), figures.far_per_hour, interval, remark)


def _detected(table: BoardTable, figures: Figures) -> Entry:
    low, high = (
        share_percent(share) for share in (figures.detected_share_lo, figures.detected_share_hi)
    )
    interval = between(low, high)
    return _entry(
        detected(table, figures),
        figures.detected if figures.attacks else None,
        interval if interval == NONE else f"{interval} %",
    )


def _placebo(figures: Figures) -> Entry:
    return _entry(of(figures.placebo_detected, figures.placebo_attacks), figures.placebo_detected)


def _epochs(figures: Figures) -> Entry:
    interval = between(percent(figures.detection_pct_lo), percent(figures.detection_pct_hi))
    return _entry(percent(figures.detection_pct), figures.detection_pct, interval)


def _mean_time(figures: Figures) -> Entry:
    mean_s = figures.restricted_mean_ttfd_s
    above = "> " if mean_s is not None and not figures.detected else ""
    return _entry(above + seconds(mean_s), mean_s)


def _time(value_s: float | None, figures: Figures) -> Entry:
    """A quantile that is never reached exceeds the longest attack: it sorts behind all known ones,
    before unknown ones.
    """
    if value_s is None and figures.longest_attack_s is not None:
        return Entry(f"> {seconds(figures.longest_attack_s)}", "inf")
    return _entry(seconds(value_s), value_s)


def _hazardous(figures: Figures) -> Entry:
    unwarned = figures.hazardous - figures.warned
    return _entry(of(unwarned, figures.hazardous), unwarned if figures.hazardous else None)


def _threshold(row: LeaderboardRow) -> Entry:
    low, high = row.factor_lo, row.factor_hi
    if low is None or high is None or row.threshold == "published":
        return Entry(row.threshold, "")
    factors = f"{low:.3g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.3g} to {high:.3g}"
    return _entry(f"{factors} ({row.threshold})", low)


def _tasks(row: LeaderboardRow) -> Entry:
    counts = {
        "ok": row.ok,
        "failed": row.failed,
        "skipped": row.skipped,
        "not modelled": row.not_modelled,
    }
    text = ", ".join(f"{n} {name}" for name, n in counts.items() if n)
    return _entry(text or NONE, row.failed + row.skipped + row.not_modelled)


def _family_left_out(row: LeaderboardRow) -> Entry:
    found = row.family_left_out
    return Entry(NONE, "") if found is None else _entry(of(*found), found[0])


def _words(table: BoardTable, row: LeaderboardRow) -> Entry:
    text = "; ".join(mark.words for mark in marks(table, row) if mark.words)
    return Entry(text, text)


RANK = LeaderboardColumn(
    "Rank",
    "",
    lambda _, row: _entry(NONE if row.rank is None else str(row.rank), row.rank),
    (
        "By attacks detected, then by mean time to first detection. Detectors whose false-alert "
        "rate exceeds the target even at the lower end of its interval rank below the rest. "
        "Baselines, rows that stand apart and rows without a rival have no rank."
    ),
    first="ascending",
)
DETECTOR = LeaderboardColumn(
    "Detector",
    "",
    lambda _, row: Entry(row.detector, row.detector),
    first="ascending",
    is_text=True,
    is_name=True,
)
FALSE_ALERTS = LeaderboardColumn(
    "False alerts",
    "per hour",
    lambda _, row: _false_alerts(row.shown),
    (
        "Alarm episodes per available hour of the unattacked recordings, with a 95 % interval: "
        "exact (Garwood) of one session, negative binomial over five and more, none between. "
        "Alerts less than 10 s apart are one episode, and an episode counts again for every 60 s "
        "that it lasts. Clean stretches of attacked variants do not count: they are the same data "
        "again."
    ),
    has_interval=True,
    first="ascending",
)
DETECTED = LeaderboardColumn(
    "Detected",
    "of attacks",
    lambda table, row: _detected(table, row.shown),
    (
        "Attack windows in which an alert begins, of all in the table's support, whatever became "
        "of the detector there: failed, skipped and unavailable is missed. From 5 sessions on a "
        "95 % interval of the share stands beside (Korn-Graubard)."
    ),
    has_interval=True,
)
PLACEBO = LeaderboardColumn(
    "Placebo",
    "of windows",
    lambda _, row: _placebo(row.shown),
    (
        "The same windows on the unattacked recordings: what is detected there is by chance. A "
        "real attack has none."
    ),
    first="ascending",
)
MEAN_TIME = LeaderboardColumn(
    "Mean time",
    "s to first detection",
    lambda _, row: _mean_time(row.shown),
    (
        "First alert minus start of the attack; an alert that was on already must begin anew. The "
        "mean runs up to the longest attack and counts a miss as not yet detected at its end "
        "(restricted mean); > where nothing is detected."
    ),
    first="ascending",
    asks_for_several=True,
)
MEDIAN_TIME = LeaderboardColumn(
    "Median time",
    "s to first detection",
    lambda _, row: _time(row.shown.ttfd_median_s, row.shown),
    (
        "Median and 90 % quantile of the time to first detection are Kaplan-Meier estimates, "
        "misses censored at their length; > stands where a quantile exceeds the longest attack."
    ),
    first="ascending",
    asks_for_several=True,
)
P90_TIME = LeaderboardColumn(
    "90 % time",
    "s to first detection",
    lambda _, row: _time(row.shown.ttfd_p90_s, row.shown),
    first="ascending",
    asks_for_several=True,
)
MEDIAN_ERROR = LeaderboardColumn(
    "Median error",
    "m before alert",
    lambda _, row: _entry(
        rate(row.shown.error_before_alert_median_m), row.shown.error_before_alert_median_m
    ),
    first="ascending",
    asks_for_several=True,
)
P95_ERROR = LeaderboardColumn(
    "95 % error",
    "m before alert",
    lambda _, row: _entry(
        rate(row.shown.error_before_alert_p95_m), row.shown.error_before_alert_p95_m
    ),
    first="ascending",
    asks_for_several=True,
)
LARGEST_ERROR = LeaderboardColumn(
    "Largest error",
    "m before alert",
    lambda _, row: _entry(
        rate(row.shown.error_before_alert_largest_m), row.shown.error_before_alert_largest_m
    ),
    (
        "Largest position error of an attack up to its first alert, or over the whole attack "
        "where it is missed; median, 95 % quantile and largest over the attacks."
    ),
    first="ascending",
)
THRESHOLD = LeaderboardColumn(
    "Threshold",
    "times the published",
    lambda _, row: _threshold(row),
    (
        "The factor on the published threshold at which the row is judged, and how it came about. "
        "Calibrated: from clean sessions, so that the target is kept. Raised only: they are too "
        "short to resolve the target, so the threshold may rise above the largest clean score but "
        "never fall. No clean score: nothing above 0 to learn from. Uncalibratable: an infinite "
        "clean score, which no threshold silences."
    ),
    is_text=True,
)
MARKS = LeaderboardColumn("Marks", "", _words, is_text=True)

EPOCHS_ALERTED = LeaderboardColumn(
    "Alerted",
    "% of spoofed epochs",
    lambda _, row: _epochs(row.shown),
    (
        "Alerted share of all spoofed epochs; unavailable ones count as missed. It never ranks: a "
        "latched alarm buys it. The interval is over sessions, from 5 on."
    ),
    has_interval=True,
    asks_for_several=True,
)
EPOCHS_PLACEBO = LeaderboardColumn(
    "Placebo",
    "% of the same epochs",
    lambda _, row: _entry(percent(row.shown.placebo_pct), row.shown.placebo_pct),
    first="ascending",
    asks_for_several=True,
)
IN_ALARM = LeaderboardColumn(
    "In alarm",
    "% of clean time",
    lambda _, row: _entry(share_percent(row.shown.alarm_share), row.shown.alarm_share),
    "Share of the available clean time in alarm: a latch shows here.",
    first="ascending",
)
AVAILABLE = LeaderboardColumn(
    "Available",
    "% of clean epochs",
    lambda _, row: _entry(share_percent(row.shown.availability), row.shown.availability),
    "Share of the clean epochs at which the detector could tell.",
)
PERSISTED = LeaderboardColumn(
    "Persists",
    "s, median",
    lambda _, row: _entry(seconds(row.shown.persisted_median_s), row.shown.persisted_median_s),
    "How long the alarm of a first detection goes on within the attack.",
)
RETRUST = LeaderboardColumn(
    "Re-trust",
    "s, median",
    lambda _, row: _entry(seconds(row.shown.retrust_median_s), row.shown.retrust_median_s),
    "From the end of an attack to the end of the alarm, where one was on (Kaplan-Meier).",
    first="ascending",
)
HAZARDOUS = LeaderboardColumn(
    "Hazardous",
    "of dangerous attacks",
    lambda _, row: _hazardous(row.shown),
    (
        "Of the attacks whose position error ever exceeds the suite's alert limit, those without "
        "a detection within the time to alert."
    ),
    first="ascending",
)
PUBLISHED_FALSE_ALERTS = LeaderboardColumn(
    "False alerts as published",
    "per hour",
    lambda _, row: _false_alerts(row.published),
    "The same figures at the threshold that the detector comes with.",
    has_interval=True,
    first="ascending",
    is_published=True,
)
PUBLISHED_DETECTED = LeaderboardColumn(
    "Detected as published",
    "of attacks",
    lambda table, row: _detected(table, row.published),
    has_interval=True,
    is_published=True,
)
PUBLISHED_PLACEBO = LeaderboardColumn(
    "Placebo as published",
    "of windows",
    lambda _, row: _placebo(row.published),
    first="ascending",
    is_published=True,
)
FAMILY_LEFT_OUT = LeaderboardColumn(
    "Family left out",
    "of attacks",
    lambda _, row: _family_left_out(row),
    (
        "Attacks detected by a detector that has learned from other attacks than the one it is "
        "judged on."
    ),
    is_rare=True,
)
TASKS = LeaderboardColumn(
    "Tasks",
    "",
    lambda _, row: _tasks(row),
    "What became of the detector's tasks. Failed, skipped and not modelled ones count as misses.",
    is_text=True,
)

VERDICT = (
    RANK,
    DETECTOR,
    FALSE_ALERTS,
    DETECTED,
    PLACEBO,
    MEAN_TIME,
    MEDIAN_TIME,
    P90_TIME,
    MEDIAN_ERROR,
    P95_ERROR,
    LARGEST_ERROR,
    THRESHOLD,
    MARKS,
)
"""What decides, in the order of Markdown and page."""

FURTHER = (
    DETECTOR,
    EPOCHS_ALERTED,
    EPOCHS_PLACEBO,
    IN_ALARM,
    AVAILABLE,
    PERSISTED,
    RETRUST,
    HAZARDOUS,
    PUBLISHED_FALSE_ALERTS,
    PUBLISHED_DETECTED,
    PUBLISHED_PLACEBO,
    FAMILY_LEFT_OUT,
    TASKS,
)
"""What else is known of the same rows: a table of its own below the other."""


def columns_of(
    table: BoardTable, columns: tuple[LeaderboardColumn, ...]
) -> list[LeaderboardColumn]:
    """Return the columns that a table shows of these."""

    def is_shown(column: LeaderboardColumn) -> bool:
        if column.is_rare:
            return any(column.entry(table, row).text != NONE for row in table.rows)
        repeats = column.is_published and table.point == "published"
        return not repeats and not (column.asks_for_several and table.windows == 1)

    return [column for column in columns if is_shown(column)]


def explained(tables: Iterable[BoardTable]) -> list[LeaderboardColumn]:
    """Return the columns that some table shows and that have a definition."""
    shown = [column for table in tables for column in columns_of(table, (*VERDICT, *FURTHER))]
    return [column for column in (*VERDICT, *FURTHER) if column.definition and column in shown]
