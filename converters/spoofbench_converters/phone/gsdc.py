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
from spoofbench_converters.phone import android, device
from spoofbench_converters.phone.axis import PAIRS, Axis, Pairs, Steps
from spoofbench_converters.phone.chip import Chip
from spoofbench_converters.phone.device import AXES, NO_POSITION, NO_TIME
from spoofbench_converters.phone.gnssform import ELAPSED, UNIX, UTC, raw_elapsed, raw_utc
from spoofbench_converters.phone.options import Options
from spoofbench_converters.phone.parts import Form, Part, only, sheets, text_parts
from spoofbench_converters.phone.sheets import NOT_A_NUMBER, Sheet
from spoofbench_converters.phone.streams import Stream, in_file_order, rejects

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


def sniff(parts: Sequence[Part]) -> float:
    """Return 1 where a file has the columns of the measurements or of the inertial sensors, else
    0.
    """
    return float(any(_is(part, _GNSS) or _is(part, _IMU) for part in parts))


def _is(part: Part, columns: frozenset[str]) -> bool:
    return columns <= set(Form.of(part.head).names)


def tables(parts: Sequence[Part]) -> tuple[Part | None, Part | None, Part | None]:
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


def convert(parts: Sequence[Part], options: Options) -> Iterator[Item]:
    """Yield what a drive of one phone holds.

    Raises:
        ConversionError: there are several drives.
    """
    gnss, imu, truth = tables(parts)
    axis, steps = _axis(gnss, imu), Steps()
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


def _axis(gnss: Part | None, imu: Part | None) -> Axis:
    none = np.empty(0, np.int64)
    sensors, raw = (none, none), (none, none)
    if imu and (sheet := _first(imu)):
        sensors = _pairs(*sheet.exact(ELAPSED), *sheet.exact(UTC, 6))
    if gnss and (sheet := _first(gnss)):
        raw = _pairs(*raw_elapsed(sheet), *raw_utc(sheet, android.receiver_times(sheet)))
    return Axis.of(sensors, (none, none), raw)


def _first(part: Part) -> Sheet | None:
    return next(
        (item for item in sheets(part, Form.of(part.head)) if isinstance(item, Sheet)), None
    )


def _pairs(
    elapsed: NDArray[np.int64],
    has: NDArray[np.bool_],
    utc: NDArray[np.int64],
    also: NDArray[np.bool_],
) -> Pairs:
    both = has & also & (elapsed > 0) & (utc > 0)
    return elapsed[both][:PAIRS], utc[both][:PAIRS]


def _sensors(part: Part, axis: Axis, steps: Steps) -> Iterator[Item]:
    streams = {
        "imu": Stream(
            "imu0", "imu", (*device.ACCEL, *device.GYRO, "interval_s"), window_s=_BATCHING_S
        ),
        "mag": Stream("mag0", "mag", device.MAG, window_s=_BATCHING_S),
    }
    for sheet in sheets(part, Form.of(part.head)):
        if not isinstance(sheet, Sheet):
            yield sheet
            continue
        logged = sheet.exact(UTC, 6)
        elapsed = sheet.exact(ELAPSED)
        times, timed = axis.times(sheet.account()["offset"], elapsed, logged)
        values = [sheet.floats(f"Measurement{name.upper()}") for name in AXES]
        account, kind = sheet.account(), sheet.words("MessageType")
        yield from rejects(account, sheet.bad, NOT_A_NUMBER)
        yield from rejects(account, ~timed & ~sheet.bad, NO_TIME)
        left = timed & ~sheet.bad
        watched = left & elapsed[1] & logged[1]
        steps.watch(account["offset"][watched], logged[0][watched], times[watched])
        pushes: dict[str, list[Columns]] = {name: [] for name in streams}
        for word, (family, field) in _MESSAGES.items():
            mine = left & (kind == word)
            left &= ~mine
            fields = {field.format(name): column for name, column in zip(AXES, values, strict=True)}
            extra = {"interval_s": np.zeros(len(sheet))} if family == "imu" else {}
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
            about = {"topic": "uncalibrated", "device_axes": device.DEVICE_AXES}
            yield SourceMetadata({f"source/{stream.topic.split('/')[1]}": about})


def _measurements(part: Part, axis: Axis) -> Iterator[Item]:
    chip, solution = Chip("gnss0", axis), _Solution(axis)
    for sheet in sheets(part, Form.of(part.head)):
        if isinstance(sheet, Sheet):
            yield from chip.raw(sheet)
            yield from solution.take(sheet)
        else:
            yield sheet
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

    def __init__(self, axis: Axis) -> None:
        self.stream = Stream("wls0", "gnss/pvt", ("lat_deg", "lon_deg", "height_m"))
        self._axis = axis
        self._last = -1

    def take(self, sheet: Sheet) -> Iterator[Item]:
        """Yield the epochs of a piece; their rows' bytes are the measurements'."""
        import pymap3d

        ecef = np.stack([sheet.floats(name) for name in _WLS])
        utc, offsets = sheet.exact(UTC)[0], sheet.account()["offset"]
        times, timed = self._axis.times(
            offsets, raw_elapsed(sheet), raw_utc(sheet, android.receiver_times(sheet)), shift=True
        )
        placed = np.flatnonzero(
            timed & ~sheet.bad & ~np.isnan(ecef).any(axis=0) & (np.abs(ecef).max(axis=0) > 0)
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


def _reference(part: Part, axis: Axis) -> Iterator[Item]:
    stream = Stream("", "reference/pva", ("lat_deg", "lon_deg", "height_m"))
    for sheet in sheets(part, Form.of(part.head)):
        if not isinstance(sheet, Sheet):
            yield sheet
            continue
        columns: Columns = {
            "lat_deg": sheet.floats("LatitudeDegrees"),
            "lon_deg": sheet.floats("LongitudeDegrees"),
            "height_m": sheet.floats("AltitudeMeters"),
            **sheet.account(),
        }
        columns["time_ns"], timed = axis.times(
            columns["offset"], sheet.exact(()), sheet.exact(UNIX, 6), shift=True
        )
        placed = ~np.isnan(columns["lat_deg"] + columns["lon_deg"])
        yield from rejects(columns, sheet.bad, NOT_A_NUMBER)
        yield from rejects(columns, ~timed & ~sheet.bad, NO_TIME)
        yield from rejects(columns, ~placed & timed & ~sheet.bad, NO_POSITION)
        yield from stream.push(take(columns, placed & timed & ~sheet.bad))
    yield from stream.finish()
    basis = (
        "the competition's reference receiver; GNSS time, laid on the recording's clock by its "
        "median offset"
    )
    yield SourceMetadata({"source/reference": {"topic": "ground_truth", "basis": basis}})
