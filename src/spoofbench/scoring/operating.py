"""Operating points of a results folder: at which factor each detector is judged, and what it does
over a range of false-alert rates.

A threshold is fitted within a sensor class, on the unattacked recordings that neither it nor a
fitted state may not have seen; :mod:`.calibration` has the rule. ``calibration.parquet`` has a row
per detector, class and set of sessions held out; ``curves.parquet`` the operating curves, a row per
detector, class, provenance and target; ``transfer.parquet`` thresholds fitted on one class and
judged on another.
"""

import json
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from spoofbench.arrays import Floats
from spoofbench.results import Task, write_parquet
from spoofbench.scoring.calibration import (
    EpisodeCurve,
    Threshold,
    threshold,
    total,
)
from spoofbench.scoring.trace import Trace, Twin

TARGETS_PER_HOUR: Floats = np.geomspace(0.1, 100.0, 25)
"""False-alert rates of the operating curves."""

CALIBRATION_SCHEMA = pa.schema(
    [
        ("detector", pa.string()),
        ("sensor_class", pa.string()),
        ("held_out", pa.string()),
        ("left_out", pa.string()),
        ("fit_id", pa.string()),
        ("sessions", pa.int64()),
        ("hours", pa.float64()),
        ("allowed", pa.int64()),
        ("episodes", pa.int64()),
        ("factor", pa.float64()),
        ("how", pa.string()),
        ("largest_expected_per_hour", pa.float64()),
    ]
)

CURVE_SCHEMA = pa.schema(
    [
        ("detector", pa.string()),
        ("sensor_class", pa.string()),
        ("provenance", pa.string()),
        ("target_per_hour", pa.float64()),
        ("episodes", pa.int64()),
        ("clean_h", pa.float64()),
        ("detected", pa.int64()),
        ("placebo_detected", pa.int64()),
        ("attacks", pa.int64()),
        ("alerted_share", pa.float64()),
    ]
)

TRANSFER_SCHEMA = pa.schema(
    [
        ("detector", pa.string()),
        ("fitted_on", pa.string()),
        ("judged_on", pa.string()),
        ("factor", pa.float64()),
        ("episodes", pa.int64()),
        ("clean_h", pa.float64()),
        ("detected", pa.int64()),
        ("attacks", pa.int64()),
    ]
)


class Key(NamedTuple):
    """What one threshold is for."""

    detector: str
    sensor_class: str
    held_out: str
    left_out: str | None


def _carried(detector: str, fitted_on: str, judged_on: str) -> Key:
    return Key(detector, fitted_on, f"sessions of {judged_on}", None)


def _key(task: Task) -> Key:
    return Key(task.detector, task.sensor_class, task.held_out, task.left_out)


@dataclass(frozen=True, slots=True)
class _Clean:
    """What one unattacked recording says of thresholds."""

    task: Task
    curve: EpisodeCurve


