"""Results folders like those of runs: decisions and truth made up, scores computed from them. And
leaderboards made up as a whole.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import strategies as st

from spoofbench.decisions import OutcomeLog
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import (
    Provenance,
    Status,
    Task,
    TaskOutcome,
    Truth,
    write_run,
    write_tasks,
    write_truth,
)
from spoofbench.scoring.figures import Figures
from spoofbench.scoring.leaderboard import (
    AbsentDetector,
    BoardTable,
    Leaderboard,
    LeaderboardCell,
    LeaderboardRow,
    SeverityRow,
    TransferRow,
)
from spoofbench.scoring.score import score_folder
from spoofbench.scoring.severity import SeverityCurve

START_NS = 1_700_000_000_000_000_000
S = 1_000_000_000
LENGTH_S = 120

HOSTILE = "</script><img src=x onerror=\"document.title='owned'\">|`*"
"""Text that must reach no interpreter: HTML, JSON in HTML, Markdown tables, rich markup."""

Plan = Callable[[str, str | None], tuple[Status, str | None]]
"""Status and reason of a detector against an attack."""


def all_ok(detector: str, attack: str | None) -> tuple[Status, str | None]:
    return "ok", None


SUITE = {
    "name": "stand-in",
    "target_far_per_hour": 1.0,
    "memory_cap_s": 130.0,
    "alert_limit_m": 50.0,
    "time_to_alert_s": 10.0,
    "warm_up_s": None,
    "ranks_fused": [],
    "calibration": None,
}


def make_folder(
    folder: Path,
    detectors: Sequence[str],
    attacks: Sequence[str],
    epochs: int = 600,
    plan: Plan = all_ok,
    *,
    is_calibrated: bool = False,
    has_flight: bool = False,
    name: str = "stand-in",
    noise: float = 0.3,
    **about: Any,
) -> Path:
    """Write a results folder of one recording, three windows of each attack, and score it.

    Args:
        folder: to write.
        detectors, attacks: their names.
        epochs: of the recording.
        plan: what becomes of each task.
        is_calibrated: whether the first quarter sets thresholds and the rest is judged.
        has_flight: whether there is a really attacked recording, too.
        name: of the suite.
        noise: of the scores, their standard deviation without attack.
        about: further fields of every task.
    """
    material = [("drive", None, None)]
    material += [("drive", attack, window) for attack in attacks for window in (1, 2, 3)]
    material += [("flight", "as recorded", None)] if has_flight else []
    part = {"calibration_start_ns": START_NS, "calibration_end_ns": START_NS + epochs // 4 * S}
    tasks, outcomes = [], OutcomeLog(folder)
    for recording, attack, window in material:
        variant = _id("variant", recording, attack, window)
        truth = make_truth(epochs, attack, window)
        known: dict[str, Any] = {}
        if recording == "flight":
            nowhere = np.full(epochs, np.nan)
            truth = replace(
                truth, clean_lat_deg=nowhere, clean_lon_deg=nowhere, position_error_m=nowhere
            )
            known = {"session": "flight", "sensor_class": "airliner", "provenance": "real attack"}
        elif is_calibrated:
            known = {"judged_start_ns": part["calibration_end_ns"]}
            known |= part if attack is None else {}
        write_truth(folder, variant, truth)
        for index, detector in enumerate(detectors):
            status, reason = plan(detector, attack)
            task_id = _id(detector, variant)
            decisions = (
                make_decisions(truth, index, noise, _rng(task_id)) if status == "ok" else None
            )
            outcomes.add(task_id, TaskOutcome(status, reason, decisions))
            task = make_task(task_id, variant, detector, attack, window, truth)
            own = {"recording": recording, "status": status, "reason": reason}
            tasks.append(replace(task, **(own | known | about)))
    outcomes.sort(
        {
            recording: [task.task_id for task in tasks if task.recording == recording]
            for recording in dict.fromkeys(task.recording for task in tasks)
        }
    )
    write_tasks(folder, tasks)
    calibration = {"split": "first-part"} if is_calibrated else None
    write_run(
        folder,
        {
            "suite": SUITE | {"name": name, "calibration": calibration},
            "versions": {"spoofbench": "0.1.0", "numpy": "2.4.6"},
            name: [name],
        },
    )
    score_folder(folder)
    return folder


def make_truth(epochs: int, attack: str | None, window: int | None) -> Truth:
    """A winding drive; an attack drags the position off and lets go."""
    time_ns = START_NS + np.arange(epochs) * S
    angle = np.arange(epochs) / 90
    lat, lon = (
        39.7 + 0.01 * np.sin(angle) + 1e-6 * np.arange(epochs),
        -84.2 + 0.02 * np.cos(0.7 * angle),
    )
    intervals = ()
    moved = np.zeros(epochs)
    if attack is not None:
        first = epochs // 4 + 40 * (window or 0)
        intervals = (Interval(int(time_ns[first]), int(time_ns[first]) + LENGTH_S * S),)
        inside = intervals[0].covers(time_ns)
        moved[inside] = 2e-5 * np.arange(inside.sum())
    spoofed = moved > 0 if attack is None else intervals[0].covers(time_ns)
    guard = (
        np.zeros(epochs, bool)
        if attack is None
        else Interval(intervals[0].end_ns, intervals[0].end_ns + 10 * S).covers(time_ns)
    )
    return Truth(
        time_ns,
        np.ones(epochs, bool),
        spoofed,
        guard,
        np.ones(epochs, bool),
        lat + moved,
        lon,
        lat,
        lon,
        moved * 111_000,
        moved * 0,
        S,
        intervals,
    )


def make_decisions(truth: Truth, index: int, noise: float, rng: np.random.Generator) -> Decisions:
    """Noise, mostly below the threshold, that rises in an attack, less for each further detector;
    the first 30 s unavailable.
    """
    n = truth.time_ns.size
    score = np.abs(rng.normal(0, noise, n)) + truth.spoofed * rng.gamma(2, 2 / (1 + index), n)
    score[0] = np.inf
    return Decisions(truth.time_ns, score, np.arange(n) >= 30)


def make_task(
    task_id: str,
    variant: str,
    detector: str,
    attack: str | None,
    window: int | None,
    truth: Truth,
) -> Task:
    interval = truth.intervals[0] if truth.intervals else None
    return Task(
        task_id=task_id,
        variant_id=variant,
        role="judged",
        recording="drive",
        session="drive",
        sensor_class="car",
        provenance="injected",
        is_fused=False,
        kinds='["gnss/pvt","imu"]',
        attack=attack,
        attack_group=attack,
        attack_plugin=attack,
        attack_parameters=None if attack is None else '{"delay_s": 60.0}',
        strength=None,
        window=window,
        window_start_ns=interval and interval.start_ns,
        window_end_ns=interval and interval.end_ns,
        calibration_start_ns=None,
        calibration_end_ns=None,
        judged_start_ns=0,
        held_out="[]",
        left_out=None,
        fit_id=None,
        detector=detector,
        plugin=detector,
        plugin_distribution="spoofbench-stand-in",
        plugin_version="0.1.0",
        parameters='{"threshold": 1.0}',
        parameter_sources="{}",
        input_class="gnss",
        requires='["gnss/pvt"]',
        memory_s=20.0,
        warm_up_s=0.0,
        learns_from_attacks=False,
        baseline=False,
        hold_s=None,
        status="ok",
        reason=None,
    )


def _id(*parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _rng(text: str) -> np.random.Generator:
    return np.random.default_rng(int(text[:12], 16))


DETECTORS = ["acceleration", "correlation", "n" * 64]
ATTACKS = ["replay", "drag-off"]


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three detectors, the last of which fails everywhere; drag-off does not model what the second
    needs.
    """

    def plan(detector: str, attack: str | None) -> tuple[Status, str | None]:
        if detector == "n" * 64:
            return "failed", "ValueError: no"
        return (
            ("not_modelled", "drag-off does not model 'ins/pva'")
            if (detector, attack) == ("correlation", "drag-off")
            else ("ok", None)
        )

    return make_folder(tmp_path_factory.mktemp("results"), DETECTORS, ATTACKS, plan=plan)


