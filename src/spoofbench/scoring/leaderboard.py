"""The leaderboard of a results folder: a table for each provenance and input class.

What is real, injected and simulated is never averaged, and detectors are ranked among those that
look at the same things. All rows of a table are judged on its support: every attack window whose
recording and variant hold what the class looks at, whatever the rows did there. A row that has no
result on one has missed it; one that requires more than the class, and so could not be judged on
all of it, is shown apart.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from spoofbench.detector import inputs_of
from spoofbench.errors import ResultsError
from spoofbench.results import (
    FAILURES,
    Provenance,
    read_run,
    read_table,
    read_task_table,
)
from spoofbench.scoring.comparison import compare_with_first
from spoofbench.scoring.figures import Columns, Figures, figures
from spoofbench.scoring.operating import CALIBRATION_SCHEMA, TRANSFER_SCHEMA
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA, Point
from spoofbench.scoring.severity import SeverityCurve, severity_curve
from spoofbench.scoring.statistics import session_means


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
        keeps_target: whether the lower end of the false-alert interval is at most the target; None
            where the rate or its interval is unknown.
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
        """Whether the false-alert rate exceeds the target even at the lower end of its interval."""
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
    """How strong an attack must be for a detector to see it, at the operating point of its row."""

    detector: str
    attack: str
    curve: SeverityCurve


@dataclass(frozen=True, slots=True)
class Leaderboard:
    """What a results folder says.

    Attributes:
        suite: its name.
        target_far_per_hour: the false-alert rate that detectors are to keep.
        tables: by provenance, then input class.
        transfer: thresholds carried from class to class, where there are several.
        severity: of attacks that the suite makes at several strengths.
    """

    suite: str
    target_far_per_hour: float
    tables: tuple[BoardTable, ...]
    transfer: tuple[TransferRow, ...]
    severity: tuple[SeverityRow, ...]


def leaderboard(folder: Path) -> Leaderboard:
    """Return the leaderboard of a scored results folder.

    Rows that keep the target false-alert rate come before those that do not; within each by
    attacks detected, then by restricted mean time to first detection.

    Raises:
        ResultsError: a file of the folder is missing or damaged, or the folder has no tasks.
    """
    return _Board(folder).read()


_Place = tuple[str, str, str]
"""Detector, operating point and role."""


class _Board:
    """Reads a folder: tasks as a data frame, scores and events as columns of each detector at each
    operating point.
    """

    def __init__(self, folder: Path) -> None:
        table = read_task_table(folder)
        if not len(table):
            raise ResultsError(f"{folder} has no tasks to rank; run a suite into it")
        self.suite = read_run(folder)["suite"]
        self.tasks = table.to_pandas()
        scores, events, self.thresholds, self.transfers = (
            read_table(folder / f"{name}.parquet", schema).to_pandas()
            for name, schema in (
                ("scores", SCORE_SCHEMA),
                ("events", EVENT_SCHEMA),
                ("calibration", CALIBRATION_SCHEMA),
                ("transfer", TRANSFER_SCHEMA),
            )
        )
        variants = self.tasks.drop_duplicates("task_id").set_index("task_id")["variant_id"]
        if not scores["task_id"].isin(variants.index).all():
            raise ResultsError(f"the scores in {folder} are not those of its tasks; score it again")
        self.variants = pd.Index(self.tasks["variant_id"].unique())
        self.sessions = pd.Index(self.tasks["session"].unique())
        for rows in (scores, events):
            rows["variant"] = self.variants.get_indexer(rows["task_id"].map(variants))
        self.intervals = (
            events[["variant", "attack", "session", "start_ns", "length_s"]]
            .drop_duplicates(["variant", "start_ns"])
            .reset_index(drop=True)
        )
        keys = pd.MultiIndex.from_frame(self.intervals[["variant", "start_ns"]])
        own = pd.MultiIndex.from_frame(events[["variant", "start_ns"]])
        events["interval"] = keys.get_indexer(own)
        self.calibrated = {
            str(detector): set(some["variant"][some["point"] == "calibrated"])
            for detector, some in scores.groupby("detector", sort=False)
        }
        self.scores, self.events = self._split(scores), self._split(events)

    def _split(self, rows: pd.DataFrame) -> dict[_Place, Columns]:
        """Columns by detector, point and role, in the order of the table."""
        wanted = [
            name for name in (*_COUNTED, *_MET, "strength", "variant", "interval") if name in rows
        ]
        columns: dict[str, Any] = {
            "session": self.sessions.get_indexer(rows["session"]),
            "attack_group": rows["attack_group"].to_numpy(),
            "provenance": rows["provenance"].to_numpy(),
            **{name: rows[name].astype(float).to_numpy() for name in wanted},
        }
        places: Any = rows.groupby(["detector", "point", "role"], sort=False).indices
        return {
            place: {name: values[index] for name, values in columns.items()}
            for place, index in places.items()
        }

    def read(self) -> Leaderboard:
        tables = tuple(
            table
            for provenance in get_args(Provenance)
            for input_class in self.input_classes
            if (table := self._table(provenance, input_class)) is not None
        )
        return Leaderboard(
            suite=self.suite["name"],
            target_far_per_hour=self.suite["target_far_per_hour"],
            tables=tables,
            transfer=tuple(TransferRow(*row) for row in self.transfers.itertuples(index=False)),
            severity=tuple(row for table in tables for row in self._severity(table)),
        )

    @cached_property
    def judged(self) -> Any:
        """Tasks that count, by the suite's order."""
        return self.tasks[(self.tasks["role"] == "judged") & self.tasks["judged_start_ns"].notna()]

    @cached_property
    def detectors(self) -> Any:
        """The first task of each detector, by name."""
        return self.tasks.drop_duplicates("detector").set_index("detector", drop=False)

    @cached_property
    def input_classes(self) -> list[str]:
        own = self.detectors[~self.detectors["baseline"]]["input_class"]
        every = own if len(own) else self.detectors["input_class"]
        return list(every.unique())

    @cached_property
    def attack_order(self) -> dict[str, int]:
        return {name: n for n, name in enumerate(self.judged["attack"].dropna().unique())}

    @cached_property
    def held(self) -> Mapping[str, frozenset[str]]:
        """What each variant that could be made gives to look at."""
        kinds = self.tasks.drop_duplicates("variant_id").dropna(subset=["kinds"])
        return {
            variant: frozenset(inputs_of(json.loads(text)))
            for variant, text in zip(kinds["variant_id"], kinds["kinds"], strict=True)
        }

    def _variants(self, tasks: pd.DataFrame, input_class: str) -> Any:
        """The variants of tasks that hold what the class looks at."""
        wanted = set(input_class.split("+"))
        variants = tasks.drop_duplicates("variant_id")
        holds = [wanted <= self.held.get(name, frozenset()) for name in variants["variant_id"]]
        return variants[np.array(holds, bool)]

    def _is_compared(self, variants: pd.DataFrame, input_class: str) -> Any:
        """Which variants may be ranked: not those whose position is fused with the inertial sensors
        that it would be held against.
        """
        if "imu" not in input_class.split("+"):
            return np.ones(len(variants), bool)
        allowed = variants["sensor_class"].isin(self.suite["ranks_fused"])
        return (~variants["is_fused"] | allowed).to_numpy(bool)

    def _table(self, provenance: Provenance, input_class: str) -> BoardTable | None:
        judged = self.judged
        own = judged[judged["provenance"] == provenance]
        holding = self._variants(own[own["attack"].notna()], input_class)
        compared = self._is_compared(holding, input_class)
        support, left_out = holding[compared], holding[~compared]
        if not len(support) and (judged["attack"].notna().any() or not len(own)):
            return None  # but for suites without any attack
        faced = self._faced(support)
        among = support if len(support) else self._variants(own, input_class)
        classes = tuple(sorted(among["sensor_class"].unique()))
        clean = self._clean(provenance, input_class, classes)
        of_table = {*self.variants.get_indexer([*support["variant_id"], *clean["variant_id"]])}
        is_calibrated = set().union(*self.calibrated.values()) & of_table
        point: Point = "calibrated" if is_calibrated else "published"
        present = set(judged["detector"][judged["variant_id"].isin(among["variant_id"])])
        names = [
            name
            for name, about in self.detectors[self.detectors["detector"].isin(present)].iterrows()
            if about["input_class"] == input_class
            or (
                about["baseline"]
                and set(about["input_class"].split("+")) < set(input_class.split("+"))
            )
        ]
        rows = [self._row(str(name), point, support, faced, clean) for name in names]
        rows = self._ranked(self._compared(rows, point, faced))
        attacks = sorted(support["attack"].unique(), key=self.attack_order.__getitem__)
        return BoardTable(
            provenance=provenance,
            input_class=input_class,
            point=point,
            rows=tuple(rows),
            cells=tuple(
                self._cell(row, point, attack, faced) for row in rows for attack in attacks
            ),
            attacks=tuple(attacks),
            windows=faced["interval"].size,
            recordings=support["recording"].nunique(),
            sessions=support["session"].nunique(),
            sensor_classes=classes,
            clean_h=self._hours(clean),
            clean_sessions=clean["session"].nunique(),
            notes=tuple(self._notes(point, support, clean, left_out)),
        )

    def _faced(self, support: pd.DataFrame) -> dict[str, Any]:
        """The attack intervals of the support as columns; the window where nobody was scored."""
        numbers = self.variants.get_indexer(support["variant_id"])
        seen = self.intervals[self.intervals["variant"].isin(numbers)]
        unseen = support[~np.isin(numbers, seen["variant"])]
        length_s = (unseen["window_end_ns"] - unseen["window_start_ns"]) / 1e9
        nobody = np.full(len(unseen), len(self.intervals))
        return {
            "interval": np.append(seen.index.to_numpy(), nobody).astype(int),
            "variant": np.append(seen["variant"], self.variants.get_indexer(unseen["variant_id"])),
            "attack": np.append(seen["attack"], unseen["attack"]),
            "session": self.sessions.get_indexer(np.append(seen["session"], unseen["session"])),
            "length_s": np.append(seen["length_s"], length_s).astype(float),
        }

    def _clean(self, provenance: Provenance, input_class: str, classes: Sequence[str]) -> Any:
        """The variants on which false alerts are counted: recordings as they are, of the classes of
        the support, and what was reviewed and found clean of really attacked ones.
        """
        tasks = self.judged
        is_simulated = tasks["provenance"] == "simulated"
        of_class = tasks[
            (tasks["attack"].isna() | (tasks["provenance"] == "real attack"))
            & (is_simulated == (provenance == "simulated"))
            & tasks["sensor_class"].isin(classes)
        ]
        variants = self._variants(of_class, input_class)
        return variants[self._is_compared(variants, input_class)]

    def _hours(self, clean: pd.DataFrame) -> float:
        """The most that any detector was available of these recordings, summed."""
        most = np.zeros(len(self.variants))
        for (_, point, _), scores in self.scores.items():
            if point == "published":
                hours_h = np.nan_to_num(scores["available_clean_h"])
                np.maximum.at(most, scores["variant"].astype(int), hours_h)
        return float(most[self.variants.get_indexer(clean["variant_id"])].sum())

    def _met(self, place: _Place, faced: Columns) -> dict[str, Any]:
        """What became of each interval that is faced, NaN where there is no result."""
        columns = {"session": faced["session"], "length_s": faced["length_s"]}
        events = self.events.get(place)
        if events is None:
            return columns | {name: np.full(faced["interval"].size, np.nan) for name in _MET}
        row = np.full(len(self.intervals) + 1, events["interval"].size)
        row[events["interval"].astype(int)] = np.arange(events["interval"].size)
        taken = row[faced["interval"]]
        return columns | {name: np.append(events[name], np.nan)[taken] for name in _MET}

    def _figures(
        self, detector: str, point: Point, faced: Columns, clean: pd.DataFrame
    ) -> Figures | None:
        """The figures of a detector; None where it has none at this operating point."""
        scores = self.scores.get((detector, point, "judged"))
        if point == "calibrated":
            published = self.scores.get((detector, "published", "judged"))
            own = set() if published is None else {*published["variant"]} & {*faced["variant"]}
            if scores is None or not own <= self.calibrated.get(detector, set()):
                return None
        names = (*_COUNTED, "session")
        if scores is None:
            return figures(
                {name: np.empty(0) for name in names}, self._met((detector, point, "judged"), faced)
            )
        rows = np.isin(scores["variant"], self.variants.get_indexer(clean["variant_id"]))
        counted = {name: scores[name][rows] for name in names}
        return figures(counted, self._met((detector, point, "judged"), faced))

    def _row(
        self,
        detector: str,
        point: Point,
        support: pd.DataFrame,
        faced: Columns,
        clean: pd.DataFrame,
    ) -> LeaderboardRow:
        about: Any = self.detectors.loc[detector]
        tasks = self.judged[self.judged["detector"] == detector]
        tasks = tasks[tasks["variant_id"].isin([*support["variant_id"], *clean["variant_id"]])]
        published = self._figures(detector, "published", faced, clean)
        assert published is not None, "every detector has a published threshold"
        ranked = self._figures(detector, point, faced, clean)
        used = self.thresholds[
            (self.thresholds["detector"] == detector)
            & self.thresholds["sensor_class"].isin(support["sensor_class"])
        ]
        status = tasks["status"]
        far_lo = ranked.far_per_hour_lo if ranked else None
        return LeaderboardRow(
            rank=None,
            apart=self._apart(about, tasks, support, ranked),
            detector=detector,
            plugin=about["plugin"],
            plugin_distribution=about["plugin_distribution"],
            plugin_version=about["plugin_version"],
            parameters=about["parameters"],
            parameter_sources=about["parameter_sources"],
            baseline=bool(about["baseline"]),
            is_fitted=bool(tasks["fit_id"].notna().any()),
            learns_from_attacks=bool(tasks["learns_from_attacks"].any()),
            threshold=_worst(used["how"]) if point == "calibrated" else "published",
            factor_lo=_number(used["factor"].min()),
            factor_hi=_number(used["factor"].max()),
            ranked=ranked,
            published=published,
            keeps_target=None if far_lo is None else far_lo <= self.suite["target_far_per_hour"],
            not_better_than=None,
            told_apart=None,
            sessions_needed=None,
            family_left_out=self._family_left_out(detector, point, faced),
            ok=int((status == "ok").sum()),
            failed=int(status.isin(FAILURES).sum()),
            skipped=int((status == "skipped").sum()),
            not_modelled=int((status == "not_modelled").sum()),
            reasons=tuple(tasks["reason"].dropna().value_counts().index),
        )

    def _apart(
        self,
        about: Any,
        tasks: pd.DataFrame,
        support: pd.DataFrame,
        ranked: Figures | None,
    ) -> str:
        if about["baseline"]:
            return ""
        required = set(json.loads(about["requires"]))
        on_support = tasks[tasks["variant_id"].isin(support["variant_id"])]
        had = sum(required <= set(json.loads(kinds)) for kinds in on_support["kinds"])
        if had < len(support):
            return f"judged on {had} of {len(support)} windows: it requires more, or is for others"
        declared = self.suite["warm_up_s"]
        if declared is not None and about["warm_up_s"] > declared:
            return f"it needs {about['warm_up_s']:g} s of input, the suite gives {declared:g} s"
        if ranked is None:
            return "uncalibratable"
        return ""

    def _family_left_out(
        self, detector: str, point: Point, faced: Columns
    ) -> tuple[int, int] | None:
        detected = self._met((detector, point, "family left out"), faced)["detected"]
        known = detected[~np.isnan(detected)]
        return (int(known.sum()), known.size) if known.size else None

    def _compared(
        self, rows: Sequence[LeaderboardRow], point: Point, faced: Columns
    ) -> list[LeaderboardRow]:
        """Say of each row whether it can be told apart from the first, and which baseline it does
        not beat.
        """
        baselines = [row for row in rows if row.baseline and row.ranked and not row.exceeds_target]
        best = min(baselines, key=_key, default=None)
        marked = [
            replace(row, not_better_than=best.detector)
            if best and _can_rank(row) and not row.exceeds_target and _key(best) <= _key(row)
            else row
            for row in rows
        ]
        able = sorted((row for row in marked if _can_rank(row)), key=_key)
        if len(able) < 2:
            return marked
        sessions = np.unique(faced["session"])
        shares = [
            session_means(
                self._met((row.detector, point, "judged"), faced)["detected"] == 1,
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
            else replace(row, apart=row.apart or "the only row of its class")
            if _can_rank(row)
            else row
            for row in rows
        ]
        return sorted(
            numbered,
            key=lambda row: (row.ranked is None, bool(row.apart) and len(able) > 1, *_key(row)),
        )

    def _cell(
        self, row: LeaderboardRow, point: Point, attack: str, faced: Columns
    ) -> LeaderboardCell:
        of_attack = faced["attack"] == attack
        some = {name: values[of_attack] for name, values in faced.items()}
        shown: Point = point if row.ranked else "published"
        found = self._figures(row.detector, shown, some, self.judged[:0])
        assert found is not None, "a row has its point on all of its support"
        return LeaderboardCell(row.detector, attack, found)

    def _severity(self, table: BoardTable) -> Iterable[SeverityRow]:
        for row in table.rows:
            events = self.events.get(
                (row.detector, table.point if row.ranked else "published", "judged")
            )
            if events is None:
                continue
            for group in dict.fromkeys(events["attack_group"]):
                own = (events["attack_group"] == group) & (events["provenance"] == table.provenance)
                own &= ~np.isnan(events["strength"])
                curve = severity_curve(
                    events["strength"][own], events["detected"][own], events["session"][own]
                )
                if curve is not None and curve.strength.size > 1:
                    yield SeverityRow(row.detector, str(group), curve)

    def _notes(
        self,
        point: Point,
        support: pd.DataFrame,
        clean: pd.DataFrame,
        left_out: pd.DataFrame,
    ) -> Iterable[str]:
        """Say what a reader must know, and what the evidence cannot show."""
        calibration, target = self.suite["calibration"], self.suite["target_far_per_hour"]
        hours, sessions = self._hours(clean), support["session"].nunique()
        if point == "published":
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
            noun = "session tells" if sessions == 1 else "sessions tell"
            yield (
                f"{sessions} {noun} detectors apart on what was recorded; how they do elsewhere, "
                "and whether the order holds, it takes 5 or more to say."
            )
        if len(left_out):
            yield (
                f"{left_out['recording'].nunique()} recordings are left out: their positions are "
                "fused with the inertial sensors that they would be held against."
            )
        if support["is_fused"].any():
            yield (
                "Positions of some recordings are fused with inertial sensors, which hides part of "
                "what is compared."
            )


_COUNTED = ("episodes", "available_clean_h", "far_epoch", "availability", "epochs")
_MET = (
    "detected",
    "placebo_detected",
    "ttfd_s",
    "alerted_share",
    "placebo_share",
    "persisted_s",
    "retrust_s",
    "retrust_censored",
    "largest_error_before_alert_m",
    "hazardous",
    "warned",
)
"""Columns of scores and of events that figures rest on."""


def _can_rank(row: LeaderboardRow) -> bool:
    return row.ranked is not None and not row.apart and not row.baseline


def _key(row: LeaderboardRow) -> tuple[bool, float, float]:
    """What rows are ordered by, the best least."""
    shown = row.shown
    share = shown.detected / shown.attacks if shown.attacks else 0.0
    mean_s = shown.restricted_mean_ttfd_s
    return row.exceeds_target, -share, float("inf") if mean_s is None else mean_s


_HOW = ("calibrated", "raised only", "no clean score", "no session", "uncalibratable")
"""From the best to the worst."""


def _worst(how: pd.Series) -> str:
    return max(how, key=_HOW.index, default="published")


def _number(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)
