"""What the page carries of each run: its labels, figures, decisions, and the track it was on.

Arrays are little-endian integers in base64, each stored once. They are rounded, as the page states:
times to 1 ms, positions to 0.1 m, scores to 0.0005 up to 1 and to 0.12 % above. Scores are over the
threshold that the leaderboard ranks at, so that an alert is above 1; rounding never moves one over.
"""

import base64
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spoofbench.arrays import Bools, Floats, Indices, Ints, Times
from spoofbench.decisions import Outcomes
from spoofbench.detector import Decisions
from spoofbench.formatting import (
    NONE,
    between,
    date_time,
    percent,
    rate,
    seconds,
    share_percent,
)
from spoofbench.recording import Interval
from spoofbench.results import (
    Task,
    Truth,
    has_truth,
    read_table,
    read_truth,
)
from spoofbench.scoring.grid import GUARD_S
from spoofbench.scoring.score import EVENT_SCHEMA, SCORE_SCHEMA

CLEAN = "none (clean)"
"""What the page calls the attack of an unattacked task."""

ABSENT_DM = np.iinfo(np.int32).min
UNAVAILABLE = np.iinfo(np.int16).min
INFINITE = np.iinfo(np.int16).max
STEPS = 2000
"""Steps of the score axis per unit, see :func:`pack_scores`."""

_DECISION_BYTES = 6_000_000
"""What the decisions of all runs may take, each an equal part; a run that needs more is thinned."""

_TIMED_BYTES, _UNTIMED_BYTES = 8, 8 / 3
"""A decision in base64, with a time of its own (4 + 2 bytes) and at the variant's epochs (2 bytes).
"""

_FIGURES = (
    "task_id",
    "point",
    "factor",
    "far_per_hour",
    "far_per_hour_lo",
    "far_per_hour_hi",
    "far_epoch",
    "detection_pct",
    "detection_pct_available",
    "placebo_pct",
    "detected",
    "placebo_detected",
    "ttfd_s",
    "availability",
)
"""Columns of scores.parquet that a run shows, at the operating point that is ranked."""

_EVENT_FIGURES = (
    "task_id",
    "point",
    "length_s",
    "position_error_at_detection_m",
    "largest_error_before_alert_m",
)
"""Columns of events.parquet that a run shows of its first attack interval."""


@dataclass(slots=True)
class ArrayPool:
    """Arrays in base64, equal ones once: variants of a recording share epochs and clean tracks."""

    items: list[str] = field(default_factory=list)
    _indices: dict[str, int] = field(default_factory=dict)

    def add(self, values: ArrayLike, dtype: str) -> int:
        """Return the index in ``items`` of these values, ``(n,)``, as little-endian ``dtype``."""
        text = base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode()
        index = self._indices.setdefault(text, len(self.items))
        if index == len(self.items):
            self.items.append(text)
        return index


def run_data(folder: Path, tasks: Sequence[Task], best: str) -> Iterator[str]:
    """Yield the page's data on every run as pieces of one JSON text that HTML can hold.

    A variant's truth is read once, and then the decisions of its tasks.

    Args:
        folder: the results folder.
        tasks: of the folder, in its order.
        best: the detector with which the page opens, under attack.

    Raises:
        ResultsError: the folder lacks a file or a file is damaged.
    """
    figures = _ranked_figures(folder)
    outcomes = Outcomes(folder)
    of_variant: dict[str, list[int]] = {}
    for index, task in enumerate(tasks):
        of_variant.setdefault(task.variant_id, []).append(index)
    pool, planes = ArrayPool(), dict[str, TangentPlane]()
    variants, runs = [], [""] * len(tasks)
    for number, (variant_id, indices) in enumerate(of_variant.items()):
        truth = read_truth(folder, variant_id) if has_truth(folder, variant_id) else None
        first = tasks[indices[0]]
        if truth is not None and first.recording not in planes:
            plane = TangentPlane.at_start(truth)
            planes |= {first.recording: plane} if plane else {}
        variants.append(_json(_variant(first, truth, planes.get(first.recording), pool)))
        for index in indices:
            task = tasks[index]
            about = figures.get(task.task_id, {})
            decisions = _decisions(outcomes, task, about.get("factor"))
            trace = _trace(decisions, truth, pool, _DECISION_BYTES / len(tasks))
            runs[index] = _json(_run(task, number, about, trace))
    opened = (i for i, task in enumerate(tasks) if task.attack and task.detector == best)
    yield '{"arrays":["'
    yield '","'.join(pool.items)
    yield f'"],"first":{next(opened, 0)},"runs":['
    yield ",".join(runs)
    yield f'],"steps":{STEPS},"variants":[{",".join(variants)}]}}'