@pytest.fixture(scope="session")
def hostile_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every text that a file can bring is hostile."""

    def plan(detector: str, attack: str | None) -> tuple[Status, str | None]:
        return ("failed", HOSTILE) if attack == f"{HOSTILE}2" else ("ok", None)

    return make_folder(
        tmp_path_factory.mktemp("hostile"),
        [HOSTILE, f"[red]{HOSTILE}\x1b[31m"],
        [f"{HOSTILE}1", f"{HOSTILE}2"],
        plan=plan,
        name=HOSTILE,
        sensor_class=f"[red]{HOSTILE}\x1b[31m",
        parameter_sources=json.dumps({HOSTILE: f"[red]{HOSTILE}\x1b[31m"}),
    )


@pytest.fixture(scope="session")
def calibrated_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As ``folder``, but with thresholds of its first quarter, and a really attacked flight."""
    return make_folder(
        tmp_path_factory.mktemp("calibrated"),
        DETECTORS[:2],
        ATTACKS,
        is_calibrated=True,
        has_flight=True,
        noise=0.6,
    )


@pytest.fixture(scope="session")
def make() -> Callable[..., Path]:
    return make_folder


def some_figures(**about: Any) -> Figures:
    """Figures of a detector that detects all of 4 attacks after 5 s, in 1 h without false alert."""
    known: dict[str, Any] = dict.fromkeys(field.name for field in fields(Figures))
    known |= {
        "episodes": 0,
        "clean_h": 1.0,
        "clean_sessions": 1,
        "far_per_hour": 0.0,
        "far_per_hour_lo": 0.0,
        "far_per_hour_hi": 3.69,
        "has_few_episodes": False,
        "detected": 4,
        "attacks": 4,
        "placebo_detected": 1,
        "placebo_attacks": 4,
        "restricted_mean_ttfd_s": 5.0,
        "longest_attack_s": 60.0,
        "warned": 0,
        "hazardous": 0,
    }
    return Figures(**(known | about))


