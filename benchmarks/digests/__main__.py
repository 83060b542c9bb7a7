"""Digests of what the product makes, to hold one version of the code against another.

``python -m benchmarks.digests -o before.json`` converts the small logs that fuzzing starts from
and, where present, every log of ``--data``, runs the demo's suite, and writes one SHA-256 per
converted file, per task's decisions and per task's scores. ``--against before.json`` then lists
what differs, and the exit code says whether anything does. Task ids are left out, for they change
with the code, and so are the words of messages.
"""

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pyarrow.parquet as pq

from benchmarks.agreement.logs import logs
from benchmarks.agreement.ours import REFERENCE_DATE
from benchmarks.fuzz.seeds import made
from spoofbench.conversion import convert
from spoofbench.decisions import Outcomes
from spoofbench.demo import demonstrate
from spoofbench.errors import SpoofbenchError

SUFFIXES = {"nmea": ".nmea", "ubx": ".ubx", "phone": ".txt", "table": ".csv", "rosbag": ".bag"}
LEFT_OUT = ("task_id", "variant_id", "fit_id", "reason")
PLACE = ("role", "recording", "attack", "window", "held_out", "left_out", "detector")
"""What names a task, whatever its id."""


def converted(data: Path, folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the name and the digest of each log's recording, or that it is refused."""
    for target, suffix in SUFFIXES.items():
        seeds = folder / target
        seeds.mkdir()
        for number, content in enumerate(made(target, seeds)):
            path = folder / f"{target}-{number}{suffix}"
            path.write_bytes(content)
            mapping = {"mapping": "pothole_iphone"} if target == "table" else {}
            yield f"made/{path.name}", _digest_of(path, folder, None, mapping)
    for log in logs(data) if data.is_dir() else ():
        yield f"data/{log.name}", _digest_of(log.path, folder, log.format, log.options)


def _digest_of(path: Path, folder: Path, form: str | None, options: Mapping[str, str]) -> str:
    out = folder / "out.mcap"
    said = ""
    for given in (options, {**options, "date": REFERENCE_DATE}):
        try:
            convert(path, out, format=form, options=given)
        except SpoofbenchError as error:
            said = str(error)
            if "--date" not in said:
                break
        else:
            return hashlib.sha256(out.read_bytes()).hexdigest()
    return "refused"


def demonstrated(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the digests of the demo's results."""
    demonstrate(folder, None, lambda _: lambda _: None)
    yield from of_results(folder / "results")


def of_results(results: Path) -> Iterator[tuple[str, str]]:
    """Yield the digests of the decisions and scores of every task, and of what sums them up."""
    tasks = pq.read_table(results / "tasks.parquet").to_pylist()
    names, outcomes = {}, Outcomes(results)
    for task in tasks:
        name = "/".join(str(task[key]) for key in PLACE)
        names[task["task_id"]] = name
        outcome = outcomes.of(task["recording"]).get(task["task_id"])
        content = hashlib.sha256(task["status"].encode())
        if outcome and outcome.decisions:
            made = outcome.decisions
            for array in (made.time_ns, made.score, made.available):
                content.update(array.tobytes())
        yield f"decisions/{name}", content.hexdigest()
    for file in ("scores", "events"):
        rows: dict[str, list[object]] = {}
        for row in pq.read_table(results / f"{file}.parquet").to_pylist():
            name = names[row["task_id"]]
            rows.setdefault(name, []).append({k: v for k, v in row.items() if k not in LEFT_OUT})
        for name, found in sorted(rows.items()):
            yield f"{file}/{name}", hashlib.sha256(json.dumps(found).encode()).hexdigest()
    for file in ("calibration", "curves", "transfer"):
        whole = [
            {k: v for k, v in row.items() if k not in LEFT_OUT}
            for row in pq.read_table(results / f"{file}.parquet").to_pylist()
        ]
        yield file, hashlib.sha256(json.dumps(whole).encode()).hexdigest()


def main() -> int:
    """Write the digests and compare them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.digests", description=__doc__)
    parser.add_argument("-o", "--out", type=Path, help="write the digests to this file")
    parser.add_argument("--against", type=Path, help="digests of another version")
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data"), help="a folder of logs"
    )
    parser.add_argument("--without-demo", action="store_true", help="converted logs alone")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        digests = dict(converted(arguments.data, Path(folder)))
        if not arguments.without_demo:
            digests |= demonstrated(Path(folder) / "demo")
    if arguments.out:
        arguments.out.write_text(json.dumps(digests, indent=1, sort_keys=True) + "\n")
    together = hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()
    print(f"{len(digests)} digests, together {together}")
    if arguments.against is None:
        return 0
    other = json.loads(arguments.against.read_text())
    names = [
        name
        for name in other
        if name in digests or not arguments.without_demo or name.startswith(("made/", "data/"))
    ]
    differing = sorted(name for name in {*names, *digests} if other.get(name) != digests.get(name))
    for name in differing:
        print(f"differs: {name}: {str(other.get(name))[:90]} | {str(digests.get(name))[:90]}")
    print(f"{len(differing)} differ")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
