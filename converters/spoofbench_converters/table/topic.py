"""From the columns of a table to those of one topic."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Columns
from spoofbench.errors import LimitError
from spoofbench.gnss_time import GPS_EPOCH_NS, SECOND_NS, WEEK_NS, leap_seconds
from spoofbench.schema import KINDS
from spoofbench.table import Column, Table
from spoofbench_converters.table import cells
from spoofbench_converters.table.cells import Bools
from spoofbench_converters.table.earth import geodetic
from spoofbench_converters.table.fields import ECEF, FieldSpec, TimeSpec, enum_numbers
from spoofbench_converters.table.mapping import TopicSpec
from spoofbench_converters.table.times import Clock

MAX_WORD_OCTETS = 2**24
_FLAGS = {"true": 1, "false": 0, "t": 1, "f": 0, "yes": 1, "no": 0, "1": 1, "0": 0}


def resolve(name: str, available: Mapping[str, Any] | frozenset[str]) -> tuple[str, bool] | None:
    """Return a column and whether its sign is turned, None where there is no such column; a leading
    minus may belong to the name.
    """
    if name in available:
        return name, False
    if name.startswith("-") and name[1:] in available:
        return name[1:], True
    return None


@dataclass(slots=True)
class Read:
    """What a topic found: which rows are its own, wrong in a column of the table, say something, or
    only repeat; and its columns.
    """

    mine: Bools
    bad: dict[str, Bools]
    some: Bools
    held: Bools
    columns: Columns


class Topic:
    """One topic of a table.

    Attributes:
        key: before the names of its columns.
        held: how many rows only repeated the row before.
    """

    def __init__(self, spec: TopicSpec, key: str) -> None:
        self.spec, self.key = spec, key
        self.held = 0
        self._kind = KINDS[spec.kind]
        self._last: dict[str, str | None] = {}
        self._words: dict[str, dict[str, int]] = {}
        self._clocks = {
            name: Clock(time)
            for name, time in (("claims", spec.claims), ("receive_time_ns", spec.receive_time))
            if time
        }

    def read(self, available: Mapping[str, Any], count: int) -> Read:
        mine = self._mine(available, count)
        changed = self._changed(available, mine)
        columns: Columns = {}
        bad: dict[str, Bools] = {}
        some = np.zeros(count, bool)
        for field in self.spec.fields:
            wrong, there = self._field(field, available, count, columns)
            some |= there
            if field.column is not None:
                bad[field.column] = bad.get(field.column, False) | wrong
        for name, clock in self._clocks.items():
            bad[clock.spec.column] = bad.get(clock.spec.column, False) | self._time(
                name, clock, available, columns
            )
        held = mine & ~changed
        self.held += int(held.sum())
        row = mine & changed & some
        columns[f"{self.key}row"] = row
        return Read(
            mine,
            {name: wrong & mine & changed for name, wrong in bad.items() if wrong.any()},
            row,
            held,
            columns,
        )

    def table(self, columns: Columns) -> Table:
        """Return rows as a table."""
        key = self.key
        fields: dict[str, Any] = {}
        for name, values in columns.items():
            field = name.removeprefix(key)
            if name.startswith(key) and field in self._kind.fields:
                words = (
                    tuple(self._words[field])
                    if self._kind.fields[field].category == "text"
                    else None
                )
                fields[field] = Column(values, columns.get(f"{name}?"), words)
        for triple in ECEF:
            if f"{key}{triple}[0]" in columns:
                fields |= geodetic(
                    {
                        name.removeprefix(key): values
                        for name, values in columns.items()
                        if name.startswith(key)
                    }
                )
                break
        return Table(self.spec.kind, columns["time_ns"], fields)

    def _mine(self, available: Mapping[str, Any], count: int) -> Bools:
        mine = np.ones(count, bool)
        for name, wanted in self.spec.where:
            mine &= cells.matches(available[name], wanted)
        for name, unwanted in self.spec.unless:
            mine &= ~cells.matches(available[name], unwanted)
        return mine

    def _changed(self, available: Mapping[str, Any], mine: Bools) -> Bools:
        """Which rows differ from the row of this topic before them in a column that must change."""
        import pyarrow as pa
        import pyarrow.compute as pc

        if not self.spec.changes or not mine.any():
            return np.ones(mine.size, bool)
        changed = np.zeros(int(mine.sum()), bool)
        for name in self.spec.changes:
            texts = pc.fill_null(pc.filter(cells.words(available[name]), pa.array(mine)), "")
            before = pa.array([self._last.get(name)], pa.string())
            shifted = pa.concat_arrays([before, texts.slice(0, len(texts) - 1)])
            changed |= np.array(
                pc.fill_null(pc.not_equal(texts, shifted), True).to_numpy(zero_copy_only=False),
                bool,
            )
            self._last[name] = texts[len(texts) - 1].as_py()
        result = np.zeros(mine.size, bool)
        result[mine] = changed
        return result

    def _field(
        self, spec: FieldSpec, available: Mapping[str, Any], count: int, columns: Columns
    ) -> tuple[Bools, Bools]:
        """Add a field's column; return which rows are wrong and which have a value that the table
        gives.
        """
        nothing = np.zeros(count, bool)
        key = f"{self.key}{spec.name}"
        if spec.column is None:
            assert spec.constant is not None
            columns[key] = np.full(
                count,
                self._code(spec.name, spec.constant),
                np.int32 if isinstance(spec.constant, str) else None,
            )
            return nothing, nothing
        column = resolve(spec.column, available)
        if column is None:
            return nothing, nothing
        name, minus = column
        values, there, bad = self._values(spec, available[name], minus != spec.negate)
        columns[key] = values
        if (
            values.dtype.kind != "f"
            and spec.name in self._kind.fields
            and self._kind.fields[spec.name].category != "text"
        ):
            columns[f"{key}?"] = there
        return bad, there

    def _values(self, spec: FieldSpec, raw: Any, minus: bool) -> tuple[NDArray[Any], Bools, Bools]:
        """Return a field's values, which are there, and which cells are wrong."""
        gone = cells.matches(raw, spec.missing) if spec.missing else np.zeros(len(raw), bool)
        field = self._kind.fields.get(spec.name)
        category = field.category if field else "float"
        if spec.values is not None:
            values, there = self._mapped(spec, raw)
            return values, there & ~gone, np.zeros(len(raw), bool)
        if category == "float" or (category == "integer" and (spec.unit.factor != 1 or minus)):
            numbers, bad = cells.numbers(raw)
            numbers = spec.unit.to_schema(-numbers if minus else numbers) + spec.offset
            bad |= np.isinf(numbers)
            numbers = np.where(gone | bad, np.nan, numbers)
            there = ~np.isnan(numbers)
            if category == "float":
                return numbers, there, bad & ~gone
            odd = there & (numbers != np.rint(numbers))
            return (
                np.where(there & ~odd, numbers, 0).astype(np.int64),
                there & ~odd,
                (bad | odd) & ~gone,
            )
        if category == "integer":
            whole, there, bad = cells.integers(raw)
            return np.where(gone, 0, whole), there & ~gone, bad & ~gone
        if category == "text":
            codes = self._texts(spec.name, cells.words(raw))
            codes[gone] = -1
            return codes, codes >= 0, np.zeros(len(raw), bool)
        values, there, bad = cells.choices(raw, self._choices(spec.name, category))
        return values, there & ~gone, bad & ~gone

    def _choices(self, name: str, category: str) -> Mapping[str, int]:
        if category == "boolean":
            return _FLAGS
        numbers = enum_numbers(self._kind, self._kind.fields[name])
        return {
            **{str(number): number for number in numbers.values()},
            **{text.lower(): number for text, number in numbers.items()},
        }

    def _mapped(self, spec: FieldSpec, raw: Any) -> tuple[NDArray[Any], Bools]:
        assert spec.values is not None
        constants = {
            text: self._code(spec.name, constant) for text, constant in spec.values.items()
        }
        is_float = any(isinstance(constant, float) for constant in constants.values())
        is_text = self._kind.fields[spec.name].category == "text"
        values = np.full(
            len(raw),
            np.nan if is_float else -1 if is_text else 0,
            np.float64 if is_float else np.int64,
        )
        there = np.zeros(len(raw), bool)
        for text, constant in constants.items():
            same = cells.matches(raw, (text,))
            values[same] = constant
            there |= same
        return values.astype(np.int32) if is_text else values, there

    def _code(self, name: str, constant: float | int | bool | str) -> float | int:
        """Return a constant as a column holds it: of a text its code."""
        if not isinstance(constant, str):
            return constant
        words = self._words.setdefault(name, {})
        return words.setdefault(constant, len(words))

    def _texts(self, name: str, texts: Any) -> NDArray[np.int32]:
        """Return texts as codes into all words met so far, -1 where empty."""
        coded = texts.dictionary_encode()
        words = self._words.setdefault(name, {})
        codes = np.array(
            [words.setdefault(word, len(words)) for word in coded.dictionary.to_pylist()] + [-1],
            np.int32,
        )
        if sum(map(len, words)) > MAX_WORD_OCTETS:
            raise LimitError(
                f"the column of {name!r} holds more than {MAX_WORD_OCTETS:,} characters of "
                "different texts: leave it out of the mapping"
            )
        places = coded.indices.fill_null(-1).to_numpy(zero_copy_only=False)
        return np.asarray(codes[places])

    def _time(
        self, name: str, clock: Clock, available: Mapping[str, Any], columns: Columns
    ) -> Bools:
        """Add what a time says; return which rows have something there that is no time."""
        spec = clock.spec
        time_ns, bad = clock.read(available)
        if name == "receive_time_ns":
            columns |= {f"{self.key}{name}": time_ns, f"{self.key}{name}?": ~bad}
        else:
            leaps = leap_seconds(time_ns) if spec.leap_seconds is None else spec.leap_seconds
            gps_ns = time_ns + leaps * SECOND_NS - GPS_EPOCH_NS
            bad = bad | (gps_ns < 0)
            columns |= {
                f"{self.key}gps_week": np.where(bad, 0, gps_ns // WEEK_NS),
                f"{self.key}gps_week?": ~bad,
                f"{self.key}tow_s": np.where(bad, np.nan, gps_ns % WEEK_NS / SECOND_NS),
            }
        return bad & self._there(spec, available)

    def _there(self, spec: TimeSpec, available: Mapping[str, Any]) -> Bools:
        return np.asarray(
            np.logical_and.reduce([cells.present(available[name]) for name in spec.columns()])
        )
