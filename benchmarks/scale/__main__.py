"""Time and memory of scoring and ranking many tasks.

``python -m benchmarks.scale`` makes results folders of 12,240 and of 50,640 tasks: 20 detectors on
12 sessions of 2,000 to 3,000 s at 1 Hz, thresholds from the other sessions. It scores and ranks
each, every step in a process of its own, and prints what that took. Four times the tasks may take
four times the time, but no more memory than their tables.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.speed.results_folders import Crossing

CROSSINGS = (
    Crossing(detectors=20, sessions=12, attacks=10, windows=5),
    Crossing(detectors=20, sessions=12, attacks=42, windows=5),
)
STEPS = {
    "make": "from benchmarks.scale.__main__ import make as step",
    "score": "from spoofbench.scoring.score import score_folder as step",
    "rank": "from spoofbench.scoring.leaderboard import leaderboard as step",
}


@dataclass(frozen=True, slots=True)
class Taken:
    """What a process took: by the clock, of the processor, and at its peak of memory."""

    seconds: float
    processor_s: float
    peak_mb: float


def make(folder: Path) -> None:
    """Write the folder named after one of the crossings' number of tasks."""
    next(each for each in CROSSINGS if str(each.tasks) == folder.name).write(folder)


def take(step: str, folder: Path) -> Taken:
    """Run a step on a folder in a process of its own.

    This one stays small: a process's peak begins at that of the one which started it.
    """
    code = f"import sys; from pathlib import Path; {STEPS[step]}; step(Path(sys.argv[1]))"
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code, str(folder)])
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    seconds = time.perf_counter() - begin
    if process.returncode:
        raise SystemExit(f"{step} {folder} failed")
    kilo = 1e6 if sys.platform == "darwin" else 1e3
    return Taken(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / kilo)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scale", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--folder", type=Path, help="where to keep the results folders, 3 GB; else they go"
    )
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        base = arguments.folder or Path(temporary)
        print(f"{'tasks':>8}  {'step':<6}{'seconds':>9}{'processor s':>13}{'peak MB':>9}")
        for crossing in CROSSINGS:
            folder = base / str(crossing.tasks)
            for step in STEPS:
                if step == "make" and (folder / "run.json").exists():
                    continue
                taken = take(step, folder)
                print(
                    f"{crossing.tasks:>8,}  {step:<6}{taken.seconds:>9.1f}"
                    f"{taken.processor_s:>13.1f}{taken.peak_mb:>9.0f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