def _ranked_figures(folder: Path) -> dict[str, dict[str, Any]]:
    """The scores of each task, and those of its first attack interval, at the point that is ranked:
    the first row of a task in either table.
    """
    figures: dict[str, dict[str, Any]] = {}
    for name, schema, columns in (
        ("scores", SCORE_SCHEMA, _FIGURES),
        ("events", EVENT_SCHEMA, _EVENT_FIGURES),
    ):
        rows = read_table(folder / f"{name}.parquet", schema).select(columns).to_pylist()
        first = {row["task_id"]: row for row in reversed(rows)}
        for task_id, row in first.items():
            figures.setdefault(task_id, {}).update(row)
    return figures


_ROLES = {"judged": "", "calibration": " (calibration)", "family left out": " (family left out)"}


def labels(task: Task) -> dict[str, str]:
    """Return the labels by which the page finds a run."""
    return {
        "detector": task.detector + _ROLES[task.role],
        "recording": task.recording,
        "attack": task.attack or CLEAN,
        "window": NONE if task.window is None else str(task.window),
    }


def _json(value: Any) -> str:
    """JSON that may stand in a script element: nothing in it ends one or begins another."""
    text = json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))
    for letter in "<>&'":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """East-north plane tangent to the WGS 84 ellipsoid at a point."""

    lat_deg: float
    lon_deg: float

    @classmethod
    def at_start(cls, truth: Truth) -> "TangentPlane | None":
        """Return the plane at the first unattacked position, None where there is no position."""
        lat_deg, lon_deg = _unattacked(truth)
        known = np.flatnonzero(~np.isnan(lat_deg) & ~np.isnan(lon_deg))
        return cls(float(lat_deg[known[0]]), float(lon_deg[known[0]])) if known.size else None

    def east_north_dm(self, lat_deg: Floats, lon_deg: Floats) -> NDArray[np.int32]:
        """Return east and north in decimetres, ``ABSENT_DM`` where there is no position.

        Args:
            lat_deg, lon_deg: positions, shape ``(n,)``.

        Returns:
            Shape ``(2, n)``.
        """
        import pymap3d

        east_m, north_m, _ = pymap3d.geodetic2enu(
            lat_deg, lon_deg, 0.0, self.lat_deg, self.lon_deg, 0.0
        )
        plane_dm = np.rint(10 * np.array([east_m, north_m]))
        absent = np.isnan(plane_dm).any(0)
        return np.where(absent, ABSENT_DM, np.nan_to_num(plane_dm)).astype(np.int32)


def _unattacked(truth: Truth) -> tuple[Floats, Floats]:
    """Latitude and longitude without attack; of a really attacked recording, which has no other,
    those outside its attacks.
    """
    if not np.isnan(truth.clean_lat_deg).all():
        return truth.clean_lat_deg, truth.clean_lon_deg
    outside = [np.where(truth.spoofed, np.nan, deg) for deg in (truth.lat_deg, truth.lon_deg)]
    return outside[0], outside[1]


