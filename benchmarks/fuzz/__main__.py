"""``python -m benchmarks.fuzz``: damaged and hostile logs for every converter, and for the reader
of recordings.

Inputs are mutations of small logs that are made here and of the beginnings of real ones in DATA:
flipped bits, numbers where lengths are, cuts, repeats, moves, splices of other logs, tokens of the
format, and changes within frames, sentences and archives that leave their checksums right. The same
seed makes the same inputs.

Bounds, for every input of up to 512 KiB (an archive may unpack to 8 times that): one answer within
20 s; at most 1 GiB of address space more than the process had; rows or one SpoofbenchError, nothing
else; every byte accounted for once; the same rows from streams that give fewer bytes than asked for
(every eighth input, archives aside); and the frames of the slow reference (nmea, ubx), neither
fewer nor more. Failing inputs are kept in the corpus with the traceback; what is in the corpus
already is tried first.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from benchmarks.fuzz.drive import FuzzFindings, fuzz
from benchmarks.fuzz.seeds import seeds
from benchmarks.fuzz.targets import check, names

_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.fuzz", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="for each target")
    parser.add_argument(
        "--converter",
        action="append",
        choices=names(),
        metavar="NAME",
        help=f"one of {names()}; all by default",
    )
    parser.add_argument(
        "--corpus",
        type=Path,
        default=Path(tempfile.gettempdir(), "spoofbench-corpus"),
        help="where failing inputs are kept",
    )
    parser.add_argument("--data", type=Path, default=_DATA, help="a folder of real logs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    failed = 0
    print(f"{'target':<10}{'inputs':>10}{'seconds':>9}{'failures':>10}{'kinds':>7}{'peak MiB':>10}")
    for target in arguments.converter or names():
        again = _again(target, arguments.corpus)
        found = fuzz(
            target,
            seeds(target, arguments.data),
            arguments.seconds,
            arguments.corpus,
            arguments.workers,
            arguments.seed,
        )
        failed += found.failed + again
        _show(found)
    print(f"failing inputs are in {arguments.corpus}" if failed else "no failures")
    sys.exit(1 if failed else 0)


def _show(found: FuzzFindings) -> None:
    peak = found.peak_bytes / 2**20
    print(
        f"{found.target:<10}{found.inputs:>10,}{found.seconds:>9.0f}{found.failed:>10,}{len(found.failures):>7}{peak:>10.0f}",
        flush=True,
    )
    for signature, count in sorted(found.failures.items(), key=lambda item: -item[1]):
        print(f"  {count:>6,}  {signature}")


def _again(target: str, corpus: Path) -> int:
    """Try the corpus of earlier runs; return how many still fail, and remove the others."""
    failed = 0
    for path in sorted(corpus.glob(f"{target}-*[0-9]")):
        try:
            check(target, path, 0)
        except Exception as error:  # noqa: BLE001 - that is what is looked for
            failed += 1
            print(f"  still failing: {path.name}: {type(error).__name__}: {str(error)[:100]}")
        else:
            path.unlink()
            path.with_name(f"{path.name}.txt").unlink(missing_ok=True)
    return failed


if __name__ == "__main__":
    main()
