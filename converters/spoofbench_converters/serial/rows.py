"""From rows of epochs to the tables of a recording's topics."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spoofbench.arrays import Ints, Octets
from spoofbench.conversion import Block, Columns, Rejects, TimeSorter
from spoofbench.conversion.rows import join, take
from spoofbench.schema import KINDS, topic_of
from spoofbench.table import Column, Table, encode_words
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows, Epochs
from spoofbench_converters.serial.time_axis import TIMED

_VALID = "valid "
"""Before the name of a column: which of its values are there."""

_WORDS = 1000
"""So many words are remembered however few are in use."""


@dataclass(frozen=True, slots=True, eq=False)
class TimedEpochs:
    """A decoder's epochs with their times and verdicts, int64 and uint8 ``(m,)``, and the running
    number of the first.
    """

    epochs: Epochs
    times: Ints
    verdicts: Octets
    first: int


class TopicRows:
    """The rows of one topic, put in the order of time."""

    def __init__(self, source: str, kind: str) -> None:
        self.source, self.name = source, topic_of(source, kind)
        self.positions, self.moving = (
            0,
            0,
        )  # rows with a position, and of these with a velocity or speed
        self._kind = KINDS[kind]
        self._words: dict[str, dict[Any, int]] = {}
        self._order = TimeSorter()
        self._kept: Columns = {}  # rows that the order holds, in file order
        self._first = 0  # number of the first of them
        self._counter: SensorClock | None = None

    @property
    def is_pvt(self) -> bool:
        return self._kind.name == "gnss/pvt"

    @property
    def preference(self) -> tuple[bool, bool, int]:
        """Sorts receivers: those first of which half the positions have a velocity or speed, then
        those with positions, then by number.
        """
        return (
            2 * self.moving < max(self.positions, 1),
            not self.positions,
            int(self.source.removeprefix("gnss")),
        )

    def push(self, rows: EpochRows, timed: TimedEpochs) -> Iterator[Block | Rejects]:
        """Take the next rows."""
        wanted = timed.verdicts[rows.epoch] == TIMED
        if not wanted.any():
            return
        kept = slice(None) if wanted.all() else np.flatnonzero(wanted)
        epoch = rows.epoch[kept]
        columns = self._flat(rows, kept)
        columns["offset"] = timed.epochs.offset[epoch]
        received = (
            timed.epochs.receive_time_ns[epoch]
            if rows.receive_time_ns is None
            else rows.receive_time_ns[kept]
        )
        if np.any(received != ABSENT_NS):
            columns |= {
                "receive_time_ns": np.where(received == ABSENT_NS, 0, received),
                f"{_VALID}receive_time_ns": received != ABSENT_NS,
            }
        columns["time_ns"] = timed.times[epoch]
        if rows.tick_ns is None:
            if rows.offset_ns is not None:
                columns["time_ns"] = columns["time_ns"] + rows.offset_ns[kept]
            yield from self._sort(columns)
        else:
            self._counter = self._counter or SensorClock()
            placing = {
                "tick_ns": rows.tick_ns[kept],
                "epoch": epoch + timed.first,
                "epoch_ns": columns.pop("time_ns"),
            }
            for ready in self._counter.push(columns | placing):
                yield from self._sort(ready)

    def finish(self) -> Iterator[Block | Rejects]:
        """Give what is held."""
        for ready in self._counter.finish() if self._counter else ():
            yield from self._sort(ready)
        yield from self._give(*self._order.flush())

    def about(self) -> dict[str, str]:
        """Return what metadata say of the source's counter."""
        return self._counter.about() if self._counter else {}

    def _flat(self, rows: EpochRows, kept: slice | Ints) -> Columns:
        """Return the rows' columns as bare arrays: what is there of one that is no float as
        another, codes for words.
        """
        flat: Columns = {}
        for name, given in rows.columns.items():
            category = self._kind.fields[name].category
            column = _column(given, category)
            flat[name] = column.values[kept]
            if column.words is not None:
                words = self._words.setdefault(name, {})
                codes = np.array(
                    [words.setdefault(word, len(words)) for word in column.words] + [-1], np.int32
                )
                flat[name] = codes[flat[name]]
            elif category != "float":
                flat[_VALID + name] = (
                    np.ones(flat[name].size, bool) if column.valid is None else column.valid[kept]
                )
        return flat

    def _sort(self, columns: Columns) -> Iterator[Block | Rejects]:
        time_ns = columns.pop("time_ns")
        first = self._first + (self._kept["gone"].size if self._kept else 0)
        self._kept = _joined(self._kept, {**columns, "gone": np.zeros(time_ns.size, bool)})
        yield from self._give(
            *self._order.push(
                {"time_ns": time_ns, "number": np.arange(first, first + time_ns.size)}
            )
        )

    def _give(self, ready: Columns, refused: Columns) -> Iterator[Block | Rejects]:
        """Yield the rows that the order gives; let go of them as far as no earlier one is still
        held.
        """
        for rows in (ready, refused):
            if rows and rows["number"].size:
                places = rows["number"] - self._first
                self._kept["gone"][places] = True
                if rows is ready:
                    yield self._block(take(self._kept, _places(places)), rows["time_ns"])
                else:
                    nothing = np.zeros(places.size, np.int64)
                    yield Rejects(
                        self._kept["offset"][places], nothing, f"time runs backwards in {self.name}"
                    )
        if self._kept:
            gone = self._kept["gone"]
            count = gone.size if gone.all() else int(np.argmin(gone))
            self._kept = take(self._kept, slice(count, None))
            self._first += count
            self._renumber(gone.size - count)

    def _block(self, columns: Columns, time_ns: Ints) -> Block:
        fields: dict[str, Any] = {}
        for name in self._kind.fields:
            if name in self._words and name in columns:
                fields[name] = Column(columns[name], None, tuple(self._words[name]))
            elif name in columns:
                fields[name] = Column(columns[name], columns.get(_VALID + name))
        table = Table(self._kind.name, time_ns, fields)
        if self.is_pvt:
            position = ~np.isnan(table["lat_deg"])
            self.positions += int(np.count_nonzero(position))
            self.moving += int(
                np.count_nonzero(
                    position & ~(np.isnan(table["vel_n_mps"]) & np.isnan(table["speed_mps"]))
                )
            )
        return Block(self.name, table, 0)

    def _renumber(self, held: int) -> None:
        """Drop words that no row held uses, where they are many."""
        for name, words in self._words.items():
            if len(words) > _WORDS + held and name in self._kept:
                codes, place = np.unique(self._kept[name], return_inverse=True)
                known = list(words)
                self._words[name] = {
                    known[code]: number for number, code in enumerate(codes[codes >= 0].tolist())
                }
                self._kept[name] = (place - np.count_nonzero(codes < 0)).astype(np.int32)


