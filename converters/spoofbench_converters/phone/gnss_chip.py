"""The GNSS chip of an Android phone: raw measurements, its clock, gain control, satellites in view,
navigation messages.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Item, RowBatch
from spoofbench.table import Column, encode_categories
from spoofbench_converters.phone import android
from spoofbench_converters.phone.contract import NO_TIME, positive
from spoofbench_converters.phone.gnsslogger_format import raw_elapsed, raw_utc
from spoofbench_converters.phone.merging import MergedTopic, in_file_order
from spoofbench_converters.phone.time_axis import ElapsedTimeAxis, Stamps
from spoofbench_converters.text import numbers
from spoofbench_converters.text.columns import NOT_A_NUMBER, ColumnReader, Fields

_MAX_PER_EPOCH = 10_000

# Types of GnssNavigationMessage: the first byte is the constellation; the RINEX signal by the
# whole.
_MESSAGE_SIGNALS = {
    0x0101: "1C",
    0x0102: "2",
    0x0103: "5",
    0x0104: "1",
    0x0201: "1C",
    0x0301: "1C",
    0x0401: "1C",
    0x0501: "2I",
    0x0502: "2I",
    0x0503: "1",
    0x0504: "5",
    0x0601: "1B",
    0x0602: "5I",
    0x0701: "5",
}


class GnssChip:
    """What the chip says, as the topics of one source.

    Attributes:
        latest: where the raw measurements taken last lie in the log, and their times; int64
            ``(n,)`` each.
    """

    def __init__(self, source: str, axis: ElapsedTimeAxis) -> None:
        self.source, self._axis = source, axis
        self._observations = MergedTopic(source, "gnss/observation")
        self._clock = MergedTopic(source, "gnss/clock", joins=True)
        self._rf = MergedTopic(source, "gnss/rf")
        self._signals = MergedTopic(source, "gnss/signal")
        self._navdata = MergedTopic(source, "gnss/navdata")
        self._held: _Measurements | None = None
        self._bias_origin_ns: int | None = None
        self._order = _FileOrder()
        self.latest = (np.empty(0, np.int64), np.empty(0, np.int64))

    def piece(self, offsets: NDArray[np.int64], times_ns: NDArray[np.int64]) -> None:
        """Take where the timed rows of the next piece lie, and their times: satellites in view and
        messages have none.
        """
        self._order.piece(offsets, times_ns)

    def raw(self, reader: ColumnReader) -> Iterator[Item]:
        """Take raw measurements."""
        times, seen = android.receiver_times(reader), android.satellites(reader)
        observed = android.observations(reader, seen, times)
        clock = {**android.clock_columns(reader), "bias_s": self._bias_s(reader, times)}
        gain: Fields = {"agc_db": reader.floats("AgcDb"), "band": _bands(seen)}
        epoch = reader.exact(("TimeNanos",))[0]
        claimed = raw_utc(reader, times)
        time_ns, timed = self._axis.times(reader.offset, raw_elapsed(reader), claimed, shift=True)
        clock["host_offset_s"] = np.where(
            times.known, (claimed[0] - time_ns + times.rest_ns) * 1e-9, np.nan
        )
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~timed & ~reader.bad, NO_TIME)
        kept = timed & ~reader.bad
        rows = _Measurements(
            epoch[kept],
            reader.batch("gnss/observation", time_ns, observed, kept),
            _unaccounted(reader.batch("gnss/clock", time_ns, clock, kept)),
            _unaccounted(reader.batch("gnss/rf", time_ns, gain, kept)),
        )
        self.latest = (rows.observed.offset, rows.observed.time_ns)
        yield from self._epochs(rows)

    def agc(self, reader: ColumnReader) -> Iterator[Item]:
        """Take rows of gain control."""
        times, seen = android.receiver_times(reader), android.satellites(reader)
        gain: Fields = {"agc_db": reader.floats("AgcDb"), "band": _bands(seen)}
        claimed = raw_utc(reader, times)
        time_ns, timed = self._axis.times(reader.offset, reader.exact(()), claimed, shift=True)
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~timed & ~reader.bad, NO_TIME)
        yield from self._rf.push(reader.batch("gnss/rf", time_ns, gain, timed & ~reader.bad))

    def status(self, reader: ColumnReader) -> Iterator[Item]:
        """Take rows of satellites in view; their time is that of the timed row before their epoch's
        first one.
        """
        used, has_used = reader.exact(("UsedInFix",))
        seen = android.satellites(reader).columns
        signals = {
            **{name: seen[name] for name in ("constellation", "svid", "signal")},
            "cn0_dbhz": positive(reader.floats("Cn0DbHz")),
            "elevation_deg": reader.floats("ElevationDegrees"),
            "azimuth_deg": reader.floats("AzimuthDegrees"),
            "used": Column(used != 0, has_used),
        }
        index = reader.exact(("SignalIndex",))[0]
        time_ns, timed = self._order.epochs(reader.offset, index)
        yield from reader.rejects(reader.bad, NOT_A_NUMBER)
        yield from reader.rejects(~timed & ~reader.bad, NO_TIME)
        kept = timed & ~reader.bad
        yield from self._signals.push(reader.batch("gnss/signal", time_ns, signals, kept))

    def navigation(self, readers: Sequence[ColumnReader]) -> Iterator[Item]:
        """Take navigation messages, those of each length by themselves; their time is that of the
        timed row before them.
        """
        batches = []
        for reader in readers:
            messages, bad = _messages(reader)
            time_ns, timed = self._order.times(reader.offset)
            bad |= reader.bad
            yield from reader.rejects(bad, NOT_A_NUMBER)
            yield from reader.rejects(~timed & ~bad, NO_TIME)
            batches.append(reader.batch("gnss/navdata", time_ns, messages, timed & ~bad))
        yield from self._navdata.push(in_file_order(batches))

    def finish(self) -> Iterator[Item]:
        """Yield what is held."""
        if self._held is not None:
            yield from self._complete(self._held)
        for topic in (self._observations, self._clock, self._rf, self._signals, self._navdata):
            yield from topic.finish()

    def about(self) -> Mapping[str, dict[str, str]]:
        """Return the source's metadata, if it gave anything."""
        streams = {
            "Raw": self._observations,
            "Agc": self._rf,
            "Status": self._signals,
            "Nav": self._navdata,
        }
        topic = " ".join(name for name, stream in streams.items() if stream.rows)
        if not topic:
            return {}
        about = {"topic": topic}
        if self._bias_origin_ns is not None:
            about["clock_bias_origin_ns"] = str(self._bias_origin_ns)
        return {self.source: about}

    def _bias_s(self, reader: ColumnReader, times: android.Times) -> NDArray[np.float64]:
        """Return the clock's bias beyond that of the first row that has one, for doubles of decades
        have no nanoseconds.
        """
        full = reader.exact(("FullBiasNanos",))[0]
        if self._bias_origin_ns is None and times.known.any():
            self._bias_origin_ns = int(full[np.argmax(times.known)])
        beyond = full - (self._bias_origin_ns or 0) + np.nan_to_num(reader.floats("BiasNanos"))
        return np.where(times.known, beyond * 1e-9, np.nan)

    def _epochs(self, rows: "_Measurements") -> Iterator[Item]:
        """Hold the last epoch until it is complete."""
        rows = self._held.followed_by(rows) if self._held else rows
        epoch = rows.epoch
        last = int(epoch.size and np.argmax(epoch[::-1] != epoch[-1]))
        whole = epoch.size - last if last or epoch.size > _MAX_PER_EPOCH else 0
        self._held = rows.take(slice(whole, None))
        yield from self._complete(rows.take(slice(0, whole)))

    def _complete(self, rows: "_Measurements") -> Iterator[Item]:
        """Yield whole epochs: the clock once for each, gains once for each band and value."""
        epoch = rows.epoch
        if not epoch.size:
            return
        yield from self._observations.push(rows.observed)
        first = np.append(True, epoch[1:] != epoch[:-1])
        yield from self._clock.push(rows.clock.take(first))
        agc_db, band = (rows.gain.columns[name].values for name in ("agc_db", "band"))
        keys = np.stack([epoch.astype(np.float64), band.astype(np.float64), agc_db], axis=1)
        gained = np.flatnonzero(~np.isnan(agc_db))
        distinct = np.sort(np.unique(keys[gained], axis=0, return_index=True)[1])
        yield from self._rf.push(rows.gain.take(gained[distinct]))