def _variant(
    task: Task, truth: Truth | None, plane: TangentPlane | None, pool: ArrayPool
) -> dict[str, Any]:
    name = {key: text for key, text in labels(task).items() if key != "detector"}
    if truth is None or not truth.time_ns.size:
        empty = pool.add([], "<i4")
        return name | {"epochs": empty, "clean": empty, "attacked": [], "intervals": []}
    start_ns = int(truth.time_ns[0])
    plane = plane or TangentPlane(0.0, 0.0)
    epochs = pool.add(milliseconds(truth.time_ns, start_ns), "<i4")
    clean = pool.add(plane.east_north_dm(*_unattacked(truth)), "<i4")
    attacked = []
    for interval in truth.intervals:
        rows = np.flatnonzero(interval.covers(truth.time_ns))
        if rows.size:
            moved = plane.east_north_dm(truth.lat_deg[rows], truth.lon_deg[rows])
            attacked.append({"first": int(rows[0]), "track": pool.add(moved, "<i4")})
    return name | {
        "epochs": epochs,
        "clean": clean,
        "attacked": attacked,
        "intervals": [_seconds_since(start_ns, interval) for interval in truth.intervals],
        "start": date_time(start_ns),
    }


def _decisions(outcomes: Outcomes, task: Task, factor: float | None) -> Decisions | None:
    """The decisions of a task with scores over this factor, None where there are none.

    A quotient may round onto 1 or over it: then the score decides.
    """
    outcome = outcomes.of(task.recording).get(task.task_id)
    made = None if outcome is None else outcome.decisions
    if made is None or factor is None:
        return made
    score = made.score / factor
    score = np.where(
        made.score > factor, np.maximum(score, np.nextafter(1, 2)), np.minimum(score, 1)
    )
    return Decisions(made.time_ns, score, made.available)


def _trace(
    decisions: Decisions | None, truth: Truth | None, pool: ArrayPool, max_bytes: float
) -> dict[str, int] | None:
    """What is drawn of a run's decisions, in about so many bytes; None where there are none."""
    if decisions is None or truth is None or not truth.time_ns.size:
        return None
    n = decisions.time_ns.size
    is_at_epochs = np.array_equal(decisions.time_ns, truth.time_ns)
    rows = (
        np.arange(n)
        if is_at_epochs and n * _UNTIMED_BYTES <= max_bytes
        else thinned(decisions, max(200, int(max_bytes / _TIMED_BYTES)))
    )
    return {
        "time": pool.add(milliseconds(decisions.time_ns[rows], int(truth.time_ns[0])), "<i4"),
        "score": pool.add(pack_scores(decisions.score[rows], decisions.available[rows]), "<i2"),
        "rows": n,
    }


def milliseconds(time_ns: Times, start_ns: int) -> Ints:
    """Return times since the start, to the nearest millisecond, shape ``(n,)``."""
    return (time_ns - start_ns + 500_000) // 1_000_000


def _seconds_since(start_ns: int, interval: Interval) -> tuple[float, float]:
    return (interval.start_ns - start_ns) / 1e9, (interval.end_ns - start_ns) / 1e9


