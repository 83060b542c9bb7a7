"""Short recordings that say what is to be scored: see ``fakes/spoofbench_pupils.py``."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from spoofbench import codec
from spoofbench.recording import Recording
from spoofbench.results import Task, read_tasks
from spoofbench.suite import (
    AttackEntry,
    Calibration,
    DetectorEntry,
    RecordingEntry,
    Suite,
    TaskLimits,
)
from spoofbench.table import Table
from spoofbench.testing.recordings import START_NS

S = 1_000_000_000
LENGTH_S = 600
TARGET_PER_HOUR = 24.0


def noise(seed: int, rows: int = LENGTH_S) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Scores of clean epochs: 2 % exceed 1."""
    return np.asarray(np.random.default_rng(seed).exponential(0.25, rows))


def session_recording(number: int, score: ArrayLike) -> Recording:
    """A recording at 1 Hz of a session with this number, whose epochs have these scores."""
    values = np.asarray(score, np.float64)
    rng = np.random.default_rng(number)
    pvt = Table(
        "gnss/pvt",
        START_NS + S * np.arange(values.size),
        {
            "lat_deg": 10 + rng.random(values.size),
            "lon_deg": np.full(values.size, 11.0),
            "height_m": np.full(values.size, float(number)),
            "vel_n_mps": values,
            "vel_e_mps": np.zeros(values.size),
            "vel_d_mps": np.zeros(values.size),
        },
    )
    return Recording({"/gnss0/gnss/pvt": pvt}, {"primary": {"gnss/pvt": "gnss0"}})


def write_sessions(folder: Path, scores: Mapping[int, ArrayLike]) -> None:
    """Write the recording of each session."""
    folder.mkdir(exist_ok=True)
    for number, score in scores.items():
        codec.write(session_recording(number, score), folder / f"{number}.mcap")


def session_suite(
    folder: Path,
    split: str | None,
    detectors: Sequence[str | DetectorEntry],
    attacks: Sequence[str] = ("boost",),
    *,
    donors: Mapping[int, Sequence[int]] | None = None,
    calibrating: Sequence[int] = (),
    **changes: Any,
) -> Suite:
    """A suite of the sessions in a folder; ``calibrating`` are those of the other side."""
    numbers = sorted(int(path.stem) for path in folder.glob("*.mcap"))
    lent = donors or {}
    recordings = tuple(
        RecordingEntry(
            f"r{number}",
            folder / f"{number}.mcap",
            f"s{number}",
            side=("calibration" if number in calibrating else "judged")
            if split == "sides"
            else None,
            donors=tuple(f"r{donor}" for donor in lent.get(number, ())),
        )
        for number in numbers
    )
    until_s = LENGTH_S / 2 if split == "first-part" else None
    calibration = Calibration(split, until_s) if split else None  # type: ignore[arg-type]
    suite = Suite(
        name="sessions",
        seed=1,
        windows=1,
        warm_up_s=10.0,
        duration_s=60.0,
        memory_cap_s=20.0,
        target_far_per_hour=TARGET_PER_HOUR,
        limits=TaskLimits(time_s=20.0, memory_mb=256),
        recordings=recordings,
        attacks=tuple(AttackEntry(name, name) for name in attacks),
        detectors=tuple(
            DetectorEntry(each, each) if isinstance(each, str) else each for each in detectors
        ),
        calibration=calibration,
    )
    return replace(suite, **changes)


def factors(folder: Path) -> dict[tuple[str, str], float | None]:
    """The factor of each detector and of each set of sessions held out."""
    return {
        (row["detector"], row["held_out"]): row["factor"]
        for row in pq.read_table(folder / "calibration.parquet").to_pylist()
        if row["left_out"] is None
    }


def lessons(folder: Path, task: Task) -> list[dict[str, Any]]:
    """What the state of a task was taught, as its detector has written it down."""
    about = json.loads((folder / "states" / f"{task.fit_id}.json").read_text())
    taught: list[dict[str, Any]] = json.loads(about["learned"]["taught"])
    return taught


def taught_sessions(folder: Path, task: Task) -> set[int]:
    """The sessions that anything in those lessons came from."""
    return {number for lesson in lessons(folder, task) for number in lesson["sessions"]}


def judged(folder: Path, detector: str) -> list[Task]:
    """The judged tasks of a detector."""
    return [task for task in read_tasks(folder) if task.detector == detector and task.is_judged]
