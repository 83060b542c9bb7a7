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
from spoofbench_converters.phone.files import LogFile
from spoofbench_converters.phone.time_axis import PAIRS, ElapsedTimeAxis, Pairs, Stamps
from spoofbench_converters.text import lines as text
from spoofbench_converters.text.columns import ColumnReader
from spoofbench_converters.text.lines import Lines
from spoofbench_converters.text.numbers import words

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

    def reader(self, kind: str, rows: text.Rows) -> tuple[ColumnReader, NDArray[np.bool_]]:
        """Return the rows of a type that have the right number of cells as a reader, and which
        do.
        """
        names = self.names.get(kind, ())
        width = self.widths.get(kind, len(names) + 1)
        right = rows.widths >= width if kind == "Nav" else rows.widths == width
        return ColumnReader(
            rows.take(right), {name: place + 1 for place, name in enumerate(names)}
        ), right


def _header(line: str) -> tuple[str, tuple[str, ...]]:
    """Return the row type that a header line is of, empty where of none, and its columns."""
    kind, *names = (name.strip() for name in line.lstrip("# ").split(","))
    return (kind, tuple(names)) if kind in TYPES and names else ("", ())


def types_of(rows: text.Rows) -> NDArray[np.bytes_]:
    """Return the first cell of each row."""
    return words(rows.column(0))


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


def survey(part: LogFile) -> tuple[LogSchema, ElapsedTimeAxis]:
    """Read what a log's columns and time axis are: of its first 16 MiB, as far as the header and
    the clocks need it.
    """
    schema = LogSchema()
    counts: dict[str, dict[int, int]] = {}
    pairs: dict[str, list[Pairs]] = {"sensors": [], "fixes": [], "raw": []}
    with part.open() as file:
        for lines in text.read_lines(file):
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
    rows = text.split(lines)
    kinds = types_of(rows)
    sensors: list[tuple[NDArray[np.int64], Pairs]] = []
    for kind in schema.names:
        same = rows.take(kinds == kind.encode())
        if not same.widths.size:
            continue
        widths, times = np.unique(same.widths, return_counts=True)
        for width, count in zip(widths.tolist(), times.tolist(), strict=True):
            counts.setdefault(kind, {}).setdefault(width, 0)
            counts[kind][width] += count
        usual = int(widths[np.argmax(times)])
        reader = ColumnReader(
            same.take(same.widths == usual),
            {name: place + 1 for place, name in enumerate(schema.names[kind])},
        )
        if kind in SENSORS:
            elapsed, utc = reader.exact(ELAPSED), reader.exact(UTC, 6)
            both = have_both(elapsed, utc)
            sensors.append((reader.offset[both], (elapsed[0][both], utc[0][both])))
        elif kind == "Fix":
            gps = np.char.upper(reader.words("Provider")) == b"GPS"
            pairs["fixes"].append(first_pairs(reader.exact(ELAPSED), reader.exact(UNIX, 6), gps))
        elif kind == "Raw":
            utc = raw_utc(reader, android.receiver_times(reader))
            pairs["raw"].append(first_pairs(raw_elapsed(reader), utc))
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
    """Return the UTC that the receiver claims at raw measurements, in Unix nanoseconds."""
    logged = reader.exact(UTC, 6)
    return np.where(times.known, times.utc_ns(), logged[0]), times.known | logged[1]


def have_both(elapsed: Stamps, utc: Stamps) -> NDArray[np.bool_]:
    """Return which rows have both clocks, bool ``(n,)``."""
    return elapsed[1] & utc[1] & (elapsed[0] > 0) & (utc[0] > 0)


def first_pairs(
    elapsed: Stamps, utc: Stamps, rows: NDArray[np.bool_] | Literal[True] = True
) -> Pairs:
    """Return both clocks of the first rows that have both, among those that a mask selects."""
    chosen = np.flatnonzero(have_both(elapsed, utc) & rows)[:PAIRS]
    return elapsed[0][chosen], utc[0][chosen]


def _first(parts: list[Pairs]) -> Pairs:
    none = np.empty(0, np.int64)
    return (
        np.concatenate([none, *(part[0] for part in parts)])[:PAIRS],
        np.concatenate([none, *(part[1] for part in parts)])[:PAIRS],
    )


def first_octets(lines: Lines) -> NDArray[np.uint8]:
    """Return each line's first octet, 0 of an empty one."""
    filled = lines.ends > lines.starts
    return (
        np.where(filled, lines.octets[np.where(filled, lines.starts, 0)], 0).astype(np.uint8)
        if lines.starts.size
        else np.empty(0, np.uint8)
    )
