"""Conversion of GnssLogger's text log.

:mod:`spoofbench_converters.phone.gnsslogger_format` says what such a log is made of.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns, Item, Rejects, SourceMetadata
from spoofbench.conversion.rows import take
from spoofbench.gnss_time import GPS_EPOCH_NS, leap_seconds_at_gps
from spoofbench_converters.phone import android, gnsslogger_format
from spoofbench_converters.phone.contract import (
    ACCEL,
    AXES,
    BODY,
    DEVICE_AXES,
    GYRO,
    MAG,
    NO_POSITION,
    NO_TIME,
    Options,
    positive,
)
from spoofbench_converters.phone.files import ANOTHER, LogFile, only, text_parts
from spoofbench_converters.phone.gnss_chip import GnssChip
from spoofbench_converters.phone.gnsslogger_format import ELAPSED, SENSORS, UNIX, UTC, LogSchema
from spoofbench_converters.phone.merging import MergedTopic, in_file_order, rejects, used
from spoofbench_converters.phone.time_axis import ClockDeviation, ElapsedTimeAxis, Stamps
from spoofbench_converters.text import lines as text
from spoofbench_converters.text.columns import NOT_A_NUMBER, WRONG_WIDTH, ColumnReader
from spoofbench_converters.text.lines import Lines

_NOT_KEPT = {
    "NMEA": "NMEA sentences: not asked for, convert with --format nmea",
    "GnssAntennaInfo": "GnssAntennaInfo: nothing in the schema",
}
_BATCHING_S = 10.0  # sensors may be handed over in batches of seconds, each on its own

_VECTORS = {  # row type: kind of source, which, columns, fields
    "UncalAccel": ("imu", "uncalibrated", "UncalAccel{}Mps2", "accel_{}_mps2", "Bias{}Mps2"),
    "UncalGyro": (
        "imu",
        "uncalibrated",
        "UncalGyro{}RadPerSec",
        "gyro_{}_radps",
        "Drift{}RadPerSec",
    ),
    "UncalMag": ("mag", "uncalibrated", "UncalMag{}MicroT", "field_{}_ut", "Bias{}MicroT"),
    "Accel": ("imu", "calibrated", "Accel{}Mps2", "accel_{}_mps2", ""),
    "Gyro": ("imu", "calibrated", "Gyro{}RadPerSec", "gyro_{}_radps", ""),
    "Mag": ("mag", "calibrated", "Mag{}MicroT", "field_{}_ut", ""),
}
PVT_FIELDS = (
    "lat_deg",
    "lon_deg",
    "height_m",
    "speed_mps",
    "course_deg",
    "h_acc_m",
    "v_acc_m",
    "s_acc_mps",
    "gps_week",
    "tow_s",
)
_PROVIDERS = {b"GPS": "GPS", b"FLP": "FLP", b"FUSED": "FLP", b"NLP": "NLP", b"NETWORK": "NLP"}
_SOLUTIONS = {
    "GPS": {"solution": "gnss", "solution_basis": "Android's GPS provider"},
    "FLP": {"solution": "fused", "solution_basis": "Android's fused location provider"},
    "NLP": {
        "solution": "fused",
        "solution_basis": "Android's network provider: cells and Wi-Fi, no satellites",
    },
}


def sniff(parts: Sequence[LogFile]) -> float:
    """Return how sure it is that one of the files is a log."""
    return max((gnsslogger_format.confidence(part.head) for part in parts), default=0.0)


def convert(parts: Sequence[LogFile], options: Options) -> Iterator[Item]:
    """Yield what a log holds, the one file of it that is one.

    Raises:
        ConversionError: there are several.
    """
    part = only(
        [part for part in text_parts(parts) if gnsslogger_format.confidence(part.head)], "logs"
    )
    assert part is not None
    log = _Conversion(*gnsslogger_format.survey(part), options)
    with part.open() as file:
        for lines in text.read_lines(file, part.origin):
            if isinstance(lines, Lines):
                yield from log.take(lines)
            else:
                yield lines
    yield from log.finish()
    yield from (other.passed_over(ANOTHER) for other in parts if other is not part)


class _Conversion:
    """A log being converted."""

    def __init__(self, schema: LogSchema, axis: ElapsedTimeAxis, options: Options) -> None:
        self._schema, self._axis, self._options = schema, axis, options
        self._steps = ClockDeviation()
        self._streams: dict[tuple[str, str], MergedTopic] = {}
        self._about: dict[str, dict[str, str]] = {}
        self._chip = GnssChip("gnss0", axis)
        self._by_sensors = any(kind in schema.widths for kind in SENSORS)
        self._timed: list[Columns] = []

    def take(self, lines: Lines) -> Iterator[Item]:
        """Yield what a piece holds."""
        headers = gnsslogger_format.first_octets(lines) == ord("#")
        told = headers | (lines.ends == lines.starts)
        if told.any():
            yield used(int(lines.lengths[told].sum()))
        rows, start = np.flatnonzero(~told), 0
        for header in np.flatnonzero(headers).tolist():
            if self._schema.changed_by(lines.text(header)):
                yield from self._rows(lines.take(rows[(rows >= start) & (rows < header)]))
                self._schema.learn(lines.text(header))
                start = header
        yield from self._rows(lines.take(rows[rows >= start]))

    def finish(self) -> Iterator[Item]:
        """Yield what is held, and the facts."""
        yield from self._chip.finish()
        for stream in self._streams.values():
            yield from stream.finish()
        recording = {
            "clock": "sensor" if self._axis.offset_ns is not None else "gnss",
            "clock_basis": self._axis.basis,
        }
        if self._axis.offset_ns is not None:
            recording |= {
                "boot_unix_ns": str(self._axis.offset_ns),
                "gnss_minus_clock_ns": str(-self._axis.shift_ns),
            }
        if self._options.session:
            recording["session_id"] = self._options.session
        for name, told in self._chip.about().items():
            fixes = self._about.get(name, {})
            self._about[name] = {
                **told,
                **fixes,
                "topic": " ".join(filter(None, (fixes.get("topic"), told["topic"]))),
            }
        about = {
            f"source/{name}": {**self._schema.device, **record}
            for name, record in self._about.items()
        }
        yield SourceMetadata({**about, "recording": {**recording, **self._steps.about()}})

    def _rows(self, lines: Lines) -> Iterator[Item]:
        rows = text.split(lines)
        kinds = gnsslogger_format.types_of(rows)
        readers: dict[str, ColumnReader] = {}
        known = np.zeros(kinds.size, bool)
        for kind in gnsslogger_format.TYPES:
            mine = kinds == kind.encode()
            known |= mine
            if not mine.any():
                continue
            account = {"offset": lines.offsets[mine], "length": lines.lengths[mine]}
            if kind in _NOT_KEPT:
                yield from rejects(account, np.ones(account["offset"].size, bool), _NOT_KEPT[kind])
                continue
            readers[kind], right = self._schema.reader(kind, rows.take(mine))
            yield from rejects(account, ~right, WRONG_WIDTH)
        yield from rejects(
            {"offset": lines.offsets, "length": lines.lengths},
            ~known,
            "a line of no type that GnssLogger writes",
        )
        yield from self._readers({kind: reader for kind, reader in readers.items() if len(reader)})

    def _readers(self, readers: dict[str, ColumnReader]) -> Iterator[Item]:
        """Yield the rows of each type: sensors first, for they tell the time of rows that do
        not.
        """
        self._timed = []
        if self._options.append_clock:
            self._append(readers)
        pushes: dict[str, tuple[MergedTopic, list[Columns]]] = {}
        for kind in SENSORS:
            if kind in readers:
                stream, columns, refused = self._sensor(kind, readers[kind])
                yield from refused
                pushes.setdefault(stream.topic, (stream, []))[1].append(columns)
        for stream, parts in pushes.values():
            yield from stream.push(in_file_order([stream.complete(part) for part in parts]))
        self._watch()
        if "Fix" in readers:
            yield from self._fixes(readers["Fix"])
        if "Raw" in readers:
            yield from self._chip.raw(readers["Raw"])
            if not self._by_sensors:
                self._timed.append(self._chip.latest)
        self._chip.piece(*self._order())
        if "Agc" in readers:
            yield from self._chip.agc(readers["Agc"])
        if "Status" in readers:
            yield from self._chip.status(readers["Status"])
        if "Nav" in readers:
            yield from self._chip.navigation(readers["Nav"])

    def _append(self, readers: dict[str, ColumnReader]) -> None:
        """Look for jumps of the clock, among the rows that tell the time."""
        parts = []
        for kind in SENSORS if self._by_sensors else ("Fix",):
            if kind in readers:
                times, timed = ElapsedTimeAxis(self._axis.offset_ns).times(
                    *_clocks(readers[kind], UNIX if kind == "Fix" else UTC)
                )
                parts.append(
                    take(
                        {"offset": readers[kind].account()["offset"], "time_ns": times},
                        timed & ~readers[kind].bad,
                    )
                )
        if parts:
            rows = in_file_order(parts)
            self._axis.append(rows["offset"], rows["time_ns"])

    def _sensor(
        self, kind: str, reader: ColumnReader
    ) -> tuple[MergedTopic, Columns, list[Rejects]]:
        elapsed, logged = reader.exact(ELAPSED), reader.exact(UTC, 6)
        columns, stream = (
            self._vector(kind, reader) if kind in _VECTORS else self._scalar(kind, reader)
        )
        columns |= reader.account()
        columns["time_ns"], timed = self._axis.times(columns["offset"], elapsed, logged)
        refused = [
            *rejects(columns, reader.bad, NOT_A_NUMBER),
            *rejects(columns, ~timed & ~reader.bad, NO_TIME),
        ]
        kept = timed & ~reader.bad
        columns = take(columns, kept)
        self._timed.append(
            {**_places(columns), "logged": logged[0][kept], "both": (elapsed[1] & logged[1])[kept]}
        )
        return stream, columns, refused

    def _vector(self, kind: str, reader: ColumnReader) -> tuple[Columns, MergedTopic]:
        family, which, column, field, bias = _VECTORS[kind]
        columns: Columns = {
            field.format(axis): reader.floats(column.format(axis.upper())) for axis in AXES
        }
        if family == "imu":
            columns["interval_s"] = np.zeros(len(reader))
        name, stream = self._stream(
            family, which, (*ACCEL, *GYRO, "interval_s") if family == "imu" else MAG
        )
        last = ColumnReader(reader.rows.take(np.array([len(reader) - 1])), reader.places)
        values = [last.floats(bias.format(axis.upper()))[0] for axis in AXES] if bias else []
        if values and not np.isnan(values).any():
            self._about[name][f"{column.partition('{')[0]}_last_bias"] = " ".join(
                repr(float(value)) for value in values
            )
        return columns, stream

    def _scalar(self, kind: str, reader: ColumnReader) -> tuple[Columns, MergedTopic]:
        if kind == "Pressure":
            hectopascal = reader.floats(
                *(
                    name
                    for name in reader.places
                    if name.lower().endswith(("hpa", "mbar", "millibar"))
                )
            )
            return {"pressure_pa": hectopascal * 100}, self._stream("baro", "", ("pressure_pa",))[1]
        columns: Columns = {
            "roll_deg": reader.floats("rollDeg"),
            "pitch_deg": -reader.floats("pitchDeg"),
        }
        return columns, self._stream("ins", "", ("roll_deg", "pitch_deg"))[1]

    def _stream(self, family: str, which: str, fields: tuple[str, ...]) -> tuple[str, MergedTopic]:
        """Return a sensor's source and stream, made when its first row comes."""
        key = (family, which)
        mine = [other for other in self._streams if other[0] == family]
        name = f"{family}{mine.index(key) if key in mine else len(mine)}"
        if key not in self._streams:
            self._streams[key] = MergedTopic(
                name, _KINDS.get(family, family), fields, window_s=_BATCHING_S
            )
            self._about[name] = {**({"topic": which} if which else {}), **_ABOUT.get(family, {})}
        return name, self._streams[key]

    def _fixes(self, reader: ColumnReader) -> Iterator[Item]:
        elapsed, claimed = reader.exact(ELAPSED), reader.exact(UNIX, 6)
        provider = np.char.upper(reader.words("Provider"))
        columns: Columns = {
            "lat_deg": reader.floats("LatitudeDegrees", "Latitude"),
            "lon_deg": reader.floats("LongitudeDegrees", "Longitude"),
            "height_m": reader.floats("AltitudeMeters", "Altitude"),
            "speed_mps": reader.floats("SpeedMps", "Speed"),
            "course_deg": reader.floats("BearingDegrees"),
            "h_acc_m": positive(reader.floats("AccuracyMeters", "Accuracy")),
            "v_acc_m": positive(reader.floats("VerticalAccuracyMeters")),
            "s_acc_mps": positive(reader.floats("SpeedAccuracyMps")),
            **reader.account(),
        }
        placed = ~np.isnan(columns["lat_deg"] + columns["lon_deg"])
        yield from rejects(columns, reader.bad, NOT_A_NUMBER)
        yield from rejects(columns, ~placed & ~reader.bad, NO_POSITION)
        left = placed & ~reader.bad
        for word, name in _PROVIDERS.items():
            mine = left & (provider == word)
            left &= ~mine
            if not mine.any():
                continue
            if self._options.source and self._options.source.upper() not in (word.decode(), name):
                yield from rejects(columns, mine, "fixes of another provider: not asked for")
                continue
            yield from self._provider(
                name, take(columns, mine), _rows(elapsed, mine), _rows(claimed, mine)
            )
        yield from rejects(columns, left, "a fix of a provider that is not known")

    def _provider(
        self, name: str, columns: Columns, elapsed: Stamps, claimed: Stamps
    ) -> Iterator[Item]:
        columns["time_ns"], timed = self._axis.times(
            columns["offset"], elapsed, claimed, shift=name == "GPS"
        )
        yield from rejects(columns, ~timed, NO_TIME)
        if name == "GPS":
            gps = claimed[0] - GPS_EPOCH_NS
            gps += leap_seconds_at_gps(gps) * 1_000_000_000
            known = claimed[1] & (gps > 0)
            week, tow = android.week_and_tow(np.where(known, gps, 0))
            columns |= {"gps_week": week, "gps_week?": known, "tow_s": np.where(known, tow, np.nan)}
        columns = take(columns, timed)
        if not self._by_sensors:
            self._timed.append(_places(columns))
        yield from self._fix_stream(name).push(columns)

    def _fix_stream(self, name: str) -> MergedTopic:
        key = ("gnss", name)
        if key not in self._streams:
            others = sum(family == "gnss" and which != "GPS" for family, which in self._streams)
            source = "gnss0" if name == "GPS" else f"gnss{others + 1}"
            self._streams[key] = MergedTopic(source, "gnss/pvt", PVT_FIELDS, window_s=_BATCHING_S)
            self._about[source] = {
                "topic": f"Fix,{name}",
                "accuracy_basis": "68 % confidence",
                **_SOLUTIONS[name],
            }
        return self._streams[key]

    def _watch(self) -> None:
        """Compare the sensors' logged clock with the axis, in the order of the file."""
        if self._timed:
            rows = in_file_order(self._timed)
            self._steps.watch(
                *(rows[name][rows["both"]] for name in ("offset", "logged", "time_ns"))
            )

    def _order(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return where the timed rows of this piece lie, and their times, in the order of the
        file.
        """
        if not self._timed:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        rows = in_file_order([_places(part) for part in self._timed])
        return rows["offset"], rows["time_ns"]


_KINDS = {"ins": "ins/pva"}
_ABOUT = {
    "imu": {"device_axes": DEVICE_AXES},
    "mag": {"device_axes": DEVICE_AXES},
    "ins": {
        "topic": "OrientationDeg",
        "body": BODY,
        "yaw_basis": "absent: the log's is from magnetic north",
        "solution_basis": "Android's rotation vector, of inertial sensors and magnetometer",
    },
}


def _clocks(reader: ColumnReader, unix: Sequence[str]) -> tuple[NDArray[np.int64], Stamps, Stamps]:
    return reader.account()["offset"], reader.exact(ELAPSED), reader.exact(unix, 6)


def _places(columns: Columns) -> Columns:
    return {name: columns[name] for name in ("offset", "time_ns")}


def _rows(stamps: Stamps, rows: NDArray[np.bool_]) -> Stamps:
    return stamps[0][rows], stamps[1][rows]
