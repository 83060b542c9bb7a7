"""What differs between two scored results folders, A and B: figures, B - A, and what changed.

Detectors are compared over the cells that both folders have: attack intervals of the support, and
recordings on which false alerts are counted. A cell is known by its names (recording, attack,
window), because its digest changes with whatever decides the result; what is behind a name and has
changed, such as a recording's digest, is said. Differences are paired by session.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from spoofbench.arrays import Floats, Ints
from spoofbench.errors import ResultsError
from spoofbench.results import Provenance
from spoofbench.scoring.changes import Change, changes
from spoofbench.scoring.comparison import LEVEL, compare_with_first, holm
from spoofbench.scoring.score import Point
from spoofbench.scoring.scored import JudgedMaterial, ScoredFolder
from spoofbench.scoring.statistics import session_means, survival_curve


@dataclass(frozen=True, slots=True)
class FigureDifference:
    """One figure in both folders; unknown is None.

    Attributes:
        a, b: over the sessions in which both folders know it.
        difference: b - a.
        lo, hi: its 95 % interval; None below 5 sessions, and for rates, which have no upper bound.
        p: of the sign-flip test, adjusted for the detectors of the table (Holm).
        told_apart: whether p is at most 0.05.
        sessions: in which both folders know it.
    """

    a: float | None
    b: float | None
    difference: float | None
    lo: float | None
    hi: float | None
    p: float | None
    told_apart: bool
    sessions: int


@dataclass(frozen=True, slots=True)
class DetectorDifferences:
    """One detector in both folders.

    Attributes:
        detector: name in the suites.
        far_per_hour: alarm episodes per available clean hour.
        detected_share: attack intervals detected, the mean over sessions of their shares.
        restricted_mean_ttfd_s: mean time to first detection up to the longest attack, the mean over
            sessions of their restricted means.
    """

    detector: str
    far_per_hour: FigureDifference
    detected_share: FigureDifference
    restricted_mean_ttfd_s: FigureDifference


@dataclass(frozen=True, slots=True)
class Shared:
    """How many both folders have, and how many only one of them has."""

    both: int
    only_a: int
    only_b: int


@dataclass(frozen=True, slots=True)
class TableDifferences:
    """The detectors of one provenance and input class.

    Attributes:
        provenance, input_class: as in the leaderboard.
        point: ``calibrated`` where the table is in both folders, else ``published``.
        rows: by name.
        windows: attack intervals.
        moved: of the windows that both have, those that begin elsewhere or are longer or shorter.
        recordings: on which false alerts are counted.
        detectors: of the table.
        sessions: of the windows that both have.
    """

    provenance: Provenance
    input_class: str
    point: Point
    rows: tuple[DetectorDifferences, ...]
    windows: Shared
    moved: int
    recordings: Shared
    detectors: Shared
    sessions: int


@dataclass(frozen=True, slots=True)
class Differences:
    """What differs between two results folders.

    Attributes:
        a, b: the folders.
        tables: of the leaderboards, that have cells and detectors in common.
        only_a, only_b: provenance and input class of the others.
        changes: by subject and name.
    """

    a: str
    b: str
    tables: tuple[TableDifferences, ...]
    only_a: tuple[tuple[Provenance, str], ...]
    only_b: tuple[tuple[Provenance, str], ...]
    changes: tuple[Change, ...]


def differences(a: Path, b: Path) -> Differences:
    """Return what differs between two scored results folders.

    Raises:
        ResultsError: a file of a folder is missing or damaged, or the folders share nothing.
    """
    folders = ScoredFolder(a), ScoredFolder(b)
    in_a, in_b = (
        {(each.provenance, each.input_class): _Side(folder, each) for each in folder.materials()}
        for folder in folders
    )
    pairs = {key: _Pair(in_a[key], in_b[key]) for key in sorted(in_a.keys() & in_b.keys())}
    pairs = {key: pair for key, pair in pairs.items() if pair.is_comparable}
    if not pairs:
        raise ResultsError(
            f"{str(a)!r} and {str(b)!r} cannot be compared: no detector is judged on a window or "
            "recording that both have"
        )
    return Differences(
        a=str(a),
        b=str(b),
        tables=tuple(pair.table() for pair in pairs.values()),
        only_a=tuple(sorted(in_a.keys() - pairs.keys())),
        only_b=tuple(sorted(in_b.keys() - pairs.keys())),
        changes=changes(*folders),
    )


class _Side:
    """What a table of one folder rests on, by the names of its cells."""

    def __init__(self, folder: ScoredFolder, material: JudgedMaterial) -> None:
        self.folder, self.material = folder, material
        faced = material.faced
        about = material.support.set_index("variant")
        windows = about.loc[faced["variant"], ["recording", "attack", "window"]].fillna(
            {"window": -1}
        )
        windows["start_ns"] = faced["start_ns"]
        by_variant = windows.groupby(level=0)["start_ns"]
        windows["interval"] = by_variant.rank("first").astype(int)
        self.windows = pd.MultiIndex.from_frame(windows.drop(columns="start_ns"))
        clean = material.clean[["recording", "attack"]].fillna({"attack": ""})
        self.recordings = pd.MultiIndex.from_frame(clean)

    def window_sessions(self, rows: Ints) -> list[str]:
        return list(self.folder.sessions[self.material.faced["session"][rows]])

    def episodes(self, detector: str, point: Point, rows: Ints) -> tuple[Floats, Floats]:
        """Return episodes and available hours of these rows of the clean recordings, ``(n,)`` each;
        none where there is no result.
        """
        scores = self.folder.scores.get((detector, point, "judged"))
        wanted = self.material.clean["variant"].iloc[rows]
        found = np.zeros((2, len(self.folder.variants)))
        if scores is not None:
            for values, name in zip(found, ("episodes", "available_clean_h"), strict=True):
                values[scores["variant"].astype(int)] = np.nan_to_num(scores[name])
        episodes, hours = found[:, wanted]
        return episodes, hours


class _Pair:
    """A table of both folders, over the cells that both have."""

    def __init__(self, a: _Side, b: _Side) -> None:
        self.sides = a, b
        points = {side.material.point for side in self.sides}
        self.point: Point = "calibrated" if points == {"calibrated"} else "published"
        self.detectors = sorted({*a.material.detectors} & {*b.material.detectors})
        self.windows = a.windows.intersection(b.windows).sort_values()
        self.recordings = a.recordings.intersection(b.recordings).sort_values()
        self.faced_rows = [side.windows.get_indexer(self.windows) for side in self.sides]
        self.clean_rows = [side.recordings.get_indexer(self.recordings) for side in self.sides]
        self.faced = [
            {name: values[rows] for name, values in side.material.faced.items()}
            for side, rows in zip(self.sides, self.faced_rows, strict=True)
        ]
        self.window_sessions = _sessions(
            *(
                side.window_sessions(rows)
                for side, rows in zip(self.sides, self.faced_rows, strict=True)
            )
        )
        self.recording_sessions = _sessions(
            *(
                list(side.material.clean["session"].iloc[rows])
                for side, rows in zip(self.sides, self.clean_rows, strict=True)
            )
        )

    @property
    def is_comparable(self) -> bool:
        return bool(self.detectors) and bool(len(self.windows) or len(self.recordings))

    def table(self) -> TableDifferences:
        a, b = self.sides
        figures = {
            name: _adjusted([find(detector) for detector in self.detectors])
            for name, find in (
                ("far_per_hour", self._far_per_hour),
                ("detected_share", self._detected_share),
                ("restricted_mean_ttfd_s", self._restricted_mean_ttfd_s),
            )
        }
        return TableDifferences(
            provenance=a.material.provenance,
            input_class=a.material.input_class,
            point=self.point,
            rows=tuple(
                DetectorDifferences(name, **{key: found[row] for key, found in figures.items()})
                for row, name in enumerate(self.detectors)
            ),
            windows=_shared(a.windows, b.windows),
            moved=int(self._moved().sum()),
            recordings=_shared(a.recordings, b.recordings),
            detectors=_shared(pd.Index(a.material.detectors), pd.Index(b.material.detectors)),
            sessions=np.unique(self.window_sessions).size,
        )

    def _moved(self) -> Any:
        a, b = self.faced
        return (a["start_ns"] != b["start_ns"]) | (a["length_s"] != b["length_s"])

    def _has_point(self, detector: str) -> bool:
        return all(
            side.folder.has_point(detector, self.point, faced)
            for side, faced in zip(self.sides, self.faced, strict=True)
        )

    def _far_per_hour(self, detector: str) -> FigureDifference:
        """The pooled rates; each session weighs as much of their difference as it makes."""
        if not self._has_point(detector):
            return _UNKNOWN
        sessions, owner = np.unique(self.recording_sessions, return_inverse=True)
        episodes, hours = (
            np.array([np.bincount(owner, each, sessions.size) for each in some])
            for some in zip(
                *(
                    side.episodes(detector, self.point, rows)
                    for side, rows in zip(self.sides, self.clean_rows, strict=True)
                ),
                strict=True,
            )
        )
        known = (hours > 0).all(axis=0)
        episodes, hours = episodes[:, known], hours[:, known]
        if not known.any():
            return _UNKNOWN
        return _difference(known.sum() * episodes / hours.sum(axis=1, keepdims=True), None)

    def _detected_share(self, detector: str) -> FigureDifference:
        if not len(self.windows) or not self._has_point(detector):
            return _UNKNOWN
        sessions = np.unique(self.window_sessions)
        shares = [
            session_means(met["detected"] == 1, self.window_sessions, sessions)
            for met in self._met(detector)
        ]
        return _difference(np.array(shares), 1.0)

    def _restricted_mean_ttfd_s(self, detector: str) -> FigureDifference:
        if not len(self.windows) or not self._has_point(detector):
            return _UNKNOWN
        longest_s = max(float(faced["length_s"].max()) for faced in self.faced)
        means_s = np.array(
            [
                [
                    _restricted_mean_s(met, self.window_sessions == session, longest_s)
                    for session in np.unique(self.window_sessions)
                ]
                for met in self._met(detector)
            ]
        )
        return _difference(means_s, longest_s)

    def _met(self, detector: str) -> Iterator[Mapping[str, Any]]:
        for side, faced in zip(self.sides, self.faced, strict=True):
            yield side.folder.met((detector, self.point, "judged"), faced)


_UNKNOWN = FigureDifference(None, None, None, None, None, None, told_apart=False, sessions=0)


def _restricted_mean_s(met: Mapping[str, Any], rows: Any, longest_s: float) -> float:
    hits = met["detected"][rows] == 1
    curve = survival_curve(np.where(hits, met["ttfd_s"][rows], met["length_s"][rows]), hits)
    return np.nan if curve is None else curve.restricted_mean_s(longest_s)


def _difference(values: Floats, largest: float | None) -> FigureDifference:
    """Compare a figure of A's sessions and of B's, shape ``(2, sessions)``."""
    (found,) = compare_with_first(values, largest)
    a, b = (float(mean) for mean in values.mean(axis=1))
    interval = found.difference
    return FigureDifference(
        a=a,
        b=b,
        difference=b - a,
        lo=None if interval is None else interval.lo,
        hi=None if interval is None else interval.hi,
        p=found.p,
        told_apart=found.told_apart,
        sessions=found.sessions,
    )


def _adjusted(found: list[FigureDifference]) -> list[FigureDifference]:
    """Adjust the p values for the number of detectors."""
    known = [each.p for each in found if each.p is not None]
    adjusted = iter(holm(known))
    return [
        each if each.p is None else replace(each, p=(p := next(adjusted)), told_apart=p <= LEVEL)
        for each in found
    ]


def _sessions(a: list[str], b: list[str]) -> Any:
    """Labels of the sessions of cells, ``(n,)``: of both folders, where they differ."""
    return np.array([" or ".join(sorted({*pair})) for pair in zip(a, b, strict=True)], str)


def _shared(a: pd.Index, b: pd.Index) -> Shared:
    both = len(a.intersection(b))
    return Shared(both, len(a) - both, len(b) - both)
