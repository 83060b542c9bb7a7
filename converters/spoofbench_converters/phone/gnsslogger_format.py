"""What a GnssLogger text log is made of: its row types, their columns as the header lines name
them, its clocks.

Source: ``LOGGING_FORMAT.md`` of google/gps-measurement-tools, and the header lines of versions 1.4
to 3.1 and of GPSTest.
"""

import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.phone import android
from spoofbench_converters.phone.files import PhoneFile
from spoofbench_converters.phone.time_axis import PAIRS, ElapsedTimeAxis, Pairs, Stamps
from spoofbench_converters.text.columns import ColumnReader
from spoofbench_converters.text.lines import Lines, read_lines
from spoofbench_converters.text.numbers import TextCells

SURVEY_BYTES = 2**24
ENOUGH_PAIRS = 30

TYPES = (
    "Raw",
    "Fix",
    "Status",
    "Nav",
    "Agc",
    "UncalAccel",
    "Accel",
    "UncalGyro",
    "Gyro",
    "UncalMag",
    "Mag",
    "OrientationDeg",
    "Pressure",
    "NMEA",
    "GnssAntennaInfo",
)
SENSORS = (
    "UncalAccel",
    "Accel",
    "UncalGyro",
    "Gyro",
    "UncalMag",
    "Mag",
    "OrientationDeg",
    "Pressure",
)
UTC = ("utcTimeMillis",)
ELAPSED = ("elapsedRealtimeNanos",)
CHIPSET = ("ChipsetElapsedRealtimeNanos",)
UNIX = ("UnixTimeMillis", "(UTC)TimeInMs")

_DEVICE = re.compile(
    r"Version:\s*(?P<app>\S+).*?Platform:\s*(?P<android>\S+)\s+Manufacturer:\s*(?P<maker>.*?)\s+Model:\s*(?P<model>.*?)\s*$"
)
_ROW = re.compile(r"[A-Za-z]+,(GPS|FLP|NLP|gps|fused|network|-?\d+),-?\d")
_UNHEADED = {  # of rows whose header line is lost
    "UncalAccel": (
        "utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2,"
        "BiasXMps2,BiasYMps2,BiasZMps2"
    ),
    "UncalGyro": (
        "utcTimeMillis,elapsedRealtimeNanos,UncalGyroXRadPerSec,UncalGyroYRadPerSec,"
        "UncalGyroZRadPerSec,DriftXRadPerSec,DriftYRadPerSec,DriftZRadPerSec"
    ),
    "UncalMag": (
        "utcTimeMillis,elapsedRealtimeNanos,UncalMagXMicroT,UncalMagYMicroT,UncalMagZMicroT,"
        "BiasXMicroT,BiasYMicroT,BiasZMicroT"
    ),
    "OrientationDeg": "utcTimeMillis,elapsedRealtimeNanos,yawDeg,rollDeg,pitchDeg",
    "Nav": "Svid,Type,Status,MessageId,Sub-messageId,Data(Bytes)",
}


@dataclass(slots=True)
class LogSchema:
    """What header lines, and the first rows, say of a log: names of the columns and widths of the
    rows by type, and the device.
    """

    names: dict[str, tuple[str, ...]] = field(
        default_factory=lambda: {kind: tuple(names.split(",")) for kind, names in _UNHEADED.items()}
    )
    widths: dict[str, int] = field(default_factory=dict)
    device: dict[str, str] = field(default_factory=dict)

    def changed_by(self, line: str) -> bool:
        """Whether a header line names other columns for a type than those known."""
        kind, names = _header(line)
        return bool(kind) and self.names.get(kind) != names

    def learn(self, line: str) -> None:
        """Take a header line."""
        if found := _DEVICE.search(line):
            self.device = {
                "device": f"{found['maker']} {found['model']}",
                "firmware": f"Android {found['android']}",
                "app": f"GnssLogger {found['app']}",
            }
        kind, names = _header(line)
        if kind and self.names.get(kind) != names:
            self.names[kind] = names
            self.widths.pop(kind, None)

    def right(self, kind: str, lines: Lines) -> NDArray[np.bool_]:
        """Return which lines of a type have the right number of cells, bool ``(n,)``."""
        width = self.widths.get(kind, len(self.names.get(kind, ())) + 1)
        return lines.cells >= width if kind == "Nav" else lines.cells == width

    def reader(self, kind: str, lines: Lines) -> ColumnReader:
        """Return lines of a type and of one width as columns."""
        names = self.names.get(kind, ())
        return ColumnReader(lines, {name: place + 1 for place, name in enumerate(names)})