class _Measurements(NamedTuple):
    """Raw measurements: the chip's clock at each, int64 ``(n,)``, and the rows of each topic."""

    epoch: NDArray[np.int64]
    observed: RowBatch
    clock: RowBatch
    gain: RowBatch

    def take(self, rows: slice) -> "_Measurements":
        """Return the measurements that a slice selects."""
        batches = (self.observed, self.clock, self.gain)
        return _Measurements(self.epoch[rows], *(batch.take(rows) for batch in batches))

    def followed_by(self, after: "_Measurements") -> "_Measurements":
        """Return these measurements and those after them."""
        pairs = zip(self[1:], after[1:], strict=True)
        return _Measurements(
            np.concatenate([self.epoch, after.epoch]), *(RowBatch.concat(pair) for pair in pairs)
        )


def _bands(seen: android.Satellites) -> Column:
    return Column(seen.band, None, android.RF_BANDS)


def _unaccounted(rows: RowBatch) -> RowBatch:
    """Return rows whose bytes the observations account for."""
    return replace(rows, units=np.zeros(len(rows), np.int64))


class _FileOrder:
    """Times of rows that have none: those of the timed rows before them in the file."""

    def __init__(self) -> None:
        none = np.empty(0, np.int64)
        self._offsets, self._times_ns = none, none
        self._epoch_ns: int | None = None
        self._index = -1

    def piece(self, offsets: NDArray[np.int64], times_ns: NDArray[np.int64]) -> None:
        """Take where the timed rows of the next piece lie, and their times, in the order of the
        file.
        """
        self._offsets = np.concatenate([self._offsets[-1:], offsets])
        self._times_ns = np.concatenate([self._times_ns[-1:], times_ns])

    def times(self, rows: NDArray[np.int64]) -> Stamps:
        """Return the times of rows at these offsets."""
        before = np.searchsorted(self._offsets, rows) - 1
        if not self._offsets.size:
            return np.zeros(rows.size, np.int64), np.zeros(rows.size, bool)
        return self._times_ns[np.maximum(before, 0)], before >= 0

    def epochs(self, rows: NDArray[np.int64], index: NDArray[np.int64]) -> Stamps:
        """Return the times of rows that are numbered within epochs: that of each epoch's first
        row.
        """
        times, known = self.times(rows)
        before = np.concatenate([[self._index], index[:-1]])
        first = np.where((index <= before) | (index == 0), np.arange(rows.size), -1)
        first = np.maximum.accumulate(first)
        held_ns, begun = self._epoch_ns, first >= 0
        times = np.where(begun, times[np.maximum(first, 0)], held_ns or 0)
        known = np.where(begun, known[np.maximum(first, 0)], held_ns is not None)
        self._index = int(index[-1])
        self._epoch_ns = int(times[-1]) if known[-1] else None
        return times, known


