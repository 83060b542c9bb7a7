"""The GNSS chip of an Android phone: raw measurements, its clock, gain control, satellites in view,
navigation messages.
"""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns, Item
from spoofbench.conversion.rows import join, take
from spoofbench_converters.phone import android
from spoofbench_converters.phone.contract import NO_TIME, positive
from spoofbench_converters.phone.gnsslogger_format import raw_elapsed, raw_utc
from spoofbench_converters.phone.merging import MergedTopic, rejects
from spoofbench_converters.phone.time_axis import ElapsedTimeAxis, Stamps
from spoofbench_converters.text import numbers
from spoofbench_converters.text.columns import NOT_A_NUMBER, ColumnReader, held
from spoofbench_converters.text.lines import Cells, Rows

_MOST_PER_EPOCH = 10_000
_SIGNAL = ("constellation", "svid", "signal", "cn0_dbhz", "elevation_deg", "azimuth_deg", "used")
_WORDS = {"signal": android.SIGNALS}

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
    """What the chip says, as the streams of one source.

    Attributes:
        latest: where the raw measurements taken last lie, and their times.
    """

    def __init__(self, source: str, axis: ElapsedTimeAxis) -> None:
        self.source, self._axis = source, axis
        self._observations = MergedTopic(
            source, "gnss/observation", android.OBSERVATION, words=_WORDS
        )
        self._clock = MergedTopic(source, "gnss/clock", android.CLOCK)
        self._rf = MergedTopic(
            source, "gnss/rf", ("band", "agc_db"), words={"band": android.RF_BANDS}
        )
        self._signals = MergedTopic(source, "gnss/signal", _SIGNAL, words=_WORDS)
        self._navdata = MergedTopic(
            source, "gnss/navdata", ("constellation", "svid", "signal", "subframe"), words=_WORDS
        )
        self._held: Columns = {}
        self._bias_origin_ns: int | None = None
        self._leap_s: int | None = None
        self._order = _FileOrder()
        self.latest: Columns = {}

    def piece(self, offsets: NDArray[np.int64], times_ns: NDArray[np.int64]) -> None:
        """Take where the timed rows of the next piece lie, and their times: satellites in view and
        messages have none.
        """
        self._order.piece(offsets, times_ns)

    def raw(self, reader: ColumnReader) -> Iterator[Item]:
        """Take raw measurements."""
        times, seen = android.receiver_times(reader), android.satellites(reader)
        columns = {
            **android.observations(reader, seen, times),
            **android.clock_columns(reader),
            **reader.account(),
        }
        columns |= self._bias(reader, times) | {"agc_db": reader.floats("AgcDb"), "band": seen.band}
        columns["epoch"] = reader.exact(("TimeNanos",))[0]
        claimed = raw_utc(reader, times)
        columns["time_ns"], timed = self._axis.times(
            columns["offset"], raw_elapsed(reader), claimed, shift=True
        )
        columns["host_offset_s"] = np.where(
            times.known, (claimed[0] - columns["time_ns"] + times.rest_ns) * 1e-9, np.nan
        )
        yield from rejects(columns, reader.bad, NOT_A_NUMBER)
        yield from rejects(columns, ~timed & ~reader.bad, NO_TIME)
        columns = take(columns, timed & ~reader.bad)
        self.latest = {name: columns[name] for name in ("offset", "time_ns")}
        yield from self._epochs(columns)

    def agc(self, reader: ColumnReader) -> Iterator[Item]:
        """Take rows of gain control."""
        times, seen = android.receiver_times(reader), android.satellites(reader)
        columns: Columns = {"agc_db": reader.floats("AgcDb"), "band": seen.band, **reader.account()}
        claimed = raw_utc(reader, times)
        columns["time_ns"], timed = self._axis.times(
            columns["offset"], reader.exact(()), claimed, shift=True
        )
        yield from rejects(columns, reader.bad, NOT_A_NUMBER)
        yield from rejects(columns, ~timed & ~reader.bad, NO_TIME)
        yield from self._rf.push(take(columns, timed & ~reader.bad))

    def status(self, reader: ColumnReader) -> Iterator[Item]:
        """Take rows of satellites in view; their time is that of the timed row before their epoch's
        first one.
        """
        used = reader.exact(("UsedInFix",))
        columns: Columns = {
            **android.satellites(reader).columns,
            "cn0_dbhz": positive(reader.floats("Cn0DbHz")),
            "elevation_deg": reader.floats("ElevationDegrees"),
            "azimuth_deg": reader.floats("AzimuthDegrees"),
            **held((used[0] != 0, used[1]), "used"),
            **reader.account(),
        }
        index = reader.exact(("SignalIndex",))[0]
        columns["time_ns"], timed = self._order.epochs(columns["offset"], index)
        yield from rejects(columns, reader.bad, NOT_A_NUMBER)
        yield from rejects(columns, ~timed & ~reader.bad, NO_TIME)
        yield from self._signals.push(take(columns, timed & ~reader.bad))

    def navigation(self, reader: ColumnReader) -> Iterator[Item]:
        """Take navigation messages; their time is that of the timed row before them."""
        kind, has_kind = reader.exact(("Type",))
        svid = reader.exact(("Svid",))
        signals = {
            number: android.SIGNALS.index(signal) for number, signal in _MESSAGE_SIGNALS.items()
        }
        constellation = np.where(has_kind & (kind >> 8 < 8), kind >> 8, 0)
        columns: Columns = {
            **held(
                (android.SCHEMA_CONSTELLATION[constellation], constellation > 0), "constellation"
            ),
            **held(
                (
                    np.where(svid[1], android.within_constellation(constellation, svid[0]), 0),
                    svid[1] & (svid[0] > 0),
                ),
                "svid",
            ),
            "signal": np.array([signals.get(number, -1) for number in kind.tolist()], np.int32),
            **reader.account(),
        }
        columns["subframe"], bad = _bytes(reader.rows, reader.places.get("Data(Bytes)", 6))
        columns["time_ns"], timed = self._order.times(columns["offset"])
        bad |= reader.bad
        yield from rejects(columns, bad, NOT_A_NUMBER)
        yield from rejects(columns, ~timed & ~bad, NO_TIME)
        yield from self._navdata.push(take(columns, timed & ~bad))

    def finish(self) -> Iterator[Item]:
        """Yield what is held."""
        yield from self._complete(self._held)
        for stream in (self._observations, self._clock, self._rf, self._signals, self._navdata):
            yield from stream.finish()

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

    def _bias(self, reader: ColumnReader, times: android.Times) -> Columns:
        """Return the clock's bias beyond that of the first row that has one, for doubles of decades
        have no nanoseconds.
        """
        full = reader.exact(("FullBiasNanos",))[0]
        if self._bias_origin_ns is None and times.known.any():
            self._bias_origin_ns = int(full[np.argmax(times.known)])
        beyond = full - (self._bias_origin_ns or 0) + np.nan_to_num(reader.floats("BiasNanos"))
        return {"bias_s": np.where(times.known, beyond * 1e-9, np.nan)}

    def _epochs(self, columns: Columns) -> Iterator[Item]:
        """Hold the last epoch until it is complete."""
        rows = join(self._held, columns)
        epoch = rows["epoch"]
        last = int(epoch.size and np.argmax(epoch[::-1] != epoch[-1]))
        whole = epoch.size - last if last or epoch.size > _MOST_PER_EPOCH else 0
        self._held = take(rows, slice(whole, None))
        yield from self._complete(take(rows, slice(0, whole)))

    def _complete(self, rows: Columns) -> Iterator[Item]:
        if not rows or not rows["time_ns"].size:
            return
        yield from self._observations.push(rows)
        epoch = rows["epoch"]
        first = np.concatenate([[True], epoch[1:] != epoch[:-1]])
        yield from self._clock.push(_unaccounted(take(rows, first)))
        gained = take(rows, ~np.isnan(rows["agc_db"]))
        keys = np.stack(
            [
                gained["epoch"].astype(np.float64),
                gained["band"].astype(np.float64),
                gained["agc_db"],
            ],
            1,
        )
        distinct = np.sort(np.unique(keys, axis=0, return_index=True)[1])
        yield from self._rf.push(_unaccounted(take(gained, distinct)))


def _unaccounted(columns: Columns) -> Columns:
    return columns | {"length": np.zeros(columns["time_ns"].size, np.int64)}


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


def _bytes(rows: Rows, place: int) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
    """Read the cells from one place on as bytes, signed or not, and which rows have a cell that is
    none.
    """
    found, bad = np.full(rows.widths.size, b"", object), np.zeros(rows.widths.size, bool)
    for width in np.unique(rows.widths).tolist():
        mine = np.flatnonzero(rows.widths == width)
        cells = (rows.firsts[mine][:, None] + np.arange(place, width)).reshape(-1)
        values, present, wrong = numbers.scaled(
            Cells(rows.lines.octets, rows.starts[cells], rows.ends[cells])
        )
        wrong = wrong | ~present | (values < -128) | (values > 255)
        octets = np.where(wrong, 0, values).astype(np.uint8).reshape(mine.size, -1)
        found[mine] = [row.tobytes() for row in octets]
        bad[mine] = wrong.reshape(mine.size, -1).any(axis=1)
    return found, bad