def thinned(decisions: Decisions, limit: int) -> Indices:
    """Return the rows to draw: all, or about ``limit`` of them, shape ``(k,)``.

    Of each of ``limit // 4`` equal stretches of rows the lowest score, the highest, and the first
    and last unavailable row stay. The highest stays, so a stretch with an alert keeps one.
    """
    n = decisions.time_ns.size
    if n <= limit:
        return np.arange(n)
    count = max(limit // 4, 1)
    short, longer = divmod(n, count)  # as many stretches have one row more
    middle = longer * (short + 1)
    kept = [np.array([0, n - 1])]
    for start, end, length in ((0, middle, short + 1), (middle, n, short)):
        score, available = (
            values[start:end].reshape(-1, length)
            for values in (decisions.score, decisions.available)
        )
        firsts = np.arange(start, end, length)
        lowest = np.argmin(np.where(available, score, np.inf), axis=1)
        highest = np.argmax(np.where(available, score, -np.inf), axis=1)
        seen = np.argmax(available, axis=1)  # where all scores of a stretch are infinite
        for row in (lowest, highest):
            usable = available[np.arange(row.size), row]
            kept.append((firsts + np.where(usable, row, seen))[available.any(axis=1)])
        unseen = ~available.all(axis=1)
        kept.append((firsts + np.argmin(available, axis=1))[unseen])
        kept.append((firsts + length - 1 - np.argmin(available[:, ::-1], axis=1))[unseen])
    return np.unique(np.concatenate(kept))


def pack_scores(score: Floats, available: Bools) -> NDArray[np.int16]:
    """Return scores on an axis linear up to 1 and logarithmic above, in steps of 1 / ``STEPS``.

    ``y = s`` for ``|s| <= 1``, else ``sign(s) (1 + log10 |s|)``; +inf is ``INFINITE``, unavailable
    ``UNAVAILABLE``. A score above 1 stays above, one at or below 1 stays there. All arrays have
    shape ``(n,)``.
    """
    known = np.where(available, score, 0.0)
    size = np.abs(known)
    y = np.where(size > 1, 1 + np.log10(np.maximum(size, 1)), size) * np.sign(known)
    steps = np.rint(np.clip(y * STEPS, UNAVAILABLE + 1, INFINITE - 1))
    steps = np.where(score > 1, np.maximum(steps, STEPS + 1), np.minimum(steps, STEPS))
    steps = np.where(np.isposinf(score), INFINITE, steps)
    return np.where(available, steps, UNAVAILABLE).astype(np.int16)


def _run(
    task: Task, variant: int, figures: Mapping[str, Any], trace: dict[str, int] | None
) -> dict[str, Any]:
    name = labels(task)["detector"]
    return {
        "variant": variant,
        "detector": name,
        "status": task.status,
        "reason": task.reason,
        "guard_s": max(GUARD_S, task.memory_s),
        "facts": _facts(task, figures),
        "summary": f"Score over time of {name} on {task.attack or CLEAN}",
        "trace": trace,
    }


def _facts(task: Task, figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Names and texts beside a run's plots: false alerts where it counts them, detection where it
    is under attack.
    """

    def text(form: Callable[[float | None], str], name: str, unit: str) -> str:
        value = form(figures.get(name))
        return value if value == NONE else f"{value} {unit}"

    facts: list[tuple[str, str]] = []
    if task.attack is None or task.provenance == "real attack":
        interval = between(
            rate(figures.get("far_per_hour_lo")), rate(figures.get("far_per_hour_hi"))
        )
        facts += [
            ("False alerts", text(rate, "far_per_hour", f"per hour (95 %: {interval})")),
            ("Alerted share of available clean epochs", text(share_percent, "far_epoch", "%")),
        ]
    if task.attack is not None:
        facts += [
            ("Attack", _outcome(figures)),
            ("Same window without attack", _placebo(figures)),
            ("Alerted share of spoofed epochs", text(percent, "detection_pct", "%")),
            ("The same without attack", text(percent, "placebo_pct", "%")),
            ("Alerted share where available", text(percent, "detection_pct_available", "%")),
            ("Position error at detection", text(rate, "position_error_at_detection_m", "m")),
            ("Largest error before alert", text(rate, "largest_error_before_alert_m", "m")),
            ("Attack parameters", _parameters(task.attack_parameters)),
        ]
    return [
        *facts,
        ("Availability", text(share_percent, "availability", "%")),
        ("Threshold", _threshold(figures)),
        ("Detector parameters", _parameters(task.parameters)),
        ("Plugin", f"{task.plugin} from {task.plugin_distribution} {task.plugin_version}"),
        ("Task", task.task_id),
    ]


def _outcome(figures: Mapping[str, Any]) -> str:
    match figures.get("detected"):
        case True:
            return f"detected after {seconds(figures['ttfd_s'])} s"
        case False:
            return f"missed in {seconds(figures.get('length_s'))} s"
        case _:
            return NONE


def _placebo(figures: Mapping[str, Any]) -> str:
    match figures.get("placebo_detected"):
        case True:
            return "an alert begins as well"
        case False:
            return "no alert begins"
        case _:
            return NONE


def _threshold(figures: Mapping[str, Any]) -> str:
    factor = figures.get("factor")
    if factor is None:
        return NONE
    if figures["point"] == "published":
        return "as published"
    return f"{factor:.4g} times the published one"


def _parameters(text: str | None) -> str:
    """Return ``delay_s = 60.0, ...`` of a JSON object, other text as it is."""
    if text is None:
        return NONE
    try:
        values = json.loads(text)
    except ValueError:
        return text
    if not isinstance(values, dict):
        return text
    return ", ".join(f"{name} = {json.dumps(value)}" for name, value in values.items()) or NONE
