"""Run a small suite and read its results in pandas.

python examples/run_a_suite.py demo/drive.mcap results
"""

import sys
from pathlib import Path

import pandas as pd

from spoofbench import api

SUITE = """
name = "example"
seed = 1
windows = 2
warm_up_s = 30.0
duration_s = 30.0
target_far_per_hour = 1.0

[[recordings]]
id = "drive"
path = "{recording}"

[[attacks]]
name = "drag-off"

[[attacks]]
name = "zero-acceleration"

[[detectors]]
name = "correlation"

[[detectors]]
name = "never"
"""


if __name__ == "__main__":
    recording, results = Path(sys.argv[1]), Path(sys.argv[2])
    suite = results.with_suffix(".toml")
    suite.write_text(SUITE.format(recording=recording.resolve()))
    api.run(suite, results)

    board = api.leaderboard(results)
    print(board[["rank", "detected", "attacks", "far_per_hour"]].to_string())

    # Everything is a Parquet file: one row per task, one per attack, decisions per recording.
    scores = pd.read_parquet(results / "scores.parquet")
    attacked = scores[scores["attack"].notna()]
    print(attacked.pivot_table("detection_pct", "detector", "attack").to_string())