def some_row(detector: str = "mine", **about: Any) -> LeaderboardRow:
    """A row that is ranked first at its calibrated threshold."""
    known: dict[str, Any] = {
        "rank": 1,
        "apart": "",
        "detector": detector,
        "plugin": "plugin",
        "plugin_distribution": "a-distribution",
        "plugin_version": "1",
        "parameters": "{}",
        "parameter_sources": "{}",
        "baseline": False,
        "is_fitted": False,
        "learns_from_attacks": False,
        "threshold": "calibrated",
        "factor_lo": 1.25,
        "factor_hi": 1.25,
        "ranked": some_figures(),
        "published": some_figures(),
        "keeps_target": True,
        "not_better_than": None,
        "told_apart": None,
        "sessions_needed": None,
        "family_left_out": None,
        "ok": 5,
        "failed": 0,
        "skipped": 0,
        "not_modelled": 0,
        "reasons": (),
    }
    return LeaderboardRow(**(known | about))


def some_table(*rows: LeaderboardRow, **about: Any) -> BoardTable:
    """A table of these rows against one attack."""
    known: dict[str, Any] = {
        "provenance": "injected",
        "input_class": "gnss",
        "point": "calibrated",
        "attacks": ("replay",),
        "windows": 4,
        "disjoint_windows": 4,
        "recordings": 1,
        "sessions": 1,
        "sensor_classes": ("car",),
        "clean_h": 1.0,
        "clean_sessions": 1,
        "notes": ("A note.",),
    } | about
    cells = tuple(
        LeaderboardCell(row.detector, attack, row.shown)
        for row in rows
        for attack in known["attacks"]
    )
    return BoardTable(rows=rows, cells=cells, **known)


def some_board(*tables: BoardTable, **about: Any) -> Leaderboard:
    known: dict[str, Any] = {"transfer": (), "severity": (), "absent": ()} | about
    return Leaderboard(suite="stand-in", target_far_per_hour=1.0, tables=tables, **known)