def _header(line: str) -> tuple[str, tuple[str, ...]]:
    """Return the row type that a header line is of, empty where of none, and its columns."""
    kind, *names = (name.strip() for name in line.lstrip("# ").split(","))
    return (kind, tuple(names)) if kind in TYPES and names else ("", ())


def types_of(lines: Lines) -> NDArray[np.intp]:
    """Return the type that the first cell of each line names: its index in :data:`TYPES`, ``(n,)``,
    -1 where it names none.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    commas = np.append(np.flatnonzero(lines.plain == ord(",")), lines.plain.size)
    ends = np.minimum(commas[np.searchsorted(commas, lines.starts)], lines.ends)
    names = TextCells(lines.plain, lines.starts, ends).stripped().texts()
    index = pc.fill_null(pc.index_in(names, pa.array(TYPES)), -1)
    return np.asarray(index.to_numpy(zero_copy_only=False), np.intp)


def confidence(head: bytes) -> float:
    """Return 1 for a log with header lines, 0.9 for one without, 0 for others and for one of NMEA
    sentences alone.
    """
    lines = head.decode("latin-1").splitlines()
    headed = any(re.match(r"#\s*(Raw,.*TimeNanos|Fix,\s*Provider)", line) for line in lines)
    kinds = [line.partition(",")[0] for line in lines if line.partition(",")[0] in TYPES]
    if kinds and kinds.count("NMEA") == len(kinds):
        return 0.0
    if headed:
        return 1.0
    rows = sum(bool(_ROW.match(line)) for line in lines if line.partition(",")[0] in TYPES)
    return 0.9 if rows >= 3 and 2 * rows >= len(lines) else 0.0


def survey(part: PhoneFile) -> tuple[LogSchema, ElapsedTimeAxis]:
    """Read what a log's columns and time axis are: of its first 16 MiB, as far as the header and
    the clocks need it.
    """
    schema = LogSchema()
    counts: dict[str, dict[int, int]] = {}
    pairs: dict[str, list[Pairs]] = {"sensors": [], "fixes": [], "raw": []}
    with part.open() as file:
        for lines in read_lines(file):
            if not isinstance(lines, Lines):
                continue
            if not lines.starts.size or int(lines.offsets[-1]) > SURVEY_BYTES:
                break
            same = _of_one_header(lines, schema, bool(counts))
            _survey_lines(same, schema, counts, pairs)
            known = all(
                parts and parts[0][0].size >= ENOUGH_PAIRS
                for parts in (pairs["sensors"], pairs["fixes"])
            )
            if known or same.starts.size < lines.starts.size:
                break
    for kind, widths in counts.items():
        if kind in schema.names and kind != "Nav":
            schema.widths[kind] = max(widths, key=lambda width: (widths[width], width))
    sensors, fixes, raw = (_first(parts) for parts in pairs.values())
    return schema, ElapsedTimeAxis.of(sensors, fixes, raw)


def _of_one_header(lines: Lines, schema: LogSchema, begun: bool) -> Lines:
    """Return the lines before a header line that changes the schema of rows that have begun; learn
    those before it.
    """
    octets = first_octets(lines)
    rows = np.flatnonzero((octets != ord("#")) & (octets != 0))
    first = 0 if begun else int(rows[0]) if rows.size else lines.starts.size
    for row in np.flatnonzero(octets == ord("#")).tolist():
        if row > first and schema.changed_by(lines.text(row)):
            return lines.take(np.arange(row))
        schema.learn(lines.text(row))
    return lines


def _survey_lines(
    lines: Lines,
    schema: LogSchema,
    counts: dict[str, dict[int, int]],
    pairs: dict[str, list[Pairs]],
) -> None:
    kinds = types_of(lines)
    sensors: list[tuple[NDArray[np.int64], Pairs]] = []
    for kind in schema.names:
        same = lines.take(kinds == TYPES.index(kind))
        if not len(same):
            continue
        widths, times = np.unique(same.cells, return_counts=True)
        for width, count in zip(widths.tolist(), times.tolist(), strict=True):
            counts.setdefault(kind, {}).setdefault(width, 0)
            counts[kind][width] += count
        usual = int(widths[np.argmax(times)])
        whole = same.take(same.cells == usual)
        if kind not in (*SENSORS, "Fix", "Raw"):
            continue
        enough = 10 * PAIRS  # lines, which have so many rows with both clocks, as a rule
        offset, found = _pairs(kind, schema.reader(kind, whole.take(slice(0, enough))))
        if offset.size < PAIRS and len(whole) > enough:
            offset, found = _pairs(kind, schema.reader(kind, whole))
        if kind in SENSORS:
            sensors.append((offset, found))
        else:
            pairs["fixes" if kind == "Fix" else "raw"].append(found)
    if sensors:
        order = np.argsort(np.concatenate([offset for offset, _ in sensors]))
        elapsed_ns, utc_ns = (
            np.concatenate([pair[clock] for _, pair in sensors])[order] for clock in (0, 1)
        )
        pairs["sensors"].append((elapsed_ns, utc_ns))
    for parts in pairs.values():
        parts[:] = [_first(parts)]


def raw_elapsed(reader: ColumnReader) -> Stamps:
    """Return the elapsed time of raw measurements in nanoseconds: the chipset's, else the
    logger's.
    """
    chipset, logger = reader.exact(CHIPSET), reader.exact(("ElapsedRealtimeMillis",), 6)
    own = chipset[1] & (chipset[0] > 0)
    return np.where(own, chipset[0], logger[0]), own | logger[1]


def raw_utc(reader: ColumnReader, times: android.Times) -> Stamps:
    """Return the UTC that the receiver claims at raw measurements, Unix nanoseconds ``(n,)``."""
    logged = reader.exact(UTC, 6)
    return np.where(times.known, times.utc_ns(), logged[0]), times.known | logged[1]


def first_pairs(
    elapsed: Stamps, utc: Stamps, rows: NDArray[np.bool_] | Literal[True] = True
) -> Pairs:
    """Return both clocks of the first rows that have both, ``(k,)``, k at most :data:`PAIRS`, among
    those that a mask ``(n,)`` selects.
    """
    chosen = _with_both(elapsed, utc, rows)
    return elapsed[0][chosen], utc[0][chosen]


def _with_both(
    elapsed: Stamps, utc: Stamps, rows: NDArray[np.bool_] | Literal[True]
) -> NDArray[np.intp]:
    both = elapsed[1] & utc[1] & (elapsed[0] > 0) & (utc[0] > 0) & rows
    return np.flatnonzero(both)[:PAIRS]


def _pairs(kind: str, reader: ColumnReader) -> tuple[NDArray[np.int64], Pairs]:
    """Return where the first rows of a type that have both clocks lie in the log, and the
    clocks.
    """
    rows: NDArray[np.bool_] | Literal[True] = True
    if kind == "Raw":
        elapsed, utc = raw_elapsed(reader), raw_utc(reader, android.receiver_times(reader))
    else:
        elapsed, utc = reader.exact(ELAPSED), reader.exact(UNIX if kind == "Fix" else UTC, 6)
    if kind == "Fix":
        rows = np.char.upper(reader.texts("Provider")) == b"GPS"
    chosen = _with_both(elapsed, utc, rows)
    return reader.offset[chosen], (elapsed[0][chosen], utc[0][chosen])


def _first(parts: list[Pairs]) -> Pairs:
    none = np.empty(0, np.int64)
    return (
        np.concatenate([none, *(part[0] for part in parts)])[:PAIRS],
        np.concatenate([none, *(part[1] for part in parts)])[:PAIRS],
    )


def first_octets(lines: Lines) -> NDArray[np.uint8]:
    """Return each line's first octet, uint8 ``(n,)``, 0 of an empty one."""
    filled = lines.ends > lines.starts
    return (
        np.where(filled, lines.octets[np.where(filled, lines.starts, 0)], 0).astype(np.uint8)
        if lines.starts.size
        else np.empty(0, np.uint8)
    )
