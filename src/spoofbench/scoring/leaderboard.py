"""The leaderboard of a results folder: a table for each provenance and input class.

What is real, injected and simulated is never averaged, and detectors are ranked among those that
look at the same things. All rows of a table are judged on its support: every attack window whose
recording and variant hold what the class looks at, whatever the rows did there. A row that has no
result on one has missed it; one that requires more than the class, and so could not be judged on
all of it, is shown apart.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from spoofbench.formatting import counted
from spoofbench.results import FAILURES, Provenance
from spoofbench.scoring.comparison import compare_with_first
from spoofbench.scoring.figures import Figures
from spoofbench.scoring.score import Point
from spoofbench.scoring.scored import JudgedMaterial, ScoredFolder
from spoofbench.scoring.severity import SeverityCurve, severity_curve
from spoofbench.scoring.statistics import MIN_SESSIONS, poisson_rate, session_means


@dataclass(frozen=True, slots=True)
class LeaderboardRow:
    """One detector configuration in one table; unknown is None.

    Attributes:
        rank: 1 is best, equal where nothing tells two rows apart; None for baselines, for rows that
            stand apart and where there is nothing to compare with.
        apart: why the row has no rank; "" where it has one or is a baseline.
        detector: name in the suite.
        plugin, plugin_distribution, plugin_version, parameters: what it is; parameters as JSON
            text.
        parameter_sources: where those that are not defaults come from, as JSON text by name.
        baseline: whether the detector says that it is one that others must beat.
        is_fitted, learns_from_attacks: whether the run has fitted it, and on attacks too.
        threshold: how the ranked threshold came about: ``calibrated``, ``raised only``,
            ``no clean score``, ``uncalibratable`` or ``published``; the worst of those of several
            sessions.
        factor_lo, factor_hi: the range of the factors on the published threshold.
        ranked: figures at the table's operating point; None where the row has none there.
        published: figures at the published threshold.
        keeps_target: whether the lower end of the false-alert interval (where it has none, of all
            sessions as if they were one) is at most the target; None where the rate is unknown.
        not_better_than: the best baseline that does as well or better; None where it beats all.
        told_apart: from the row ranked first; None for that row and where it has no rank.
        sessions_needed: how many would tell it apart, where it is not.
        family_left_out: attacks detected, of how many, when it has learned from other attacks
            than the one it is judged on.
        ok, failed, skipped, not_modelled: numbers of tasks; ``failed`` holds timeouts and memory as
            well.
        reasons: why tasks failed or were skipped, most frequent first.
    """

    rank: int | None
    apart: str
    detector: str
    plugin: str
    plugin_distribution: str
    plugin_version: str
    parameters: str
    parameter_sources: str
    baseline: bool
    is_fitted: bool
    learns_from_attacks: bool
    threshold: str
    factor_lo: float | None
    factor_hi: float | None
    ranked: Figures | None
    published: Figures
    keeps_target: bool | None
    not_better_than: str | None
    told_apart: bool | None
    sessions_needed: int | None
    family_left_out: tuple[int, int] | None
    ok: int
    failed: int
    skipped: int
    not_modelled: int
    reasons: tuple[str, ...]

    @property
    def exceeds_target(self) -> bool:
        """Whether it is known not to keep the target false-alert rate."""
        return self.keeps_target is False

    @property
    def shown(self) -> Figures:
        """The figures at the table's operating point, else those at the published threshold."""
        return self.ranked or self.published


@dataclass(frozen=True, slots=True)
class LeaderboardCell:
    """One detector configuration against one attack, at the operating point that its row shows."""

    detector: str
    attack: str
    figures: Figures


@dataclass(frozen=True, slots=True)
class BoardTable:
    """The rows of one provenance and input class.

    Attributes:
        provenance, input_class: of the attacks, and of the detectors.
        point: operating point at which the rows are ranked.
        rows: best first, baselines where their figures put them, rows without figures last.
        cells: of each row in their order, by attack in the order of the suite.
        attacks: in the order of the suite.
        windows: number of attack intervals in the support.
        disjoint_windows: in how many stretches of recordings they lie: attacks share them.
        recordings, sessions: that the support lies in.
        sensor_classes: of those recordings.
        clean_h, clean_sessions: hours of recordings on which false alerts are counted, and their
            sessions.
        notes: what must be said about the table, a sentence each.
    """

    provenance: Provenance
    input_class: str
    point: Point
    rows: tuple[LeaderboardRow, ...]
    cells: tuple[LeaderboardCell, ...]
    attacks: tuple[str, ...]
    windows: int
    disjoint_windows: int
    recordings: int
    sessions: int
    sensor_classes: tuple[str, ...]
    clean_h: float
    clean_sessions: int
    notes: tuple[str, ...]

    def cells_of(self, index: int) -> tuple[LeaderboardCell, ...]:
        """Return the cells of the row with this index, in the order of the attacks."""
        n = len(self.attacks)
        return self.cells[index * n : (index + 1) * n]


