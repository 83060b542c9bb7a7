"""A results folder like that of a run: decisions and truth made up, scores computed from them."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import (
    Status,
    Task,
    TaskOutcome,
    Truth,
    write_outcome,
    write_run,
    write_tasks,
    write_truth,
)
from spoofbench.scoring.score import score_folder

START_NS = 1_700_000_000_000_000_000
S = 1_000_000_000
LENGTH_S = 120

HOSTILE = "</script><img src=x onerror=\"document.title='owned'\">|`*"
"""Text that must reach no interpreter: HTML, JSON in HTML, Markdown tables, rich markup."""

Plan = Callable[[str, str | None], tuple[Status, str | None]]
"""Status and reason of a detector against an attack."""


def all_ok(detector: str, attack: str | None) -> tuple[Status, str | None]:
    return "ok", None


def make_folder(
    folder: Path,
    detectors: Sequence[str],
    attacks: Sequence[str],
    epochs: int = 600,
    plan: Plan = all_ok,
) -> Path:
    """Write a results folder of one recording, three seeds of each attack, and score it."""
    variants = [(None, None), *((attack, seed) for attack in attacks for seed in (1, 2, 3))]
    tasks = []
    for attack, seed in variants:
        variant = _id("variant", attack, seed)
        truth = make_truth(epochs, attack, seed)
        write_truth(folder, variant, truth)
        for index, detector in enumerate(detectors):
            status, reason = plan(detector, attack)
            task_id = _id(detector, variant)
            decisions = make_decisions(truth, index, _rng(task_id)) if status == "ok" else None
            write_outcome(folder, task_id, TaskOutcome(status, reason, decisions))
            tasks.append(make_task(task_id, variant, detector, attack, seed, truth, status, reason))
    write_tasks(folder, tasks)
    write_run(
        folder,
        {
            "suite": "stand-in",
            "thresholds": "published",
            "versions": {"spoofbench": "0.1.0", "numpy": "2.4.6"},
        },
    )
    score_folder(folder)
    return folder


def make_truth(epochs: int, attack: str | None, seed: int | None) -> Truth:
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
        first = epochs // 4 + 40 * (seed or 0)
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


def make_decisions(truth: Truth, index: int, rng: np.random.Generator) -> Decisions:
    """Noise below the threshold that rises in an attack, less for each further detector; the first
    30 s unavailable.
    """
    n = truth.time_ns.size
    score = np.abs(rng.normal(0, 0.3, n)) + truth.spoofed * rng.gamma(2, 2 / (1 + index), n)
    score[0] = np.inf
    return Decisions(truth.time_ns, score, np.arange(n) >= 30)


def make_task(
    task_id: str,
    variant: str,
    detector: str,
    attack: str | None,
    seed: int | None,
    truth: Truth,
    status: Status,
    reason: str | None,
) -> Task:
    window = truth.intervals[0] if truth.intervals else None
    return Task(
        task_id=task_id,
        variant_id=variant,
        recording="drive",
        session="drive",
        attack=attack,
        attack_parameters=None if attack is None else '{"delay_s": 60.0}',
        window_start_ns=window and window.start_ns,
        window_end_ns=window and window.end_ns,
        seed=seed,
        detector=detector,
        plugin=detector,
        plugin_distribution="spoofbench-stand-in",
        plugin_version="0.1.0",
        parameters='{"threshold": 1.0}',
        requires="gnss/pvt",
        memory_s=20.0,
        baseline=False,
        hold_s=None,
        target_far_per_hour=1.0,
        status=status,
        reason=reason,
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

    path = make_folder(
        tmp_path_factory.mktemp("hostile"),
        [HOSTILE, f"[red]{HOSTILE}\x1b[31m"],
        [f"{HOSTILE}1", f"{HOSTILE}2"],
        plan=plan,
    )
    write_run(path, {"suite": HOSTILE, HOSTILE: [HOSTILE]})
    return path


@pytest.fixture(scope="session")
def make() -> Callable[..., Path]:
    return make_folder
