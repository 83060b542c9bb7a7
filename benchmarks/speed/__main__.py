"""``python -m benchmarks.speed [JOB...]``: our speed against other libraries, side by side in one
process.

Each module ``*_jobs.py`` beside this one has ``jobs(folder)``, which yields its :class:`Job`
objects; the folder is for their files. Results go to ``results.json`` beside this file.
"""

import argparse
import importlib
import tempfile
from pathlib import Path

from benchmarks.speed.frame import Result, report, run, save

HERE = Path(__file__).parent


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "jobs",
        nargs="*",
        metavar="JOB",
        help="names of jobs, or beginnings of them; all by default",
    )
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    results: list[Result] = []
    missing: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        for module in sorted(HERE.glob("*_jobs.py")):
            for job in importlib.import_module(f"benchmarks.speed.{module.stem}").jobs(
                Path(folder)
            ):
                if arguments.jobs and not job.name.startswith(tuple(arguments.jobs)):
                    continue
                print(f"{job.name}: {job.timed}", flush=True)
                results += run(job, arguments.rounds)
                missing.update(job.missing)
    print()
    for line in report(results):
        print(line)
    for peer in sorted(missing):
        print(f"{peer} is not installed and left out")
    if not arguments.jobs:
        save(results, HERE / "results.json")


if __name__ == "__main__":
    main()