@dataclass(frozen=True, slots=True)
class TransferRow:
    """A threshold fitted on one sensor class and judged on another.

    Attributes:
        detector: name in the suite.
        fitted_on, judged_on: sensor classes.
        factor: on the published threshold.
        episodes, clean_h: false alerts on the class that is judged.
        detected, attacks: attack intervals.
    """

    detector: str
    fitted_on: str
    judged_on: str
    factor: float | None
    episodes: int
    clean_h: float
    detected: int
    attacks: int


@dataclass(frozen=True, slots=True)
class SeverityRow:
    """How strong an attack must be for a detector to see it, at the operating point of its row in
    the table of this provenance and input class.
    """

    provenance: Provenance
    input_class: str
    detector: str
    attack: str
    curve: SeverityCurve


@dataclass(frozen=True, slots=True)
class AbsentDetector:
    """A detector of the suite that is in no table, and why."""

    detector: str
    reason: str


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """What a results folder says.

    Attributes:
        suite: its name.
        target_far_per_hour: the false-alert rate that detectors are to keep.
        tables: by provenance, then input class.
        transfer: thresholds carried from class to class, where there are several.
        severity: of attacks that the suite makes at several strengths.
        absent: detectors that are in no table.
    """

    suite: str
    target_far_per_hour: float
    tables: tuple[BoardTable, ...]
    transfer: tuple[TransferRow, ...]
    severity: tuple[SeverityRow, ...]
    absent: tuple[AbsentDetector, ...]


def leaderboard(folder: Path) -> Leaderboard:
    """Return the leaderboard of a scored results folder.

    Rows that keep the target false-alert rate come before those that do not, or whose rate is
    unknown; within each by attacks detected, then by restricted mean time to first detection.

    Raises:
        ResultsError: a file of the folder is missing or damaged, or the folder has no tasks.
    """
    scored = ScoredFolder(folder)
    tables = [_Table(scored, material) for material in scored.materials()]
    return Leaderboard(
        suite=scored.suite["name"],
        target_far_per_hour=scored.suite["target_far_per_hour"],
        tables=tuple(table.read() for table in tables),
        transfer=tuple(TransferRow(*row) for row in scored.transfers.itertuples(index=False)),
        severity=tuple(row for table in tables for row in table.severity()),
        absent=tuple(_absent(scored, {row.detector for table in tables for row in table.rows})),
    )


def _absent(scored: ScoredFolder, shown: set[str]) -> Iterator[AbsentDetector]:
    for name in scored.detectors["detector"]:
        if name not in shown:
            reasons = scored.tasks["reason"][scored.tasks["detector"] == name].value_counts()
            unheld = "nothing that is judged holds what it looks at"
            yield AbsentDetector(name, str(reasons.index[0]) if len(reasons) else unheld)


