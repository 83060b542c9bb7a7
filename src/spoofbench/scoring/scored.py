"""A scored results folder as columns, and the material that each table of its leaderboard rests on.

All rows of a table are judged on its support: every attack window whose recording and variant hold
what the input class looks at, whatever the rows did there. False alerts are counted on the
recordings of the same sensor classes, as they are.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from spoofbench.detector import inputs_of
from spoofbench.errors import ResultsError
from spoofbench.results import Provenance, read_run, read_table, read_task_table
from spoofbench.scoring.figures import Columns, Figures, figures
from spoofbench.scoring.operating import CALIBRATION_SCHEMA, TRANSFER_SCHEMA
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA, Point

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
    "warned",
)
_ERROR_BEFORE = "largest_error_before_alert_m"
"""Columns of scores and of events that figures rest on."""

Place = tuple[str, str, str]
"""Detector, operating point and role."""


@dataclass(frozen=True, slots=True, eq=False)
class JudgedMaterial:
    """What the rows of one provenance and input class are judged on.

    Attributes:
        provenance, input_class: of the attacks, and of the detectors.
        point: operating point at which the rows are ranked.
        detectors: names of the rows, in the order of the suite.
        support: the first task of each attacked variant that counts.
        left_out: of those that would, but whose position is fused with inertial sensors.
        clean: of each variant on which false alerts are counted.
        faced: the attack intervals of the support as columns ``(n,)``: ``interval`` and
            ``variant`` by number, ``attack``, ``session`` as codes, ``start_ns`` and ``length_s``.
        sensor_classes: of the recordings.
    """

    provenance: Provenance
    input_class: str
    point: Point
    detectors: tuple[str, ...]
    support: pd.DataFrame
    left_out: pd.DataFrame
    clean: pd.DataFrame
    faced: Columns
    sensor_classes: tuple[str, ...]


class ScoredFolder:
    """Reads a folder: tasks as a data frame, scores and events as columns of each detector at each
    operating point.

    Raises:
        ResultsError: a file of the folder is missing or damaged, or the folder has no tasks.
    """

    def __init__(self, folder: Path) -> None:
        table = read_task_table(folder)
        if not len(table):
            raise ResultsError(f"{folder} has no tasks to rank; run a suite into it")
        self.run = read_run(folder)
        self.suite = self.run["suite"]
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
        self.tasks["variant"] = self.variants.get_indexer(self.tasks["variant_id"])
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
        # of the attack alone: what one detector's row says holds for those without a result
        self.harm = {
            name: events.groupby("interval")[name]
            .max()
            .astype(float)
            .reindex(range(len(self.intervals) + 1))
            .to_numpy()
            for name in ("hazardous", "largest_error_m")
        }
        self.calibrated = {
            str(detector): set(some["variant"][some["point"] == "calibrated"])
            for detector, some in scores.groupby("detector", sort=False)
        }
        self.scores, self.events = self._split(scores), self._split(events)

    def _split(self, rows: pd.DataFrame) -> dict[Place, Columns]:
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

    def materials(self) -> Iterator[JudgedMaterial]:
        """Yield what each table rests on, by provenance, then input class."""
        for provenance in get_args(Provenance):
            for input_class in self.input_classes:
                found = self._material(provenance, input_class)
                if found is not None:
                    yield found

    def _material(self, provenance: Provenance, input_class: str) -> JudgedMaterial | None:
        judged = self.judged
        own = judged[judged["provenance"] == provenance]
        holding = self._variants(own[own["attack"].notna()], input_class)
        compared = self._is_compared(holding, input_class)
        support = holding[compared]
        if not len(support) and (judged["attack"].notna().any() or not len(own)):
            return None  # but for suites without any attack
        among = support if len(support) else self._variants(own, input_class)
        classes = tuple(sorted(among["sensor_class"].unique()))
        clean = self._clean(provenance, input_class, classes)
        of_table = {*support["variant"], *clean["variant"]}
        is_calibrated = set().union(*self.calibrated.values()) & of_table
        present = set(judged["detector"][judged["variant"].isin(among["variant"])].unique())
        wanted = set(input_class.split("+"))
        return JudgedMaterial(
            provenance=provenance,
            input_class=input_class,
            point="calibrated" if is_calibrated else "published",
            detectors=tuple(
                str(name)
                for name, about in self.detectors.iterrows()
                if name in present
                and (
                    about["input_class"] == input_class
                    or (about["baseline"] and set(about["input_class"].split("+")) < wanted)
                )
            ),
            support=support,
            left_out=holding[~compared],
            clean=clean,
            faced=self._faced(support),
            sensor_classes=classes,
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
    def attacks(self) -> list[str]:
        """In the order of the suite."""
        return list(self.judged["attack"].dropna().unique())

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

    def _faced(self, support: pd.DataFrame) -> dict[str, Any]:
        """The attack intervals of the support as columns; the window where nobody was scored."""
        seen = self.intervals[self.intervals["variant"].isin(support["variant"])]
        unseen = support[~support["variant"].isin(seen["variant"])]
        unseen = unseen[unseen["window_start_ns"].notna()]  # nobody knows where others are attacked
        length_s = (unseen["window_end_ns"] - unseen["window_start_ns"]) / 1e9
        nobody = np.full(len(unseen), len(self.intervals))
        return {
            "interval": np.append(seen.index.to_numpy(), nobody).astype(int),
            "variant": np.append(seen["variant"], unseen["variant"]),
            "attack": np.append(seen["attack"], unseen["attack"]),
            "session": self.sessions.get_indexer(np.append(seen["session"], unseen["session"])),
            "start_ns": np.append(seen["start_ns"], unseen["window_start_ns"]).astype(np.int64),
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

    def hours(self, clean: pd.DataFrame) -> float:
        """Return the most that any detector was available of these recordings, summed."""
        most = np.zeros(len(self.variants))
        for (_, point, _), scores in self.scores.items():
            if point == "published":
                hours_h = np.nan_to_num(scores["available_clean_h"])
                np.maximum.at(most, scores["variant"].astype(int), hours_h)
        return float(most[clean["variant"]].sum())

    def met(self, place: Place, faced: Columns) -> dict[str, Any]:
        """Return what became of each interval that is faced, columns ``(n,)``, NaN where there is
        no result.
        """
        columns = {
            "session": faced["session"],
            "length_s": faced["length_s"],
            "hazardous": self.harm["hazardous"][faced["interval"]],
        }
        error_m = self.harm["largest_error_m"][faced["interval"]]
        events = self.events.get(place)
        if events is None:
            unknown = np.full(faced["interval"].size, np.nan)
            return columns | dict.fromkeys(_MET, unknown) | {_ERROR_BEFORE: error_m}
        row = np.full(len(self.intervals) + 1, events["interval"].size)
        row[events["interval"].astype(int)] = np.arange(events["interval"].size)
        taken = row[faced["interval"]]
        found = {name: np.append(events[name], np.nan)[taken] for name in _MET}
        has_result = taken < events["interval"].size
        return (
            columns | found | {_ERROR_BEFORE: np.where(has_result, found[_ERROR_BEFORE], error_m)}
        )

    def has_point(self, detector: str, point: Point, faced: Columns) -> bool:
        """Whether a detector has an operating point wherever it is judged on what is faced, columns
        ``(n,)``.
        """
        if point == "published":
            return True
        published = self.scores.get((detector, "published", "judged"))
        own = set() if published is None else {*published["variant"]} & {*faced["variant"]}
        return (detector, point, "judged") in self.scores and own <= self.calibrated[detector]

    def figures(
        self, detector: str, point: Point, faced: Columns, clean: pd.DataFrame
    ) -> Figures | None:
        """Return the figures of a detector over the intervals that are faced, columns ``(n,)``, and
        clean variants; None where it has none at this operating point.
        """
        if not self.has_point(detector, point, faced):
            return None
        scores = self.scores.get((detector, point, "judged"))
        names = (*_COUNTED, "session")
        if scores is None:
            return figures(
                {name: np.empty(0) for name in names}, self.met((detector, point, "judged"), faced)
            )
        rows = np.isin(scores["variant"], clean["variant"])
        counted = {name: scores[name][rows] for name in names}
        return figures(counted, self.met((detector, point, "judged"), faced))