class Thresholds:
    """The thresholds of a folder, from the episode curves of what calibrates."""

    def __init__(self, target_per_hour: float) -> None:
        self.target_per_hour = target_per_hour
        self._clean: dict[tuple[str, str], list[_Clean]] = {}
        self._curves: dict[Key, EpisodeCurve | None] = {}
        self._found: dict[Key, Threshold | None] = {}
        self._tasks: dict[Key, Task] = {}

    def add(self, trace: Trace, task: Task) -> None:
        """Take up what a detector decided on the part of a recording that calibrates."""
        start_ns, end_ns = task.calibration_start_ns or 0, task.calibration_end_ns or 0
        time_ns = trace.truth.time_ns
        within = (time_ns >= start_ns) & (time_ns < end_ns)
        curve = trace.episode_curve(within)
        self._clean.setdefault((task.detector, task.sensor_class), []).append(_Clean(task, curve))

    def factor(self, task: Task) -> float | None:
        """Return the factor that a task is judged at; None where no threshold was fitted for it."""
        key = _key(task)
        self._tasks.setdefault(key, task)
        found = self._threshold(key, is_fitted=task.fit_id is not None)
        return None if found is None else found.factor

    def curve(self, task: Task) -> EpisodeCurve | None:
        """Return the sum of the episode curves of what may calibrate for a task."""
        return self._curve(_key(task), is_fitted=task.fit_id is not None)

    def class_curve(
        self, detector: str, sensor_class: str, unseen: Set[str]
    ) -> EpisodeCurve | None:
        """Return that of all sessions of a class but those unseen; None where there is none, and
        where a recording has several: of a fitted detector, whose states differ in what was held
        out.
        """
        of_class = self._clean.get((detector, sensor_class), [])
        clean = [each for each in of_class if each.task.session not in unseen]
        if not clean or len({each.task.variant_id for each in clean}) < len(clean):
            return None
        return total(each.curve for each in clean)

    def _threshold(self, key: Key, *, is_fitted: bool) -> Threshold | None:
        if key not in self._found:
            curve = self._curve(key, is_fitted=is_fitted)
            self._found[key] = None if curve is None else threshold(curve, self.target_per_hour)
        return self._found[key]

    def _curve(self, key: Key, *, is_fitted: bool) -> EpisodeCurve | None:
        if key not in self._curves:
            used = list(self._used(key, is_fitted=is_fitted))
            self._curves[key] = total(each.curve for each in used) if used else None
        return self._curves[key]

    def _used(self, key: Key, *, is_fitted: bool) -> Iterator[_Clean]:
        held_out = set(json.loads(key.held_out))
        for each in self._clean.get((key.detector, key.sensor_class), []):
            task = each.task
            if is_fitted:
                if (task.held_out, task.left_out) == (key.held_out, key.left_out):
                    yield each
            elif task.session not in held_out:
                yield each

    def write(self, folder: Path) -> None:
        """Write ``calibration.parquet``."""
        rows = []
        for key, task in self._tasks.items():
            is_fitted = task.fit_id is not None
            found = self._threshold(key, is_fitted=is_fitted)
            if (task.detector, task.sensor_class) not in self._clean and not is_fitted:
                continue
            used = list(self._used(key, is_fitted=is_fitted))
            row: dict[str, Any] = {
                **key._asdict(),
                "fit_id": task.fit_id,
                "sessions": len({each.task.session for each in used}),
            }
            if found is None:
                row |= {"how": "no session"}
            else:
                row |= {
                    "hours": found.hours,
                    "allowed": found.allowed,
                    "episodes": found.episodes,
                    "factor": found.factor,
                    "how": found.how,
                    "largest_expected_per_hour": found.largest_expected_per_hour,
                }
            rows.append(row)
        write_parquet(
            folder / "calibration.parquet", pa.Table.from_pylist(rows, CALIBRATION_SCHEMA)
        )


@dataclass(slots=True)
class _Sum:
    """What a detector does at several factors, summed over tasks."""

    episodes: Any
    clean_h: float = 0.0
    detected: Any = 0
    placebo_detected: Any = 0
    attacks: int = 0
    alerted: Any = 0.0