def _column(given: Any, category: str) -> Column:
    if isinstance(given, Column):
        return given
    return encode_words(given) if category in ("text", "bytes") else Column(np.asarray(given))


def _places(places: Ints) -> slice | Ints:
    """Return places as a slice if they are neighbours."""
    first = int(places[0])
    in_a_row = int(places[-1]) - first == places.size - 1 and bool(np.all(places[1:] > places[:-1]))
    return slice(first, first + places.size) if in_a_row else places


def _joined(first: Columns, second: Columns) -> Columns:
    """Return the rows of both; what one lacks is absent there."""
    if first and first.keys() != second.keys():
        first, second = _widened(first, second), _widened(second, first)
    return join(first, second)


def _widened(columns: Columns, other: Columns) -> Columns:
    """Return rows with all the columns of others."""
    rows, wide = columns["gone"].size, dict(columns)
    for name in other.keys() - columns.keys():
        dtype = other[name].dtype
        absent = (
            np.nan
            if dtype.kind == "f"
            else 0
            if dtype.kind == "b" or _VALID + name in other
            else -1
        )
        wide[name] = np.full(rows, absent, dtype)
    return wide


BLOCK_EPOCHS = 60
RESTART_NS = 60_000_000_000
"""A lead that changes by more than this from one epoch to the next is that of a counter which has
started anew.
"""


