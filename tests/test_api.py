"""The calls of a notebook give what the files of a run hold."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from spoofbench import api
from spoofbench.attacks.synthetic import DragOff
from spoofbench.codec import write
from spoofbench.errors import SpoofbenchError
from spoofbench.results import read_tasks
from spoofbench.schema import TRUTH_TOPIC
from spoofbench.table import Column, Table
from spoofbench.testing import drive

SUITE = """
name = "one"
seed = 1
windows = 1
warm_up_s = 60.0
duration_s = 60.0
target_far_per_hour = 1.0
[[recordings]]
id = "drive"
path = "drive.mcap"
[[attacks]]
name = "drag-off"
[[detectors]]
name = "correlation"
"""
EVENT = (
    "alerted_share",
    "persisted_s",
    "retrust_s",
    "position_error_at_detection_m",
    "largest_error_before_alert_m",
    "largest_error_while_silent_m",
)
"""Of an attack interval: columns of ``events.parquet``."""


def test_a_table_becomes_a_frame_with_its_absences() -> None:
    table = Table(
        "gnss/signal",
        np.array([0, 10**9, 2 * 10**9]),
        {
            "svid": Column(np.array([1, 0, 3], np.uint32), np.array([True, False, True])),
            "cn0_dbhz": np.array([40.0, np.nan, 30.0]),
            "signal": ["1C", None, "1C"],
        },
    )
    frame = api.to_pandas(table)
    assert frame.index.tolist() == [pd.Timestamp(s, unit="s", tz="UTC") for s in (0, 1, 2)]
    assert frame["svid"].tolist() == [1, pd.NA, 3]
    assert frame["signal"].isna().tolist() == [False, True, False]
    assert frame["cn0_dbhz"].isna().tolist() == [False, True, False]
    assert frame["signal"].astype(object).tolist()[0] == "1C"


def test_evaluate_is_what_a_run_scores(tmp_path: Path) -> None:
    clean = drive(1, 300.0)
    write(clean, tmp_path / "drive.mcap")
    (tmp_path / "one.toml").write_text(SUITE)
    api.run(tmp_path / "one.toml", tmp_path / "results")
    rows = pd.read_parquet(tmp_path / "results" / "scores.parquet")
    (event,) = pd.read_parquet(tmp_path / "results" / "events.parquet").to_dict("records")
    attacked = rows[rows["attack"].notna()].iloc[0].to_dict() | {n: event[n] for n in EVENT}
    unattacked = rows[rows["attack"].isna()].iloc[0]

    (window_ns,) = (
        task.window_start_ns for task in read_tasks(tmp_path / "results") if task.window_start_ns
    )
    start_s = (window_ns - clean.span.start_ns) / 1e9
    variant = api.make_variant(clean, "drag-off", start_s=start_s, duration_s=60.0, seed=1)
    scores = api.evaluate("correlation", variant, clean)
    for name in ("detection_pct", "ttfd_s", "availability", *EVENT):
        known = np.nan if scores[name] is None else scores[name]
        assert known == pytest.approx(attacked[name], nan_ok=True), name
    false = api.evaluate("correlation", clean)
    for name in ("far_per_hour", "far_per_hour_lo", "far_per_hour_hi", "availability"):
        assert false[name] == pytest.approx(unattacked[name]), name

    board = api.leaderboard(tmp_path / "results")
    assert board.index.tolist() == [("injected", "gnss+imu", "correlation")]
    (row,) = board.to_dict("records")
    assert row["detection_pct"] == pytest.approx(attacked["detection_pct"])
    assert (row["point"], row["attacks"]) == ("published", 1)


def test_without_the_clean_recording_position_errors_are_unknown() -> None:
    variant = api.make_variant(drive(1, 300.0), DragOff(rate_mps=5.0), seed=2)
    scores = api.evaluate("always", variant)
    assert scores["detection_pct"] > 90.0
    assert scores["position_error_at_detection_m"] is None
    assert scores["largest_error_before_alert_m"] is None
    assert scores["largest_error_while_silent_m"] is None


def test_an_instance_is_as_good_as_a_name() -> None:
    clean = drive(1, 300.0)
    named = api.make_variant(clean, "drag-off", rate_mps=2.0, seed=5, start_s=100.0)
    given = api.make_variant(clean, DragOff(), rate_mps=2.0, seed=5, start_s=100.0)
    assert named.primary("gnss/pvt")["lat_deg"].shape == given.primary("gnss/pvt")["lat_deg"].shape
    assert TRUTH_TOPIC in named
    assert TRUTH_TOPIC in given


@pytest.mark.parametrize(
    "call",
    [
        lambda: api.read("nowhere.mcap"),
        lambda: api.detect("nobody", drive(1, 60.0)),
        lambda: api.make_variant(drive(1, 60.0), "drag-off", rate_mps="fast"),
        lambda: api.make_variant(drive(1, 60.0), "drag-off", start_s=1e9),
        lambda: api.leaderboard("nowhere"),
        lambda: api.run("nowhere.toml", "nowhere"),
    ],
)
def test_what_a_user_can_cause_is_one_sentence(call: object) -> None:
    assert callable(call)
    with pytest.raises(SpoofbenchError) as failure:
        call()
    assert "\n" not in str(failure.value)