def _messages(reader: ColumnReader) -> tuple[Fields, NDArray[np.bool_]]:
    """Return the fields of navigation messages of one length, and which have a cell that is no
    byte, signed or not.
    """
    kind, has_kind = reader.exact(("Type",))
    svid, has_svid = reader.exact(("Svid",))
    constellation = np.where(has_kind & (kind >> 8 < 8), kind >> 8, 0)
    signals = {number: android.SIGNALS.index(signal) for number, signal in _MESSAGE_SIGNALS.items()}
    codes = np.array([signals.get(number, -1) for number in kind.tolist()], np.int32)
    octets, bad = _bytes(reader, reader.index.get("Data(Bytes)", 6))
    fields = {
        "constellation": Column(android.SCHEMA_CONSTELLATION[constellation], constellation > 0),
        "svid": Column(
            np.where(has_svid, android.within_constellation(constellation, svid), 0),
            has_svid & (svid > 0),
        ),
        "signal": Column(codes, None, android.SIGNALS),
        "subframe": encode_categories(octets),
    }
    return fields, bad


def _bytes(reader: ColumnReader, place: int) -> tuple[list[bytes], NDArray[np.bool_]]:
    """Return the cells from one place on as bytes, and which rows have one that is none."""
    import pyarrow as pa

    count, width = len(reader), int(reader.lines.cells[0])
    if place >= width:
        return [b""] * count, np.zeros(count, bool)
    cells = pa.concat_arrays([reader.cells(each) for each in range(place, width)])
    values, present, wrong = numbers.scaled(cells)
    wrong = wrong | ~present | (values < -128) | (values > 255)
    octets = np.where(wrong, 0, values).astype(np.uint8).reshape(-1, count).T
    return [row.tobytes() for row in octets], np.asarray(wrong.reshape(-1, count).any(axis=0))
