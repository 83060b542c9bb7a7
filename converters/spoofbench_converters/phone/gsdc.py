"""Google Smartphone Decimeter Challenge (2022 to 2024): ``device_gnss.csv``, ``device_imu.csv`` and
``ground_truth.csv``.

Source: the data description of the competition *smartphone-decimeter-2022*. ``device_gnss.csv`` is
GnssLogger's raw measurements with derived columns, among them a least-squares position per epoch,
which was computed afterwards.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from spoofbench.conversion import Item, RowBatch, SourceMetadata
from spoofbench_converters.phone import android, contract
from spoofbench_converters.phone.contract import AXES, NO_POSITION, NO_TIME, Options
from spoofbench_converters.phone.files import (
    HeaderSchema,
    PhoneFile,
    only,
    read_columns,
    text_parts,
)
from spoofbench_converters.phone.gnss_chip import GnssChip
from spoofbench_converters.phone.gnsslogger_format import (
    ELAPSED,
    UNIX,
    UTC,
    first_pairs,
    raw_elapsed,
    raw_utc,
)
from spoofbench_converters.phone.merging import MergedTopic, in_file_order
from spoofbench_converters.phone.time_axis import ClockDeviation, ElapsedTimeAxis
from spoofbench_converters.text.columns import NOT_A_NUMBER, ColumnReader

_GNSS = frozenset(
    {"MessageType", "utcTimeMillis", "TimeNanos", "FullBiasNanos", "ReceivedSvTimeNanos"}
)
_IMU = frozenset({"MessageType", "utcTimeMillis", "MeasurementX", "MeasurementY", "MeasurementZ"})
_TRUTH = frozenset({"MessageType", "Provider", "LatitudeDegrees", "LongitudeDegrees"})
_MESSAGES = {
    b"UncalAccel": ("imu", "accel_{}_mps2"),
    b"UncalGyro": ("imu", "gyro_{}_radps"),
    b"UncalMag": ("mag", "field_{}_ut"),
}
_WLS = tuple(f"WlsPosition{axis.upper()}EcefMeters" for axis in AXES)
_BATCHING_S = 10.0


def sniff(parts: Sequence[PhoneFile]) -> float:
    """Return 1 where a file has the columns of the measurements or of the inertial sensors, else
    0.
    """
    return float(any(_is(part, _GNSS) or _is(part, _IMU) for part in parts))


def _is(part: PhoneFile, columns: frozenset[str]) -> bool:
    return columns <= set(HeaderSchema.of(part.head).names)


def tables(
    parts: Sequence[PhoneFile],
) -> tuple[PhoneFile | None, PhoneFile | None, PhoneFile | None]:
    """Return the tables of the measurements, of the inertial sensors and of the reference.

    Raises:
        ConversionError: there are two of one.
    """
    text = text_parts(parts)
    gnss, imu, truth = (
        [part for part in text if _is(part, columns)] for columns in (_GNSS, _IMU, _TRUTH)
    )
    return (
        only(gnss, "tables of measurements"),
        only(imu, "tables of sensors"),
        only(truth, "references"),
    )


def convert(parts: Sequence[PhoneFile], options: Options) -> Iterator[Item]:
    """Yield what a drive of one phone holds.

    Raises:
        ConversionError: there are several drives.
    """
    gnss, imu, truth = tables(parts)
    axis, deviation = _axis(gnss, imu), ClockDeviation()
    if imu:
        yield from _sensors(imu, axis, deviation)
    if gnss:
        yield from _measurements(gnss, axis)
    if truth:
        yield from _reference(truth, axis)
    recording = {
        "clock": "sensor" if axis.offset_ns is not None else "gnss",
        "clock_basis": axis.basis,
        **deviation.about(),
    }
    if axis.offset_ns is not None:
        recording |= {
            "boot_unix_ns": str(axis.offset_ns),
            "gnss_minus_clock_ns": str(-axis.shift_ns),
        }
    yield SourceMetadata(
        {"recording": recording | ({"session_id": options.session} if options.session else {})}
    )
    yield from (part.rejected() for part in parts if part not in (gnss, imu, truth))


def _axis(gnss: PhoneFile | None, imu: PhoneFile | None) -> ElapsedTimeAxis:
    none = np.empty(0, np.int64)
    sensors, raw = (none, none), (none, none)
    if imu and (reader := _first(imu)):
        sensors = first_pairs(reader.exact(ELAPSED), reader.exact(UTC, 6))
    if gnss and (reader := _first(gnss)):
        utc = raw_utc(reader, android.receiver_times(reader))
        raw = first_pairs(raw_elapsed(reader), utc)
    return ElapsedTimeAxis.of(sensors, (none, none), raw)


def _first(file: PhoneFile) -> ColumnReader | None:
    pieces = read_columns(file, HeaderSchema.of(file.head))
    return next((piece for piece in pieces if isinstance(piece, ColumnReader)), None)


def _sensors(file: PhoneFile, axis: ElapsedTimeAxis, deviation: ClockDeviation) -> Iterator[Item]:
    topics = {
        "imu": MergedTopic("imu0", "imu", joins=True, window_s=_BATCHING_S),
        "mag": MergedTopic("mag0", "mag", joins=True, window_s=_BATCHING_S),
    }
    for reader in read_columns(file, HeaderSchema.of(file.head)):
        if not isinstance(reader, ColumnReader):
            yield reader
            continue
        elapsed, logged = reader.exact(ELAPSED), reader.exact(UTC, 6)
        time_ns, timed = axis.times(reader.offset, elapsed, logged)
        values = [reader.floats(f"Measurement{name.upper()}") for name in AXES]
        message = reader.texts("MessageType")
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~timed & ~reader.bad, NO_TIME)
        left = timed & ~reader.bad
        both = left & elapsed[1] & logged[1]
        deviation.watch(reader.offset[both], logged[0][both], time_ns[both])
        batches: dict[str, list[RowBatch]] = {kind: [] for kind in topics}
        for word, (kind, field) in _MESSAGES.items():
            selected = left & (message == word)
            left &= ~selected
            fields = {field.format(name): column for name, column in zip(AXES, values, strict=True)}
            if kind == "imu":
                fields["interval_s"] = np.zeros(len(reader))
            batches[kind].append(reader.batch(kind, time_ns, fields, selected))
        yield from reader.rejects(left, "a row of a sensor that is not known")
        for kind, parts in batches.items():
            yield from topics[kind].push(in_file_order(parts))
    for kind, topic in topics.items():
        yield from topic.finish()
        if topic.rows:
            about = {"topic": "uncalibrated", "device_axes": contract.DEVICE_AXES}
            yield SourceMetadata({f"source/{kind}0": about})


def _measurements(file: PhoneFile, axis: ElapsedTimeAxis) -> Iterator[Item]:
    chip, solution = GnssChip("gnss0", axis), _Solution(axis)
    for reader in read_columns(file, HeaderSchema.of(file.head)):
        if isinstance(reader, ColumnReader):
            yield from chip.raw(reader)
            yield from solution.take(reader)
        else:
            yield reader
    yield from chip.finish()
    yield from solution.topic.finish()
    yield SourceMetadata({f"source/{name}": about for name, about in chip.about().items()})
    if solution.topic.rows:
        about = {
            "topic": "WlsPosition",
            "solution": "gnss",
            "solution_basis": "weighted least squares of the measurements, afterwards",
        }
        yield SourceMetadata({"source/wls0": about})


class _Solution:
    """The position that stands in each row of an epoch, once per epoch."""

    def __init__(self, axis: ElapsedTimeAxis) -> None:
        self.topic = MergedTopic("wls0", "gnss/pvt", joins=True)
        self._axis = axis
        self._last = -1

    def take(self, reader: ColumnReader) -> Iterator[Item]:
        """Yield the epochs of a piece; their rows' bytes are the measurements'."""
        import pymap3d

        ecef_m = np.stack([reader.floats(name) for name in _WLS])
        utc_ms = reader.exact(UTC)[0]
        utc = raw_utc(reader, android.receiver_times(reader))
        time_ns, timed = self._axis.times(reader.offset, raw_elapsed(reader), utc, shift=True)
        there = ~np.isnan(ecef_m).any(axis=0) & (np.abs(ecef_m).max(axis=0) > 0)
        placed = np.flatnonzero(timed & ~reader.bad & there)
        if not placed.size:
            return
        before = np.append(self._last, utc_ms[placed][:-1])
        rows = placed[utc_ms[placed] != before]
        self._last = int(utc_ms[placed[-1]])
        lat, lon, height = pymap3d.ecef2geodetic(*ecef_m[:, rows])
        fields = {"lat_deg": lat, "lon_deg": lon, "height_m": height}
        units = np.zeros(rows.size, np.int64)
        yield from self.topic.push(
            RowBatch.of("gnss/pvt", time_ns[rows], fields, reader.offset[rows], units)
        )


def _reference(file: PhoneFile, axis: ElapsedTimeAxis) -> Iterator[Item]:
    topic = MergedTopic("", "reference/pva", joins=True)
    for reader in read_columns(file, HeaderSchema.of(file.head)):
        if not isinstance(reader, ColumnReader):
            yield reader
            continue
        fields = {
            "lat_deg": reader.floats("LatitudeDegrees"),
            "lon_deg": reader.floats("LongitudeDegrees"),
            "height_m": reader.floats("AltitudeMeters"),
        }
        claimed = reader.exact(UNIX, 6)
        time_ns, timed = axis.times(reader.offset, reader.exact(()), claimed, shift=True)
        placed = ~np.isnan(fields["lat_deg"] + fields["lon_deg"])
        good = timed & ~reader.bad
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~timed & ~reader.bad, NO_TIME)
        yield from reader.rejects(~placed & good, NO_POSITION)
        yield from topic.push(reader.batch("reference/pva", time_ns, fields, placed & good))
    yield from topic.finish()
    basis = (
        "the competition's reference receiver; GNSS time, laid on the recording's clock by its "
        "median offset"
    )
    yield SourceMetadata({"source/reference": {"topic": "ground_truth", "basis": basis}})
