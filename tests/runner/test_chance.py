"""Who looks at nothing detects nothing that it would not have detected without an attack."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from spoofbench.results import read_tasks
from spoofbench.runner import run
from spoofbench.scoring.statistics import share_interval
from spoofbench.suite import DetectorEntry
from tests.runner.sessions import session_suite, write_sessions

CLUELESS = ("never", "always", "periodic", "random", "bursts")
SESSIONS, HOURS = 5, 1


@pytest.mark.slow
def test_alarms_by_the_clock_do_not_beat_their_placebo(fakes: Path, tmp_path: Path) -> None:
    """Over hundreds of windows, at the published and at the calibrated threshold, whether the
    attack moves fixes or takes them away: the interval of the difference in detection, by session,
    holds 0 or lies below it.
    """
    epochs = 3600 * HOURS
    write_sessions(tmp_path / "sessions", {n: np.zeros(epochs) for n in range(1, SESSIONS + 1)})
    suite = session_suite(
        tmp_path / "sessions",
        "leave-one-session-out",
        [DetectorEntry(name, name) for name in CLUELESS],
        ["nudge", "thin"],
        windows=None,
        memory_cap_s=10.0,
        target_far_per_hour=20.0,
    )
    run(suite, tmp_path / "results")
    assert {task.status for task in read_tasks(tmp_path / "results")} == {"ok"}
    events = pq.read_table(tmp_path / "results" / "events.parquet").to_pandas()
    assert events.drop_duplicates(["session", "window"]).shape[0] > 40 * SESSIONS
    events["above"] = events["detected"].astype(float) - events["placebo_detected"].astype(float)
    seen = set()
    for (name, point, attack), own in events.groupby(["detector", "point", "attack"]):
        differences = own.groupby("session")["above"].mean().to_numpy()
        interval = share_interval((1 + differences) / 2)
        assert interval is not None
        assert interval.lo <= 0.5, f"{name} beats its placebo on {attack}"
        if own["placebo_detected"].any():
            seen.add((name, point))
        if attack == "nudge":
            assert not own["above"].any(), "it moves fixes: their times are the same"
    assert {name for name, _ in seen} == {"periodic", "random", "bursts"}
    assert ("random", "calibrated") in seen
    assert not events[events["detector"].isin(["never", "always"])]["detected"].any()