@dataclass(slots=True)
class Curves:
    """Operating curves and transfer, as tasks are scored.

    Attributes:
        thresholds: of the folder.
        sessions: of each sensor class that is calibrated: between these, thresholds are carried,
            but for those from sessions that are judged.
        memory_cap_s: how long after an attack nothing is scored.
    """

    thresholds: Thresholds
    sessions: Mapping[str, Set[str]]
    memory_cap_s: float
    _factors: dict[Key, Floats | None] = field(default_factory=dict)
    _sums: dict[tuple[str, str, str], _Sum] = field(default_factory=dict)
    _transfer: dict[tuple[str, str, str], _Sum] = field(default_factory=dict)

    def add(self, task: Task, trace: Trace, twin: Twin | None) -> None:
        """Take up a task that is judged.

        Args:
            task: of the folder.
            trace: what its detector decided.
            twin: what it decided on the unattacked recording; None where that is the task's own,
                or there is none.
        """
        if task.role != "judged":
            return
        factors = self._factors_of(task)
        if factors is not None:
            key = (task.detector, task.sensor_class, task.provenance)
            self._take_up(self._sums.setdefault(key, _Sum(0)), task, trace, twin, factors)
        if task.sensor_class in self.sessions:
            for other in self.sessions:
                if other != task.sensor_class:
                    self._carry(task, trace, twin, other)

    def _factors_of(self, task: Task) -> Floats | None:
        key = _key(task)
        if key not in self._factors:
            curve = self.thresholds.curve(task)
            found = (
                []
                if curve is None
                else [threshold(curve, target).factor for target in TARGETS_PER_HOUR.tolist()]
            )
            known = bool(found) and None not in found
            self._factors[key] = np.array(found, float) if known else None
        return self._factors[key]

    def _carry(self, task: Task, trace: Trace, twin: Twin | None, other: str) -> None:
        key = _carried(task.detector, other, task.sensor_class)
        if key not in self._factors:
            unseen = self.sessions[task.sensor_class]
            curve = self.thresholds.class_curve(task.detector, other, unseen)
            found = curve and threshold(curve, self.thresholds.target_per_hour).factor
            self._factors[key] = None if found is None else np.array([found], float)
        factors = self._factors[key]
        if factors is not None:
            of = (task.detector, other, task.sensor_class)
            self._take_up(self._transfer.setdefault(of, _Sum(0)), task, trace, twin, factors)

    def _take_up(
        self, own: _Sum, task: Task, trace: Trace, twin: Twin | None, factors: Floats
    ) -> None:
        truth = trace.truth
        if task.attack is None or task.provenance == "real attack":
            counted = trace.clean(self.memory_cap_s) & (
                truth.time_ns >= (task.judged_start_ns or 0)
            )
            curve = trace.episode_curve(counted)
            own.episodes = own.episodes + np.array(
                [curve.episodes_at(factor) for factor in factors.tolist()]
            )
            own.clean_h += curve.hours
        for interval in truth.intervals:
            own.detected = own.detected + ~np.isnan(trace.detection_times_s(interval, factors))
            own.attacks += 1
            score = trace.score[interval.covers(truth.time_ns), np.newaxis]
            own.alerted = (
                own.alerted + (score > factors).mean(axis=0) if score.size else own.alerted
            )
            if twin is not None:
                placebo_s = twin.detection_times_s(interval, factors)
                own.placebo_detected = own.placebo_detected + ~np.isnan(placebo_s)

    def write(self, folder: Path) -> None:
        """Write ``curves.parquet`` and ``transfer.parquet``."""
        rows = [
            {
                "detector": detector,
                "sensor_class": sensor_class,
                "provenance": provenance,
                "target_per_hour": target,
                "episodes": _nth(each.episodes, number),
                "clean_h": each.clean_h,
                "detected": _nth(each.detected, number),
                "placebo_detected": _nth(each.placebo_detected, number),
                "attacks": each.attacks,
                "alerted_share": float(
                    np.broadcast_to(each.alerted, TARGETS_PER_HOUR.shape)[number]
                )
                / each.attacks
                if each.attacks
                else None,
            }
            for (detector, sensor_class, provenance), each in self._sums.items()
            for number, target in enumerate(TARGETS_PER_HOUR.tolist())
        ]
        write_parquet(folder / "curves.parquet", pa.Table.from_pylist(rows, CURVE_SCHEMA))
        carried = []
        for (detector, fitted_on, judged_on), each in self._transfer.items():
            factors = self._factors[_carried(detector, fitted_on, judged_on)]
            carried.append(
                {
                    "detector": detector,
                    "fitted_on": fitted_on,
                    "judged_on": judged_on,
                    "factor": None if factors is None else float(factors[0]),
                    "episodes": _nth(each.episodes, 0),
                    "clean_h": each.clean_h,
                    "detected": _nth(each.detected, 0),
                    "attacks": each.attacks,
                }
            )
        write_parquet(folder / "transfer.parquet", pa.Table.from_pylist(carried, TRANSFER_SCHEMA))


def _nth(values: Any, number: int) -> int:
    return int(np.atleast_1d(values)[min(number, np.size(values) - 1)])
