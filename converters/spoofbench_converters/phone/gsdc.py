"""Google Smartphone Decimeter Challenge (2022 to 2024): ``device_gnss.csv``, ``device_imu.csv`` and
``ground_truth.csv``.

Source: the data description of the competition *smartphone-decimeter-2022*. ``device_gnss.csv`` is
GnssLogger's raw measurements with derived columns, among them a least-squares position per epoch,
which was computed afterwards.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns, Item, SourceMetadata
from spoofbench.conversion.rows import take
from spoofbench_converters.phone import android, contract
from spoofbench_converters.phone.contract import AXES, NO_POSITION, NO_TIME, Options
from spoofbench_converters.phone.files import HeaderSchema, LogFile, only, read_columns, text_parts
from spoofbench_converters.phone.gnss_chip import GnssChip
from spoofbench_converters.phone.gnsslogger_format import ELAPSED, UNIX, UTC, raw_elapsed, raw_utc
from spoofbench_converters.phone.merging import MergedTopic, in_file_order, rejects
from spoofbench_converters.phone.time_axis import PAIRS, ClockDeviation, ElapsedTimeAxis, Pairs
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


def sniff(parts: Sequence[LogFile]) -> float:
    """Return 1 where a file has the columns of the measurements or of the inertial sensors, else
    0.
    """
    return float(any(_is(part, _GNSS) or _is(part, _IMU) for part in parts))


def _is(part: LogFile, columns: frozenset[str]) -> bool:
    return columns <= set(HeaderSchema.of(part.head).names)


def tables(parts: Sequence[LogFile]) -> tuple[LogFile | None, LogFile | None, LogFile | None]:
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


def convert(parts: Sequence[LogFile], options: Options) -> Iterator[Item]:
    """Yield what a drive of one phone holds.

    Raises:
        ConversionError: there are several drives.
    """
    gnss, imu, truth = tables(parts)
    axis, steps = _axis(gnss, imu), ClockDeviation()
    if imu:
        yield from _sensors(imu, axis, steps)
    if gnss:
        yield from _measurements(gnss, axis)
    if truth:
        yield from _reference(truth, axis)
    recording = {
        "clock": "sensor" if axis.offset_ns is not None else "gnss",
        "clock_basis": axis.basis,
        **steps.about(),
    }
    if axis.offset_ns is not None:
        recording |= {
            "boot_unix_ns": str(axis.offset_ns),
            "gnss_minus_clock_ns": str(-axis.shift_ns),
        }
    yield SourceMetadata(
        {"recording": recording | ({"session_id": options.session} if options.session else {})}
    )
    yield from (part.passed_over() for part in parts if part not in (gnss, imu, truth))


def _axis(gnss: LogFile | None, imu: LogFile | None) -> ElapsedTimeAxis:
    none = np.empty(0, np.int64)
    sensors, raw = (none, none), (none, none)
    if imu and (reader := _first(imu)):
        sensors = _pairs(*reader.exact(ELAPSED), *reader.exact(UTC, 6))
    if gnss and (reader := _first(gnss)):
        raw = _pairs(*raw_elapsed(reader), *raw_utc(reader, android.receiver_times(reader)))
    return ElapsedTimeAxis.of(sensors, (none, none), raw)


def _first(part: LogFile) -> ColumnReader | None:
    return next(
        (
            item
            for item in read_columns(part, HeaderSchema.of(part.head))
            if isinstance(item, ColumnReader)
        ),
        None,
    )


def _pairs(
    elapsed: NDArray[np.int64],
    has: NDArray[np.bool_],
    utc: NDArray[np.int64],
    also: NDArray[np.bool_],
) -> Pairs:
    both = has & also & (elapsed > 0) & (utc > 0)
    return elapsed[both][:PAIRS], utc[both][:PAIRS]


def _sensors(part: LogFile, axis: ElapsedTimeAxis, steps: ClockDeviation) -> Iterator[Item]:
    streams = {
        "imu": MergedTopic(
            "imu0", "imu", (*contract.ACCEL, *contract.GYRO, "interval_s"), window_s=_BATCHING_S
        ),
        "mag": MergedTopic("mag0", "mag", contract.MAG, window_s=_BATCHING_S),
    }
    for reader in read_columns(part, HeaderSchema.of(part.head)):
        if not isinstance(reader, ColumnReader):
            yield reader
            continue
        logged = reader.exact(UTC, 6)
        elapsed = reader.exact(ELAPSED)
        times, timed = axis.times(reader.account()["offset"], elapsed, logged)
        values = [reader.floats(f"Measurement{name.upper()}") for name in AXES]
        account, kind = reader.account(), reader.words("MessageType")
        yield from rejects(account, reader.bad, NOT_A_NUMBER)
        yield from rejects(account, ~timed & ~reader.bad, NO_TIME)
        left = timed & ~reader.bad
        watched = left & elapsed[1] & logged[1]
        steps.watch(account["offset"][watched], logged[0][watched], times[watched])
        pushes: dict[str, list[Columns]] = {name: [] for name in streams}
        for word, (family, field) in _MESSAGES.items():
            mine = left & (kind == word)
            left &= ~mine
            fields = {field.format(name): column for name, column in zip(AXES, values, strict=True)}
            extra = {"interval_s": np.zeros(len(reader))} if family == "imu" else {}
            pushes[family].append(
                streams[family].complete(
                    take({**account, **fields, **extra, "time_ns": times}, mine)
                )
            )
        yield from rejects(account, left, "a row of a sensor that is not known")
        for family, columns in pushes.items():
            yield from streams[family].push(in_file_order(columns))
    for stream in streams.values():
        yield from stream.finish()
        if stream.rows:
            about = {"topic": "uncalibrated", "device_axes": contract.DEVICE_AXES}
            yield SourceMetadata({f"source/{stream.topic.split('/')[1]}": about})


def _measurements(part: LogFile, axis: ElapsedTimeAxis) -> Iterator[Item]:
    chip, solution = GnssChip("gnss0", axis), _Solution(axis)
    for reader in read_columns(part, HeaderSchema.of(part.head)):
        if isinstance(reader, ColumnReader):
            yield from chip.raw(reader)
            yield from solution.take(reader)
        else:
            yield reader
    yield from chip.finish()
    yield from solution.stream.finish()
    yield SourceMetadata({f"source/{name}": about for name, about in chip.about().items()})
    if solution.stream.rows:
        about = {
            "topic": "WlsPosition",
            "solution": "gnss",
            "solution_basis": "weighted least squares of the measurements, afterwards",
        }
        yield SourceMetadata({"source/wls0": about})


class _Solution:
    """The position that stands in each row of an epoch, once per epoch."""

    def __init__(self, axis: ElapsedTimeAxis) -> None:
        self.stream = MergedTopic("wls0", "gnss/pvt", ("lat_deg", "lon_deg", "height_m"))
        self._axis = axis
        self._last = -1

    def take(self, reader: ColumnReader) -> Iterator[Item]:
        """Yield the epochs of a piece; their rows' bytes are the measurements'."""
        import pymap3d

        ecef = np.stack([reader.floats(name) for name in _WLS])
        utc, offsets = reader.exact(UTC)[0], reader.account()["offset"]
        times, timed = self._axis.times(
            offsets,
            raw_elapsed(reader),
            raw_utc(reader, android.receiver_times(reader)),
            shift=True,
        )
        placed = np.flatnonzero(
            timed & ~reader.bad & ~np.isnan(ecef).any(axis=0) & (np.abs(ecef).max(axis=0) > 0)
        )
        if not placed.size:
            return
        before = np.concatenate([[self._last], utc[placed][:-1]])
        rows = placed[utc[placed] != before]
        self._last = int(utc[placed[-1]])
        lat, lon, height = pymap3d.ecef2geodetic(*ecef[:, rows])
        account = {"offset": offsets[rows], "length": np.zeros(rows.size, np.int64)}
        yield from self.stream.push(
            {"time_ns": times[rows], "lat_deg": lat, "lon_deg": lon, "height_m": height, **account}
        )


def _reference(part: LogFile, axis: ElapsedTimeAxis) -> Iterator[Item]:
    stream = MergedTopic("", "reference/pva", ("lat_deg", "lon_deg", "height_m"))
    for reader in read_columns(part, HeaderSchema.of(part.head)):
        if not isinstance(reader, ColumnReader):
            yield reader
            continue
        columns: Columns = {
            "lat_deg": reader.floats("LatitudeDegrees"),
            "lon_deg": reader.floats("LongitudeDegrees"),
            "height_m": reader.floats("AltitudeMeters"),
            **reader.account(),
        }
        columns["time_ns"], timed = axis.times(
            columns["offset"], reader.exact(()), reader.exact(UNIX, 6), shift=True
        )
        placed = ~np.isnan(columns["lat_deg"] + columns["lon_deg"])
        yield from rejects(columns, reader.bad, NOT_A_NUMBER)
        yield from rejects(columns, ~timed & ~reader.bad, NO_TIME)
        yield from rejects(columns, ~placed & timed & ~reader.bad, NO_POSITION)
        yield from stream.push(take(columns, placed & timed & ~reader.bad))
    yield from stream.finish()
    basis = (
        "the competition's reference receiver; GNSS time, laid on the recording's clock by its "
        "median offset"
    )
    yield SourceMetadata({"source/reference": {"topic": "ground_truth", "basis": basis}})
