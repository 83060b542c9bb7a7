"""Inertial sensors and wheels (ESF-MEAS, ESF-RAW): rows with the sensor's own time ticks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.table import Column
from spoofbench_converters.serial.contract import Rows
from spoofbench_converters.ubx.batch import Batch, Cells, Picked
from spoofbench_converters.ubx.frames import Ints
from spoofbench_converters.ubx.gpstime import MS_NS

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

TICK_BASIS = {
    "ESF-MEAS": "1 ms, as receivers stamp their own sensors; not documented",
    "ESF-RAW": f"1 ms of each message's reserved field, within it {_RAW_TICK_NS / 1e3:g} us, of the BMI160; not documented",
}
"""How long a tick of each message is taken to be, and why."""


@dataclass(slots=True)
class _Counter:
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
        counts = self.total + np.cumsum(_nearest(np.diff(values, prepend=self.last), self.bits))
        self.last, self.total = int(values[-1]), int(counts[-1])
        return np.asarray(counts)


def _nearest(steps: Ints, bits: int) -> Ints:
    """Return steps of a counter of so many bits as the nearest to 0 that they may be."""
    half = 1 << bits - 1
    return np.asarray((steps + half) % (2 * half) - half)


class Sensors:
    """Makes ``imu`` and ``odometer`` rows; numbers the sources as they appear and unwraps their
    counters.
    """

    def __init__(self) -> None:
        self.sources: dict[tuple[str, int], str] = {}
        self._counters: dict[tuple[str, int], _Counter] = {}
        self._raw_tags = _Counter(_RAW_BITS)

    def rows(self, batch: Batch) -> list[Rows]:
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
        batch.refuse(measured.frames[~numbered], f"of a data provider beyond {MAX_SOURCES} sources")
        measured = measured.take(numbered)
        found = []
        for message, number in self.sources:
            if message == "ESF-RAW":
                found += self._raw(batch, raw)
            else:
                found += self._measured(batch, measured.take(measured.head["id"] == number), number)
        for picked in (measured, raw):
            gave = np.zeros(batch.held.number.size, bool)
            for one in found:
                gave[one.frames] = True
            batch.use(picked.frames[gave[picked.frames]])
            batch.refuse(picked.frames[~gave[picked.frames]], "no data of a type in the schema")
        return [one.rows for one in found]

    def _appear(self, measured: Picked, raw: Picked) -> None:
        """Number the sources that appear for the first time."""
        numbers, first = np.unique(measured.head["id"], return_index=True)
        begins = {
            ("ESF-MEAS", int(number)): int(measured.frames[place])
            for number, place in zip(numbers, first, strict=True)
        }
        if raw.frames.size:
            begins["ESF-RAW", 0] = int(raw.frames[0])
        for key in sorted(begins, key=begins.__getitem__):
            if key not in self.sources and len(self.sources) < MAX_SOURCES:
                self.sources[key] = f"imu{len(self.sources)}"
                self._counters[key] = _Counter()

    def _measured(self, batch: Batch, picked: Picked, number: int) -> "list[_Found]":
        if not picked.frames.size:
            return []
        key = "ESF-MEAS", number
        blocks, place = batch.blocks("ESF-MEAS", picked)
        ends = np.ones(place.size, bool)
        ends[:-1] = place[1:] != place[:-1]
        data = ~(
            ends & (picked.head["flags"][place] & 8 > 0)
        )  # a last word may be the time tag in the receiver's clock
        ticks = self._counters[key].unwrap(picked.head["timeTag"].astype(np.int64)) * MS_NS
        place = place[data]
        return _rows(
            batch, self.sources[key], picked.frames[place], ticks[place], blocks["data"][data]
        )

    def _raw(self, batch: Batch, picked: Picked) -> "list[_Found]":
        key = "ESF-RAW", 0
        blocks, place = batch.blocks("ESF-RAW", picked)
        if not blocks.size:
            return []
        tags = blocks["sTtag"].astype(np.int64) & ((1 << _RAW_BITS) - 1)
        first = np.flatnonzero(np.diff(place, prepend=-1))
        message = np.cumsum(np.diff(place, prepend=-1) > 0) - 1
        clock_ms = picked.head["msss"][place[first]].astype(np.int64)
        told = clock_ms > 0
        start_ns = np.zeros(first.size, np.int64)
        start_ns[told] = self._counters[key].unwrap(clock_ms[told]) * MS_NS
        start_ns[~told] = np.rint(self._raw_tags.unwrap(tags[first][~told]) * _RAW_TICK_NS)
        since = _nearest(tags - tags[first][message], _RAW_BITS)
        ticks = start_ns[message] + np.rint(since * _RAW_TICK_NS).astype(np.int64)
        return _rows(batch, self.sources[key], picked.frames[place], ticks, blocks["data"])


@dataclass(frozen=True, slots=True)
class _Found:
    rows: Rows
    frames: Ints


def _rows(
    batch: Batch, source: str, frames: Ints, ticks: Ints, words: NDArray[np.uint32]
) -> list[_Found]:
    """Return rows of data words: types in the upper 6 or 8 bits, signed values in the lower 24."""
    kind = (words >> 24 & 63).astype(np.int64)
    value = (words << 8).view(np.int32).astype(np.int64) >> 8
    found = []
    sensed = np.isin(kind, list(_FIELDS))
    if sensed.any():
        first, row = _instants(ticks[sensed], kind[sensed])
        columns: Cells = {name: np.full(first.size, np.nan) for name, _ in _FIELDS.values()}
        for number, (name, scale) in _FIELDS.items():
            mine = kind[sensed] == number
            columns[name][row[mine]] = value[sensed][mine] * scale
        found.append(
            _Found(
                batch.rows(
                    source, "imu", frames[sensed][first], columns, tick_ns=ticks[sensed][first]
                ),
                frames[sensed],
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
            _Found(
                batch.rows(source, "odometer", frames[rolled], columns, tick_ns=ticks[rolled]),
                frames[rolled],
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
