"""Inertial sensors and wheels (ESF-MEAS, ESF-RAW), and the solution integrated from them (NAV-ATT,
ESF-INS, HNR).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Floats, Ints
from spoofbench.gnss_time import wrap_difference
from spoofbench.table import Column
from spoofbench_converters.serial.contract import EpochRows
from spoofbench_converters.ubx.batch import (
    NO_ACCURACY,
    EpochBatch,
    EpochColumns,
    FieldColumns,
    MessageFrames,
    scaled,
)
from spoofbench_converters.ubx.grouping import WEEK_MS
from spoofbench_converters.ubx.solution import llh
from spoofbench_converters.ubx.times import MS_NS, EpochTimes

# by data type; u-blox M8 receiver description (UBX-13003221), section ESF Measurement Data
_FIELDS = {
    5: ("gyro_z_radps", np.pi / 180 * 2**-12),
    12: ("temperature_degc", 1e-2),
    13: ("gyro_y_radps", np.pi / 180 * 2**-12),
    14: ("gyro_x_radps", np.pi / 180 * 2**-12),
    16: ("accel_x_mps2", 2**-10),
    17: ("accel_y_mps2", 2**-10),
    18: ("accel_z_mps2", 2**-10),
}
_WHEELS = {6: "front-left", 7: "front-right", 8: "rear-left", 9: "rear-right", 10: "single"}
_WORDS = tuple(_WHEELS.values())
_SPEED, _SPEED_MPS = 11, 1e-3
MAX_SOURCES = 16
"""As many as a log may have, so that memory is bounded."""
_TICKS = (1 << 23) - 1  # the top bit is the direction

_RAW_BITS, _RAW_TICK_NS = 24, 39_062.5
"""The counter of ESF-RAW, which no interface description tells: SENSORTIME of the Bosch BMI160 in
u-blox M8 receivers (its data sheet). A receiver's own was 0.3 % slow, so it counts within a message
alone: from one to the next the milliseconds since start-up count, in the field that the
descriptions reserve, if they are there."""

_RATE_RADPS = np.pi / 180 * 1e-3
_NO_VALUE = "no value valid"

TICK_BASIS = {
    "ESF-MEAS": "1 ms, as receivers stamp their own sensors; not documented",
    "ESF-RAW": (
        f"1 ms of each message's reserved field, within it {_RAW_TICK_NS / 1e3:g} us, of the "
        "BMI160; not documented"
    ),
}
"""How long a tick of each message is taken to be, and why."""


@dataclass(slots=True)
class _WrappingCounter:
    """A counter that wraps, unwrapped as far as it has been read."""

    bits: int = 32
    last: int | None = None
    total: int = 0

    def unwrap(self, values: Ints) -> Ints:
        """Continue the count; a step is the nearest."""
        if not values.size:
            return values
        if self.last is None:
            self.last = self.total = int(values[0])
        counts = self.total + np.cumsum(
            wrap_difference(np.diff(values, prepend=self.last), 1 << self.bits)
        )
        self.last, self.total = int(values[-1]), int(counts[-1])
        return np.asarray(counts)


class UbxSensors:
    """Makes ``imu`` and ``odometer`` rows; numbers the sources as they appear and unwraps their
    counters.
    """

    def __init__(self) -> None:
        self.sources: dict[tuple[str, int], str] = {}
        self._counters: dict[tuple[str, int], _WrappingCounter] = {}
        self._raw_tags = _WrappingCounter(_RAW_BITS)

    def rows(self, batch: EpochBatch) -> list[EpochRows]:
        """Return the rows of a batch.

        Data of one tick are one row. ESF-MEAS data are those that the receiver uses, of each
        provider a source; ESF-RAW data are those of its inner sensor before that. Both are
        uncalibrated. Specific force in m/s^2, rates in rad/s.
        """
        measured, raw = batch.all_of("ESF-MEAS"), batch.all_of("ESF-RAW")
        self._appear(measured, raw)
        numbered = np.isin(
            measured.head["id"],
            [number for message, number in self.sources if message == "ESF-MEAS"],
        )
        batch.refuse(measured.index[~numbered], f"of a data provider beyond {MAX_SOURCES} sources")
        measured = measured.take(numbered)
        found = []
        for message, number in self.sources:
            if message == "ESF-RAW":
                found += self._raw(batch, raw)
            else:
                found += self._measured(batch, measured.take(measured.head["id"] == number), number)
        for frames in (measured, raw):
            gave = np.zeros(batch.buffer.number.size, bool)
            for one in found:
                gave[one.index] = True
            batch.use(frames.index[gave[frames.index]])
            batch.refuse(frames.index[~gave[frames.index]], "no data of a type in the schema")
        return [one.rows for one in found]

    def _appear(self, measured: MessageFrames, raw: MessageFrames) -> None:
        """Number the sources that appear for the first time."""
        numbers, first = np.unique(measured.head["id"], return_index=True)
        begins = {
            ("ESF-MEAS", int(number)): int(measured.index[row])
            for number, row in zip(numbers, first, strict=True)
        }
        if raw.index.size:
            begins["ESF-RAW", 0] = int(raw.index[0])
        for key in sorted(begins, key=begins.__getitem__):
            if key not in self.sources and len(self.sources) < MAX_SOURCES:
                self.sources[key] = f"imu{len(self.sources)}"
                self._counters[key] = _WrappingCounter()

    def _measured(
        self, batch: EpochBatch, frames: MessageFrames, number: int
    ) -> "list[_SensorRows]":
        if not frames.index.size:
            return []
        key = "ESF-MEAS", number
        blocks, owner = batch.blocks("ESF-MEAS", frames)
        ends = np.ones(owner.size, bool)
        ends[:-1] = owner[1:] != owner[:-1]
        # a last word may be the time tag in the receiver's clock
        data = ~(ends & (frames.head["flags"][owner] & 8 > 0))
        ticks = self._counters[key].unwrap(frames.head["timeTag"].astype(np.int64)) * MS_NS
        owner = owner[data]
        return _rows(
            batch, self.sources[key], frames.index[owner], ticks[owner], blocks["data"][data]
        )

    def _raw(self, batch: EpochBatch, frames: MessageFrames) -> "list[_SensorRows]":
        key = "ESF-RAW", 0
        blocks, owner = batch.blocks("ESF-RAW", frames)
        if not blocks.size:
            return []
        tags = blocks["sTtag"].astype(np.int64) & ((1 << _RAW_BITS) - 1)
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        message = np.cumsum(np.diff(owner, prepend=-1) > 0) - 1
        clock_ms = frames.head["msss"][owner[first]].astype(np.int64)
        reported = clock_ms > 0
        start_ns = np.zeros(first.size, np.int64)
        start_ns[reported] = self._counters[key].unwrap(clock_ms[reported]) * MS_NS
        start_ns[~reported] = np.rint(self._raw_tags.unwrap(tags[first][~reported]) * _RAW_TICK_NS)
        since = wrap_difference(tags - tags[first][message], 1 << _RAW_BITS)
        ticks = start_ns[message] + np.rint(since * _RAW_TICK_NS).astype(np.int64)
        return _rows(batch, self.sources[key], frames.index[owner], ticks, blocks["data"])


@dataclass(frozen=True, slots=True, eq=False)
class _SensorRows:
    """Rows, and the frames that they came from, int64 ``(k,)``."""

    rows: EpochRows
    index: Ints


def _rows(
    batch: EpochBatch, source: str, index: Ints, ticks: Ints, words: NDArray[np.uint32]
) -> list[_SensorRows]:
    """Return rows of data words: types in the upper 6 or 8 bits, signed values in the lower 24."""
    kind = (words >> 24 & 63).astype(np.int64)
    value = (words << 8).view(np.int32).astype(np.int64) >> 8
    found = []
    sensed = np.isin(kind, list(_FIELDS))
    if sensed.any():
        first, row = _instants(ticks[sensed], kind[sensed])
        columns: FieldColumns = {name: np.full(first.size, np.nan) for name, _ in _FIELDS.values()}
        for number, (name, scale) in _FIELDS.items():
            chosen = kind[sensed] == number
            columns[name][row[chosen]] = value[sensed][chosen] * scale
        found.append(
            _SensorRows(
                batch.rows(
                    source, "imu", index[sensed][first], columns, tick_ns=ticks[sensed][first]
                ),
                index[sensed],
            )
        )
    rolled = (kind == _SPEED) | np.isin(kind, list(_WHEELS))
    if rolled.any():
        of_wheel = np.full(64, -1, np.int32)
        of_wheel[list(_WHEELS)] = np.arange(len(_WHEELS))
        wheel, speed = of_wheel[kind[rolled]], kind[rolled] == _SPEED
        columns = {
            "speed_mps": np.where(speed, value[rolled] * _SPEED_MPS, np.nan),
            "ticks": Column(np.where(speed, 0, words[rolled] & _TICKS).astype(np.int64), ~speed),
            "wheel": Column(wheel, None, _WORDS),
        }
        found.append(
            _SensorRows(
                batch.rows(source, "odometer", index[rolled], columns, tick_ns=ticks[rolled]),
                index[rolled],
            )
        )
    return found


def _instants(ticks: Ints, kind: Ints) -> tuple[Ints, Ints]:
    """Group neighbouring data of one tick into instants; return the first datum of each, and the
    instant of each datum.

    A type that comes again begins another instant.
    """
    fresh = np.ones(ticks.size, bool)
    fresh[1:] = ticks[1:] != ticks[:-1]
    row = np.cumsum(fresh) - 1
    order = np.lexsort((np.arange(kind.size), kind, row))
    again = np.zeros(kind.size, bool)
    again[order[1:]] = (row[order[1:]] == row[order[:-1]]) & (kind[order[1:]] == kind[order[:-1]])
    fresh |= again
    return np.flatnonzero(fresh), np.cumsum(fresh) - 1


def rates(head: NDArray[np.void]) -> dict[str, Floats]:
    """Return rates (deg/s to rad/s) and accelerations without gravity of UBX-ESF-INS and -HNR-INS,
    ``(n,)`` each, NaN where their flags are clear.
    """
    columns = {}
    for bit, (name, field, scale) in enumerate(
        (
            ("rate_x_radps", "xAngRate", _RATE_RADPS), ("rate_y_radps", "yAngRate", _RATE_RADPS),
            ("rate_z_radps", "zAngRate", _RATE_RADPS),
            ("linear_accel_x_mps2", "xAccel", 1e-2), ("linear_accel_y_mps2", "yAccel", 1e-2),
            ("linear_accel_z_mps2", "zAccel", 1e-2),
        ), 8,
    ):  # fmt: skip
        columns[name] = np.where(head["flags"] >> bit & 1 > 0, head[field] * scale, np.nan)
    return columns


def angles(head: NDArray[np.void]) -> dict[str, Floats]:
    """Return roll, pitch, heading of UBX-NAV-ATT and -HNR-ATT, and the largest of their accuracies,
    ``(n,)`` each; NaN where all accuracies read 0.
    """
    accuracy = np.max([head["accRoll"], head["accPitch"], head["accHeading"]], axis=0)
    unset = accuracy == 0
    columns = {
        "roll_deg": head["roll"],
        "pitch_deg": head["pitch"],
        "yaw_deg": head["heading"],
        "attitude_acc_deg": accuracy,
    }
    return {name: np.where(unset, np.nan, values * 1e-5) for name, values in columns.items()}


def navigation(batch: EpochBatch, source: str) -> list[EpochRows]:
    """Return one row per epoch of NAV-ATT, ESF-INS, NAV-PVAT, and of NAV-PVT with a vehicle
    heading, where any value is valid.
    """
    fields = EpochColumns(batch.count)
    frames = {name: batch.one_of(name) for name in ("NAV-ATT", "ESF-INS", "NAV-PVAT", "NAV-PVT")}
    fields.fill(frames["NAV-ATT"].epoch, **angles(frames["NAV-ATT"].head))
    fields.fill(frames["ESF-INS"].epoch, **rates(frames["ESF-INS"].head))
    _vehicle(fields, frames["NAV-PVAT"])
    pvt = frames["NAV-PVT"]
    fields.fill(
        pvt.epoch, yaw_deg=np.where(pvt.head["flags"] & 32 > 0, pvt.head["headVeh"] * 1e-5, np.nan)
    )
    reported = np.zeros(batch.count, bool)
    for name in fields:
        reported |= ~np.isnan(fields[name])
    for name in ("NAV-ATT", "ESF-INS"):
        valid = np.zeros(frames[name].index.size, bool)
        for values in (angles if name == "NAV-ATT" else rates)(frames[name].head).values():
            valid |= ~np.isnan(values)
        batch.use(frames[name].index[valid])
        batch.refuse(frames[name].index[~valid], _NO_VALUE)
    if not reported.any():
        return []
    return [
        EpochRows.of(
            source,
            "ins/pva",
            np.flatnonzero(reported),
            {name: fields[name][reported] for name in fields},
        )
    ]


def _vehicle(fields: EpochColumns, frames: MessageFrames) -> None:
    """Take position, velocity and the valid angles of NAV-PVAT where it has a fix."""
    head, epoch = frames.head, frames.epoch
    flags = head["flags"]
    none = (flags & 1 == 0) | (head["fixType"] == 0)
    fields.fill_together(epoch, **llh(head, none))
    velocity = {
        f"vel_{axis.lower()}_mps": np.where(none, np.nan, head[f"vel{axis}"] * 1e-3)
        for axis in "NED"
    }
    fields.fill(epoch, **velocity)
    accuracy = {"h_acc_m": "hAcc", "v_acc_m": "vAcc", "s_acc_mps": "sAcc"}
    fields.fill(
        epoch,
        **{
            name: np.where(none, np.nan, scaled(head[field], 1e-3, NO_ACCURACY))
            for name, field in accuracy.items()
        },
    )
    largest = np.full(epoch.size, np.nan)
    for bit, name, field, spread in (
        (8, "roll_deg", "vehRoll", "accRoll"),
        (16, "pitch_deg", "vehPitch", "accPitch"),
        (32, "yaw_deg", "vehHeading", "accHeading"),
    ):
        valid = flags & bit > 0
        fields.fill(epoch, **{name: np.where(valid, head[field] * 1e-5, np.nan)})
        largest = np.fmax(largest, np.where(valid, head[spread] * 1e-2, np.nan))
    fields.fill(epoch, attitude_acc_deg=largest)


def high_rate(batch: EpochBatch, times: EpochTimes, source: str) -> list[EpochRows]:
    """Return one row per instant of HNR-PVT, HNR-ATT and HNR-INS, where any value is valid.

    HNR-PVT has the speed over ground and no components of velocity, which the schema's row cannot
    hold.
    """
    frames = [batch.all_of(name) for name in ("HNR-PVT", "HNR-ATT", "HNR-INS")]
    epoch = np.concatenate([one.epoch for one in frames])
    if not epoch.size:
        return []
    time = np.concatenate([one.head["iTOW"] for one in frames]).astype(np.int64)
    index = np.concatenate([one.index for one in frames])
    first, instant = _high_rate_instants(index, epoch, time)
    fields = EpochColumns(first.size)
    valid = np.zeros(index.size, bool)
    start = 0
    for one, read in zip(frames, (_high_rate_pvt, angles, rates), strict=True):
        chosen = slice(start, start + one.index.size)
        for name, values in read(one.head).items():
            fields.fill(instant[chosen], **{name: values})
            valid[chosen] |= ~np.isnan(values)
        start += one.index.size
    batch.use(index[valid])
    for one in frames:
        batch.refuse(one.index[~np.isin(one.index, index[valid])], _NO_VALUE)
    reported = np.isin(np.arange(first.size), instant[valid])
    first = first[reported]
    after = wrap_difference(time[first] - np.maximum(times.time_ms[epoch[first]], 0), WEEK_MS)
    columns = {name: fields[name][reported] for name in fields}
    return [batch.rows(source, "ins/pva", index[first], columns, offset_ns=after * MS_NS)]


def _high_rate_instants(index: Ints, epoch: Ints, time: Ints) -> tuple[Ints, Ints]:
    """Return the first frame of each instant within its epoch, in file order, and the instant of
    each frame.
    """
    order = np.argsort(index, kind="stable")
    pairs = np.stack([epoch[order], time[order]])
    _, first, inverse = np.unique(pairs, axis=1, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    instant = np.empty(index.size, np.int64)
    instant[order] = rank[inverse.ravel()]
    return order[np.sort(first)], instant


def _high_rate_pvt(head: NDArray[np.void]) -> dict[str, Floats]:
    none = (head["flags"] & 1 == 0) | (head["gpsFix"] == 0)
    columns = llh(head, none)
    for name, field in (("h_acc_m", "hAcc"), ("v_acc_m", "vAcc"), ("s_acc_mps", "sAcc")):
        columns[name] = np.where(none, np.nan, scaled(head[field], 1e-3, NO_ACCURACY))
    columns["yaw_deg"] = np.where(head["flags"] & 16 > 0, head["headVeh"] * 1e-5, np.nan)
    return columns
