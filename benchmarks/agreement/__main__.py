"""``python -m benchmarks.agreement [DATA]``: what the converters make of every log in a folder, and
where others disagree.

Others are pyubx2, pynmeagps and pynmea2 (frames and sentences by their bytes), a slow reference
reading of the same streams, gpsd's JSON beside a log (``*.chk``), rosbags, pandas, and what the
folder's manifests say.
"""

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.agreement import gpsd, show
from benchmarks.agreement.compare import compare
from benchmarks.agreement.logs import SampleLog, logs
from benchmarks.agreement.ours import as_dict, converted

_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.agreement", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "data", nargs="?", type=Path, default=_DATA, metavar="DATA", help="a folder of logs"
    )
    parser.add_argument("--only", default="", help="part of the names of the logs to look at")
    parser.add_argument("--out", type=Path, help="a folder for agreement.md and agreement.json")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        parser.error(f"there is no folder {str(arguments.data)!r}: give the folder of the logs")
    chosen = [log for log in logs(arguments.data) if arguments.only in log.name]
    entries, agreements = [], []
    with ProcessPoolExecutor(arguments.workers) as pool:
        for one, agreed in pool.map(_entry, chosen):
            entries.append(one)
            agreements += [agreed] if agreed else []
    closing = list(show.summary(entries, agreements))
    for line in (*show.table(entries), "", *closing):
        print(line)
    if arguments.out:
        show.save(entries, closing, arguments.out)


def _entry(log: SampleLog) -> tuple[dict[str, Any], gpsd.Agreement | None]:
    with tempfile.TemporaryDirectory() as folder:
        ours = converted(log, Path(folder, "log.mcap"))
        said, agreed = compare(log, ours)
        return show.entry(log.name, as_dict(ours), said, agreed), agreed


if __name__ == "__main__":
    main()