@dataclass(slots=True)
class _Block:
    """Epochs in a row: their counter where their rows begin, how far their time leads it, and the
    rows.
    """

    ticks: list[int] = field(default_factory=list)
    leads: list[int] = field(default_factory=list)
    rows: Columns = field(default_factory=dict)

    def middle(self) -> tuple[float, float]:
        """Return the median of the counter, and of the lead."""
        return float(np.median(self.ticks)), float(np.median(self.leads))


class SensorClock:
    """Gives one sensor's rows times by its counter.

    An epoch's messages and the row behind them were given out together, so the row's time is about
    that of the epoch. The lead of time over counter is the median over sixty epochs in a row, which
    neither jitter nor a delayed row disturbs, and is linear between the middles of such blocks.
    What all epochs have in common of the delay between their time and their output remains: times
    are too early by as much.
    """

    def __init__(self) -> None:
        self._open = _Block()
        self._closed: _Block | None = None  # its rows wait for the middle of the next block
        self._before: tuple[float, float] | None = None
        self._lead_ns: float | None = None
        self._spreads: list[float] = []

    def push(self, rows: Columns) -> Iterator[Columns]:
        """Take the next rows in file order.

        Args:
            rows: ``tick_ns`` and whatever else, and ``epoch`` and ``epoch_ns``, number and time of
                each row's epoch.

        Yields:
            EpochRows with ``time_ns``.
        """
        epochs, first = np.unique(rows["epoch"], return_index=True)
        ticks, leads = rows["tick_ns"][first], (rows["epoch_ns"] - rows["tick_ns"])[first]
        begin = 0
        for epoch, tick, lead in zip(epochs.tolist(), ticks.tolist(), leads.tolist(), strict=True):
            restarts = bool(self._open.leads) and abs(lead - self._open.leads[-1]) > RESTART_NS
            if restarts or len(self._open.leads) == BLOCK_EPOCHS:
                end = int(np.searchsorted(rows["epoch"], epoch))
                self._open.rows = join(self._open.rows, take(rows, slice(begin, end)))
                begin = end
                yield from self._close(restarts)
            self._open.ticks.append(tick)
            self._open.leads.append(lead)
        self._open.rows = join(self._open.rows, take(rows, slice(begin, None)))

    def finish(self) -> Iterator[Columns]:
        """Give what is held."""
        if self._open.leads:
            yield from self._close(last=True)

    def about(self) -> dict[str, str]:
        """Return what metadata say of the counter."""
        if self._lead_ns is None:
            return {}
        return {
            "time_basis": "its counter, laid against the receiver's epochs",
            "counter_offset_s": repr(round(self._lead_ns / 1e9, 6)),
            "counter_spread_s": repr(round(float(np.median(self._spreads)) / 1e9, 6)),
        }

    def _close(self, last: bool) -> Iterator[Columns]:
        """Close the open block; give the rows of the one before, and its own if it is the last
        before a restart or the end.
        """
        block, self._open = self._open, _Block()
        middle = block.middle()
        if self._lead_ns is None:
            self._lead_ns = middle[1]
        self._spreads.append(float(np.subtract(*np.percentile(block.leads, [90, 10]))))
        if self._closed:
            yield self._timed(self._closed, middle)
            self._before = self._closed.middle()
        self._closed = block
        if last:
            yield self._timed(block, None)
            self._closed, self._before = None, None

    def _timed(self, block: _Block, after: tuple[float, float] | None) -> Columns:
        knots = sorted(knot for knot in (self._before, block.middle(), after) if knot)
        ticks = block.rows["tick_ns"]
        lead = np.interp(ticks.astype(np.float64), *np.array(knots).T)
        return {**block.rows, "time_ns": ticks + np.rint(lead).astype(np.int64)}