NAMES = st.text("abcxyz-_[]/|<*`\x1b\n", min_size=1, max_size=64) | st.just("n" * 64)
NUMBERS = st.none() | st.floats(0, 1e6)


@st.composite
def figures_of(draw: Any, attacks: int) -> Figures:
    """Any figures against so many attacks."""
    known = {
        field.name: draw(st.floats(0, 1) | st.none() if "share" in field.name else NUMBERS)
        for field in fields(Figures)
        if field.type == float | None
    }
    known["availability"] = draw(st.none() | st.floats(0, 1))
    placebo = draw(st.integers(0, attacks))
    return some_figures(
        **known,
        episodes=draw(st.integers(0, 999)),
        has_few_episodes=draw(st.booleans()),
        detected=draw(st.integers(0, attacks)),
        attacks=attacks,
        placebo_attacks=placebo,
        placebo_detected=draw(st.integers(0, placebo)) if placebo else None,
    )


@st.composite
def row_of(draw: Any, attacks: int) -> LeaderboardRow:
    """Any row against so many attacks."""
    factor = draw(st.none() | st.floats(0.1, 1e4))
    return some_row(
        draw(NAMES),
        rank=draw(st.none() | st.integers(1, 99)),
        apart=draw(st.sampled_from(["", "the only row of its class"])),
        parameter_sources=draw(
            st.sampled_from(["{}", '{"a": "by hand", "b": "session x", "c": "published"}'])
        ),
        baseline=draw(st.booleans()),
        is_fitted=draw(st.booleans()),
        learns_from_attacks=draw(st.booleans()),
        threshold=draw(st.sampled_from(["calibrated", "raised only", "uncalibratable"])),
        factor_lo=factor,
        factor_hi=factor,
        ranked=draw(st.none() | figures_of(attacks)),
        published=draw(figures_of(attacks)),
        keeps_target=draw(st.none() | st.booleans()),
        not_better_than=draw(st.none() | NAMES),
        told_apart=draw(st.none() | st.booleans()),
        sessions_needed=draw(st.none() | st.integers(1, 99_999)),
        failed=draw(st.integers(0, 3)),
        reasons=draw(st.sampled_from([(), ("ValueError: no",)])),
    )


@st.composite
def boards_of(draw: Any) -> Leaderboard:
    """Any leaderboard."""
    tables = []
    for provenance in draw(st.lists(st.sampled_from(get_args(Provenance)), max_size=2)):
        windows = draw(st.sampled_from([0, 1, 4, 1234]))
        tables.append(
            some_table(
                *draw(st.lists(row_of(windows), min_size=1, max_size=3)),
                provenance=provenance,
                input_class=draw(st.sampled_from(["gnss", "gnss+signal+imu"])),
                point=draw(st.sampled_from(["calibrated", "published"])),
                attacks=tuple(draw(st.lists(NAMES, max_size=12))) if windows else (),
                windows=windows,
                disjoint_windows=windows,
            )
        )
    curve = SeverityCurve(np.array([1.0, 2.0]), np.array([0.2, 0.7]), 4, 1)
    return some_board(
        *tables,
        transfer=draw(st.lists(st.just(TransferRow("d", "a", "b", 1.0, 3, 1.5, 2, 4)))),
        severity=tuple(
            SeverityRow(table.provenance, table.input_class, row.detector, "drag-off", curve)
            for table in tables
            for row in table.rows
        ),
        absent=tuple(draw(st.lists(st.builds(AbsentDetector, NAMES, NAMES), max_size=1))),
    )


@pytest.fixture(scope="session")
def boards() -> st.SearchStrategy[Leaderboard]:
    return boards_of()


@pytest.fixture(scope="session")
def made_up() -> Callable[..., Any]:
    """``made_up("row", rank=2)`` and so on: rows, figures, tables and boards from fields."""
    makers: dict[str, Callable[..., Any]] = {
        "figures": some_figures,
        "row": some_row,
        "table": some_table,
        "board": some_board,
    }
    return lambda what, *of, **about: makers[what](*of, **about)
