"""What other parsers make of a log."""

import io
import re
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmarks.fuzz.reference import frames
from spoofbench.conversion import Source
from spoofbench.errors import SpoofbenchError

_LINE = re.compile(rb"[$!][^\r\n]*")


def unpacked(path: Path) -> bytes:
    """Return a file's bytes, unpacked."""
    with Source.of(path).open() as stream:
        return stream.read()


def reference(log: bytes) -> Counter[bytes]:
    """UBX frames and sentences of the slow reference, by their bytes."""
    return Counter(
        log[frame.start : frame.start + frame.length]
        for frame in frames(log)
        if frame.protocol != "rtcm3"
    )


def pyubx2(log: bytes) -> Counter[bytes]:
    """UBX frames that pyubx2 parses, by their bytes; what it fails at is left out, and it reads
    on.
    """
    from pyubx2 import ERR_IGNORE, UBX_PROTOCOL, UBXReader

    return _read(
        UBXReader(
            io.BytesIO(log), protfilter=UBX_PROTOCOL, quitonerror=ERR_IGNORE, parsebitfield=False
        )
    )


def pynmeagps(log: bytes) -> Counter[bytes]:
    """Sentences that pynmeagps parses, by their bytes without the line end."""
    from pynmeagps import ERR_IGNORE, NMEAReader

    return _read(NMEAReader(io.BytesIO(log), quitonerror=ERR_IGNORE, nmeaonly=False))


def _read(reader: Any) -> Counter[bytes]:
    found: Counter[bytes] = Counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while True:
            try:
                raw, parsed = reader.read()
            except Exception:  # noqa: BLE001 - whatever a peer raises is its failure to parse
                continue
            if raw is None:
                return found
            if parsed is not None:
                found[bytes(raw).rstrip(b"\r\n") if raw[:1] in b"$!" else bytes(raw)] += 1


def pynmea2(log: bytes) -> Counter[bytes]:
    """Sentences that pynmea2 parses, by their bytes, from the first ``$`` or ``!`` of each line."""
    import pynmea2 as peer

    found: Counter[bytes] = Counter()
    for line in _LINE.findall(log):
        with suppress(peer.ParseError, ValueError, UnicodeDecodeError):
            peer.parse(line.decode("ascii").strip(), check=True)
            found[line.rstrip()] += 1
    return found


def rosbags(path: Path) -> Mapping[str, int] | None:
    """Messages by topic as rosbags counts them; None where it refuses the bag."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys import Stores, get_typestore

    counts: Counter[str] = Counter()
    try:
        if path.suffix == ".bag":
            with Reader1(path) as bag:
                counts.update({topic: info.msgcount for topic, info in bag.topics.items()})
        elif path.is_dir():
            with Reader2(path) as bag:
                counts.update({topic: info.msgcount for topic, info in bag.topics.items()})
        else:
            with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as bag:
                counts.update({topic: info.msgcount for topic, info in bag.topics.items()})
    except Exception:  # noqa: BLE001 - whatever a peer raises is its refusal
        return None
    return dict(counts)


def pandas(path: Path) -> Mapping[str, int]:
    """Rows by file as pandas reads them with its defaults, of a CSV or of all CSVs in an archive or
    folder; refused ones are left out.
    """
    import pandas as peer

    openings: dict[str, Callable[[], Any]] = {}
    with suppress(SpoofbenchError):
        source = Source.of(path)
        openings = {
            name: member.open
            for name, member in source.members().items()
            if name.endswith(".csv") and name != "Metadata.csv"
        }
        if path.name.endswith((".csv", ".csv.gz")):
            openings = {path.name: source.open}
    rows = {}
    for name, opening in openings.items():
        with suppress(Exception), opening() as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows[name] = len(peer.read_csv(stream, on_bad_lines="skip", low_memory=False))
    return rows


def lines(path: Path) -> Mapping[str, int]:
    """Lines of a GnssLogger text by type, fixes by provider; none for other files."""
    counts: Counter[str] = Counter()
    with suppress(SpoofbenchError), Source.of(path).open() as stream:
        if b"# Raw," in stream.read(65_536):
            stream.seek(0)
            for line in stream:
                fields = line.split(b",", 2)
                if line[:1].isalpha() and len(fields) > 1:
                    counts[
                        b",".join(fields[: 2 if fields[0] == b"Fix" else 1]).decode(
                            "ascii", "replace"
                        )
                    ] += 1
    return counts