class _Table:
    """Makes one table of a folder."""

    def __init__(self, scored: ScoredFolder, material: JudgedMaterial) -> None:
        self.scored, self.material = scored, material

    @cached_property
    def rows(self) -> list[LeaderboardRow]:
        return self._ranked(self._compared([self._row(name) for name in self.material.detectors]))

    def read(self) -> BoardTable:
        """Return the table."""
        material = self.material
        support, faced = material.support, material.faced
        order = {name: n for n, name in enumerate(self.scored.attacks)}
        attacks = sorted(support["attack"].unique(), key=order.__getitem__)
        return BoardTable(
            provenance=material.provenance,
            input_class=material.input_class,
            point=material.point,
            rows=tuple(self.rows),
            cells=tuple(self._cell(row, attack) for row in self.rows for attack in attacks),
            attacks=tuple(attacks),
            windows=faced["interval"].size,
            disjoint_windows=self._disjoint_windows(),
            recordings=support["recording"].nunique(),
            sessions=support["session"].nunique(),
            sensor_classes=material.sensor_classes,
            clean_h=self.scored.hours(material.clean),
            clean_sessions=material.clean["session"].nunique(),
            notes=tuple(self._notes()),
        )

    def _row(self, detector: str) -> LeaderboardRow:
        scored, material, thresholds = self.scored, self.material, self.scored.thresholds
        point, faced, clean = material.point, material.faced, material.clean
        about: Any = scored.detectors.loc[detector]
        tasks = scored.judged[scored.judged["detector"] == detector]
        tasks = tasks[tasks["variant"].isin(self.variants)]
        published = scored.figures(detector, "published", faced, clean)
        assert published is not None, "every detector has a published threshold"
        ranked = scored.figures(detector, point, faced, clean)
        used = thresholds[
            (thresholds["detector"] == detector)
            & thresholds["sensor_class"].isin(material.support["sensor_class"].unique())
            & thresholds["left_out"].isna()
        ]
        how = _worst(used["how"]) if point == "calibrated" else "published"
        status = tasks["status"]
        far_lo = _lowest_far_per_hour(ranked) if ranked else None
        return LeaderboardRow(
            rank=None,
            apart=self._apart(about, tasks, ranked, how),
            detector=detector,
            plugin=about["plugin"],
            plugin_distribution=about["plugin_distribution"],
            plugin_version=about["plugin_version"],
            parameters=about["parameters"],
            parameter_sources=about["parameter_sources"],
            baseline=bool(about["baseline"]),
            is_fitted=bool(tasks["fit_id"].notna().any()),
            learns_from_attacks=bool(tasks["learns_from_attacks"].any()),
            threshold=how,
            factor_lo=_number(used["factor"].min()),
            factor_hi=_number(used["factor"].max()),
            ranked=ranked,
            published=published,
            keeps_target=None if far_lo is None else far_lo <= scored.suite["target_far_per_hour"],
            not_better_than=None,
            told_apart=None,
            sessions_needed=None,
            family_left_out=self._family_left_out(detector),
            ok=int((status == "ok").sum()),
            failed=int(status.isin(FAILURES).sum()),
            skipped=int((status == "skipped").sum()),
            not_modelled=int((status == "not_modelled").sum()),
            reasons=tuple(tasks["reason"].dropna().value_counts().index),
        )

    @cached_property
    def variants(self) -> Any:
        """Numbers of the support and of what false alerts are counted on."""
        return np.union1d(self.material.support["variant"], self.material.clean["variant"])

    def _apart(self, about: Any, tasks: pd.DataFrame, ranked: Figures | None, how: str) -> str:
        if about["baseline"]:
            return ""
        support = self.material.support
        required = set(json.loads(about["requires"]))
        kinds = tasks["kinds"][tasks["variant"].isin(support["variant"])].value_counts()
        had = sum(kinds[[required <= set(json.loads(text)) for text in kinds.index]])
        if had < len(support):
            return f"judged on {had} of {len(support)} windows: it requires more, or is for others"
        declared = self._warm_up_s
        if declared is not None and about["warm_up_s"] > declared:
            return f"it needs {about['warm_up_s']:g} s of input, the suite gives {declared:g} s"
        if ranked is None and how == "uncalibratable":
            return "uncalibratable"
        if ranked is None:
            return "some of its windows have no calibrated threshold"
        return ""

    @cached_property
    def _warm_up_s(self) -> float | None:
        """What comes before the first window; None where detectors' own declarations do."""
        suite = self.scored.suite
        until_s = (suite["calibration"] or {}).get("until_s") or 0.0
        declared: float | None = suite["warm_up_s"]
        is_calibrated = self.material.point == "calibrated"
        return declared if declared is None or not is_calibrated else max(declared, until_s)

    def _family_left_out(self, detector: str) -> tuple[int, int] | None:
        place = (detector, self.material.point, "family left out")
        detected = self.scored.met(place, self.material.faced)["detected"]
        known = detected[~np.isnan(detected)]
        return (int(known.sum()), known.size) if known.size else None

    def _compared(self, rows: Sequence[LeaderboardRow]) -> list[LeaderboardRow]:
        """Say of each row whether it can be told apart from the first, and which baseline it does
        not beat.
        """
        baselines = [row for row in rows if row.baseline and row.ranked and not row.exceeds_target]
        best = min(baselines, key=_key, default=None)
        marked = [
            replace(row, not_better_than=best.detector)
            if best and _can_rank(row) and _key(best) <= _key(row)
            else row
            for row in rows
        ]
        able = sorted((row for row in marked if _can_rank(row)), key=_key)
        if len(able) < 2:
            return marked
        point, faced = self.material.point, self.material.faced
        sessions = np.unique(faced["session"])
        shares = [
            session_means(
                self.scored.met((row.detector, point, "judged"), faced)["detected"] == 1,
                faced["session"],
                sessions,
            )
            for row in able
        ]
        comparisons = compare_with_first(np.array(shares), 1.0)
        told = {
            row.detector: (found.told_apart, found.sessions_needed)
            for row, found in zip(able[1:], comparisons, strict=True)
        }
        return [
            replace(row, told_apart=told[row.detector][0], sessions_needed=told[row.detector][1])
            if row.detector in told
            else row
            for row in marked
        ]

    def _ranked(self, rows: Sequence[LeaderboardRow]) -> list[LeaderboardRow]:
        """Put the best first and number those that can be ranked, equals equally."""
        able = [row for row in rows if _can_rank(row)]
        keys = sorted(_key(row) for row in able)
        numbered = [
            replace(row, rank=keys.index(_key(row)) + 1)
            if _can_rank(row) and len(able) > 1
            else replace(row, apart="the only row of its class")
            if _can_rank(row)
            else row
            for row in rows
        ]
        return sorted(
            numbered,
            key=lambda row: (row.ranked is None, bool(row.apart) and len(able) > 1, *_key(row)),
        )

    def _disjoint_windows(self) -> int:
        """How many windows of the suite attacks lie in, and real attacks."""
        windows = self.material.support[["recording", "window"]]
        known = windows.dropna().drop_duplicates()
        return len(known) + int(windows["window"].isna().sum())

    @cached_property
    def nothing(self) -> pd.DataFrame:
        """No clean variant: cells have no false alerts."""
        return self.material.clean[:0]

    def _cell(self, row: LeaderboardRow, attack: str) -> LeaderboardCell:
        of_attack = self.material.faced["attack"] == attack
        some = {name: values[of_attack] for name, values in self.material.faced.items()}
        found = self.scored.figures(row.detector, self._shown(row), some, self.nothing)
        assert found is not None, "a row has its point on all of its support"
        return LeaderboardCell(row.detector, attack, found)

    def _shown(self, row: LeaderboardRow) -> Point:
        return self.material.point if row.ranked else "published"

    def severity(self) -> Iterator[SeverityRow]:
        """Yield how strong attacks must be for each row, over all of the support."""
        faced = self.material.faced
        of_variant = self.scored.tasks.drop_duplicates("variant").set_index("variant")
        groups = of_variant["attack_group"].to_numpy()[faced["variant"]]
        strength = of_variant["strength"].to_numpy(float)[faced["variant"]]
        for row in self.rows:
            place = (row.detector, self._shown(row), "judged")
            detected = (self.scored.met(place, faced)["detected"] == 1).astype(float)
            for group in dict.fromkeys(groups):
                own = (groups == group) & ~np.isnan(strength)
                curve = severity_curve(strength[own], detected[own], faced["session"][own])
                if curve is not None and curve.strength.size > 1:
                    yield SeverityRow(
                        self.material.provenance,
                        self.material.input_class,
                        row.detector,
                        str(group),
                        curve,
                    )

    def _notes(self) -> Iterator[str]:
        """Say what a reader must know, and what the evidence cannot show."""
        suite, support, left_out = self.scored.suite, self.material.support, self.material.left_out
        calibration, target = suite["calibration"], suite["target_far_per_hour"]
        hours, sessions = self.scored.hours(self.material.clean), support["session"].nunique()
        if self.material.point == "published":
            yield "Thresholds are the published ones: nothing here has set them."
        elif calibration["split"] == "first-part":
            yield "Thresholds are from the first part of the same session: optimistic."
        if hours * target < 3:
            yield (
                f"{hours:.2g} clean hours cannot tell a rate of {3 / hours:.2g} false alerts per "
                "hour from none."
                if hours
                else "No clean hour was judged: false-alert rates are unknown."
            )
        if sessions < 5:
            verb = "orders" if sessions == 1 else "order"
            yield (
                f"{counted(sessions, 'session')} {verb} detectors on what was recorded; how they "
                "do elsewhere, and whether the order holds, it takes more to say."
            )
        if 1 < self.material.clean["session"].nunique() < MIN_SESSIONS:
            yield (
                "No interval of false alerts holds for so few sessions: whether a row keeps the "
                "target supposes that they are alike, and the order is no claim."
            )
        if len(left_out):
            yield (
                f"Left out: {counted(left_out['recording'].nunique(), 'recording')} with positions "
                "that are fused with the inertial sensors that they would be held against."
            )
        if support["is_fused"].any() and "imu" in self.material.input_class.split("+"):
            yield (
                "Positions of some recordings are fused with inertial sensors, which hides part of "
                "what is compared."
            )


def _can_rank(row: LeaderboardRow) -> bool:
    return row.ranked is not None and not row.apart and not row.baseline


def _lowest_far_per_hour(figures: Figures) -> float | None:
    """The lower end of the false-alert interval; where there is none, the exact one of all sessions
    as if they were one.
    """
    if figures.far_per_hour_lo is None:
        pooled = poisson_rate(figures.episodes, figures.clean_h)
        return None if pooled is None else pooled.lo
    return figures.far_per_hour_lo


def _key(row: LeaderboardRow) -> tuple[bool, float, float]:
    """What rows are ordered by, the best least."""
    shown = row.shown
    share = shown.detected / shown.attacks if shown.attacks else 0.0
    mean_s = shown.restricted_mean_ttfd_s
    return row.keeps_target is not True, -share, float("inf") if mean_s is None else mean_s


_HOW = ("calibrated", "raised only", "no clean score", "no session", "uncalibratable")
"""From the best to the worst."""


def _worst(how: pd.Series) -> str:
    return max(how, key=_HOW.index, default="published")


def _number(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)
