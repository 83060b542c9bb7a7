"""Made-up results folders of any size: true windows, decisions as detectors make them.

A detector's score on a clean recording is noise with memory and now and then an excursion; under an
attack it is that of the clean recording until the onset, and grows by the attack's strength and the
detector's own sensitivity. Every session is judged with thresholds of the others.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spoofbench.arrays import Floats
from spoofbench.decisions import OutcomeLog
from spoofbench.detector import Decisions
from spoofbench.recording import Interval
from spoofbench.results import (
    Status,
    Task,
    TaskOutcome,
    Truth,
    write_run,
    write_tasks,
    write_truth,
)

SECOND_NS = 1_000_000_000
BEGIN_NS = 1_700_000_000 * SECOND_NS
WARM_UP_S, ATTACK_S, GUARD_S = 60, 200, 130
MEMORY_S = 20.0
STRENGTHS = 3
"""Attacks of one group, at so many strengths."""


@dataclass(frozen=True, slots=True)
class Crossing:
    """How many of what a suite crosses, each of the sessions in one recording.

    At most seven windows fit.
    """

    detectors: int
    sessions: int
    attacks: int
    windows: int

    @property
    def tasks(self) -> int:
        return self.detectors * self.sessions * (self.attacks * self.windows + 1)

    def write(self, folder: Path, seed: int = 0) -> None:
        """Write everything but the scores."""
        rng = np.random.default_rng(seed)
        log = OutcomeLog(folder)
        tasks: list[Task] = []
        by_recording: dict[str, list[str]] = {}
        for session in range(self.sessions):
            for task, outcome in self._tasks(folder, session, rng):
                tasks.append(task)
                log.add(task.task_id, outcome)
                by_recording.setdefault(task.recording, []).append(task.task_id)
        log.sort(by_recording)
        write_tasks(folder, tasks)
        write_run(folder, {"suite": _SUITE})

    def _tasks(
        self, folder: Path, session: int, rng: np.random.Generator
    ) -> Iterator[tuple[Task, TaskOutcome]]:
        """The tasks of one recording: by variant, then detector."""
        epochs = int(rng.integers(2000, 3001)) if self.windows < 6 else 3000
        time_ns = BEGIN_NS + np.arange(epochs) * SECOND_NS
        clean = [_clean_score(rng, epochs) for _ in range(self.detectors)]
        available = np.arange(epochs) >= WARM_UP_S
        variants: list[tuple[int | None, int | None]] = [(None, None)]
        variants += [(a, w) for a in range(self.attacks) for w in range(self.windows)]
        for attack, window in variants:
            truth = _truth(rng, epochs, window)
            variant_id = f"{session}-{attack}-{window}"
            write_truth(folder, variant_id, truth, ["gnss/pvt", "imu"])
            for detector in range(self.detectors):
                score = clean[detector]
                if attack is not None:
                    strength = (1 + attack % STRENGTHS) * rng.gamma(2, 0.5) * (1 + detector % 7) / 7
                    age_s = (time_ns - truth.intervals[0].start_ns) / SECOND_NS
                    score = score + strength * truth.spoofed * np.minimum(age_s / 60, 1)
                    late = rng.normal(0, 0.02, epochs) * (age_s >= 0)
                    score = np.abs(score + late)
                is_lost = rng.random() < 0.002
                made = None if is_lost else Decisions(time_ns, score, available)
                status: Status = "timeout" if is_lost else "ok"
                reason = "it took over 60 s" if is_lost else None
                yield (
                    _task(session, attack, window, detector, truth, variant_id, status, reason),
                    TaskOutcome(status, reason, made),
                )


def _clean_score(rng: np.random.Generator, epochs: int) -> Floats:
    """A statistic over its threshold, 1 Hz, ``(n,)``: noise over some 10 s, and excursions."""
    from scipy.signal import lfilter

    noise = lfilter([0.3], [1, -0.95], rng.normal(0, 1, epochs))
    score: Floats = 0.35 * np.abs(noise) + np.abs(rng.normal(0, 0.05, epochs))
    for at in rng.integers(0, epochs, rng.poisson(epochs / 1500)):
        score[at : at + 20] *= rng.uniform(1.5, 4)
    return score


def _truth(rng: np.random.Generator, epochs: int, window: int | None) -> Truth:
    time_ns = BEGIN_NS + np.arange(epochs) * SECOND_NS
    intervals: tuple[Interval, ...] = ()
    if window is not None:
        start_ns = BEGIN_NS + (WARM_UP_S + window * (ATTACK_S + GUARD_S)) * SECOND_NS
        intervals = (Interval(start_ns, start_ns + ATTACK_S * SECOND_NS),)
    spoofed = np.zeros(epochs, bool)
    for interval in intervals:
        spoofed |= interval.covers(time_ns)
    guard = np.zeros(epochs, bool)
    guard[1:] = spoofed[:-1] & ~spoofed[1:]
    angle, moved = np.arange(epochs) / 90, 1e-6 * np.cumsum(spoofed) * spoofed
    lat_deg, lon_deg = 39.7 + 0.01 * np.sin(angle), -84.2 + 0.02 * np.cos(0.7 * angle)
    return Truth(
        time_ns=time_ns,
        observed=np.ones(epochs, bool),
        spoofed=spoofed,
        guard=guard,
        reviewed=np.ones(epochs, bool),
        lat_deg=lat_deg + moved,
        lon_deg=lon_deg,
        clean_lat_deg=lat_deg,
        clean_lon_deg=lon_deg,
        position_error_m=111_000 * moved * rng.uniform(0.5, 2),
        velocity_error_mps=0.1 * spoofed,
        epoch_ns=SECOND_NS,
        intervals=intervals,
    )


def _task(
    session: int,
    attack: int | None,
    window: int | None,
    detector: int,
    truth: Truth,
    variant_id: str,
    status: Status,
    reason: str | None,
) -> Task:
    is_clean = attack is None
    looks_at_imu = detector % 3 > 0
    first, end = int(truth.time_ns[0]), int(truth.time_ns[-1]) + truth.epoch_ns
    return Task(
        task_id=f"{variant_id}-{detector}",
        variant_id=variant_id,
        role="judged",
        recording=f"recording-{session:02}",
        session=f"session-{session:02}",
        sensor_class="phone-1hz",
        provenance="injected",
        is_fused=False,
        kinds='["gnss/pvt","imu"]',
        attack=None if attack is None else f"attack-{attack:02}",
        attack_group=None if attack is None else f"group-{attack // STRENGTHS:02}",
        attack_plugin=None if attack is None else f"attack-{attack // STRENGTHS:02}",
        attack_parameters=None if attack is None else f'{{"rate_mps":{1 + attack % STRENGTHS}.0}}',
        strength=None if attack is None else 1.0 + attack % STRENGTHS,
        window=window,
        window_start_ns=None if is_clean else truth.intervals[0].start_ns,
        window_end_ns=None if is_clean else truth.intervals[0].end_ns,
        calibration_start_ns=first if is_clean else None,
        calibration_end_ns=end if is_clean else None,
        judged_start_ns=first,
        held_out=json.dumps([f"session-{session:02}"]),
        left_out=None,
        fit_id=None,
        detector=f"detector-{detector:02}",
        plugin="plugin",
        plugin_distribution="distribution",
        plugin_version="1.0",
        parameters='{"threshold":1.0}',
        parameter_sources="{}",
        input_class="gnss+imu" if looks_at_imu else "gnss",
        requires='["gnss/pvt","imu"]' if looks_at_imu else '["gnss/pvt"]',
        memory_s=MEMORY_S,
        warm_up_s=float(WARM_UP_S),
        learns_from_attacks=False,
        baseline=detector in (0, 3),
        hold_s=None,
        status=status,
        reason=reason,
    )


_SUITE = {
    "name": "made-up",
    "target_far_per_hour": 1.0,
    "memory_cap_s": 130.0,
    "alert_limit_m": 50.0,
    "time_to_alert_s": 10.0,
    "warm_up_s": float(WARM_UP_S),
    "ranks_fused": [],
    "calibration": {"split": "leave-one-session-out", "until_s": None, "classes": None},
}
