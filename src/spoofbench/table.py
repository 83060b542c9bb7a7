"""Tables: rows of one kind as frozen numpy columns.

Columns are read-only views of immutable ``bytes``, so no detector can alter, or be made to alter,
what the next one sees. Whatever looks like a change returns a new object.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spoofbench.errors import RecordingError
from spoofbench.schema import KINDS, Field, Kind

Rows = slice | NDArray[np.bool_] | NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """Values of one field, shape ``(n,)``.

    Floats say absence by NaN and have no mask. ``valid`` is None where every row has a value. Text
    and bytes hold codes into ``categories``, -1 where absent.
    """

    values: NDArray[Any]
    valid: NDArray[np.bool_] | None = None
    categories: tuple[str, ...] | tuple[bytes, ...] | None = None


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array of any shape as a read-only view of immutable bytes, without a copy where it
    is one already.
    """
    root: Any = array
    while isinstance(root, np.ndarray):
        root = root.base
    if isinstance(root, bytes) and not array.flags.writeable:
        return array
    return np.frombuffer(array.tobytes(), array.dtype)


def encode_categories(values: Sequence[str | None] | Sequence[bytes | None]) -> Column:
    """Dictionary-code a sequence of texts (or of byte strings); None is absent."""
    categories: dict[Any, int] = {}
    codes = np.fromiter(
        (
            -1 if value is None else categories.setdefault(value, len(categories))
            for value in values
        ),
        np.int32,
        len(values),
    )
    return Column(codes, None, tuple(categories))


def as_column(field: Field, given: ArrayLike | Column | Sequence[Any]) -> Column:
    """Return what is given of a field as a column: values ``(n,)``, or for text and bytes a
    sequence with None where absent.
    """
    if isinstance(given, Column):
        return given
    return (
        encode_categories(given)  # type: ignore[arg-type]
        if field.category in ("text", "bytes")
        else Column(np.asarray(given))
    )


def concat_columns(field: Field, columns: Sequence[Column | None], sizes: Sequence[int]) -> Column:
    """Return columns of one field, one after the other.

    Args:
        field: of the schema.
        columns: None where all rows of a part lack the field.
        sizes: rows of each part, whose sum is that of the result.
    """
    if field.category in ("text", "bytes"):
        if len(given := [c for c in columns if c is not None]) == len(columns) and all(
            column.categories is given[0].categories for column in given
        ):
            return Column(
                np.concatenate([column.values for column in given]), None, given[0].categories
            )
        categories: dict[Any, int] = {}
        codes = [
            np.full(size, -1, np.int32) if column is None else _recoded(column, categories)
            for column, size in zip(columns, sizes, strict=True)
        ]
        return Column(np.concatenate(codes), None, tuple(categories))
    known = [column.values for column in columns if column is not None]
    dtype = np.result_type(*known) if known else np.dtype(field.dtype)
    absent = np.nan if dtype.kind == "f" else 0
    values = np.concatenate(
        [
            np.full(size, absent, dtype) if column is None else column.values
            for column, size in zip(columns, sizes, strict=True)
        ]
    )
    if field.category == "float" or all(c is not None and c.valid is None for c in columns):
        return Column(values)
    valid = [
        np.zeros(size, bool)
        if column is None
        else np.ones(size, bool)
        if column.valid is None
        else column.valid
        for column, size in zip(columns, sizes, strict=True)
    ]
    return Column(values, np.concatenate(valid))


def _recoded(column: Column, categories: dict[Any, int]) -> NDArray[np.int32]:
    """Return a column's codes as codes into ``categories``, which takes up the categories that it
    lacks.
    """
    shared = [categories.setdefault(word, len(categories)) for word in column.categories or ()]
    return np.asarray(np.array([*shared, -1], np.int32)[column.values])


class Table(Mapping[str, NDArray[Any]]):
    """Rows of one kind: ``time_ns`` and one read-only array per field that is present.

    ``table[name]`` gives the values of any field of the kind, shape ``(n,)``: floats with NaN where
    absent, zeros where an absent number, flag or enum is masked by :meth:`valid`, codes into
    :meth:`texts` for text.

    Args:
        kind: name of a kind of the schema.
        time_ns: int64 ``(n,)``, non-decreasing.
        columns: by field name; an array, a :class:`Column`, or for text a sequence of ``str |
            None``.

    Raises:
        RecordingError: unknown kind or field, shapes that differ, values that do not fit, or time
            running backwards.
    """

    __slots__ = ("_columns", "kind", "time_ns")
    kind: Kind
    time_ns: NDArray[np.int64]
    _columns: Mapping[str, Column]

    def __init__(
        self,
        kind: str,
        time_ns: ArrayLike,
        columns: Mapping[str, ArrayLike | Column | Sequence[Any]],
    ) -> None:
        if kind not in KINDS:
            raise RecordingError(
                f"{kind!r} is not a kind of the schema; the kinds are {sorted(KINDS)}"
            )
        times = np.asarray(time_ns)
        if times.ndim != 1 or times.dtype != np.int64:
            raise RecordingError(
                f"time_ns of a {kind} table must be int64 of shape (n,), not {times.dtype} of "
                f"shape {times.shape}"
            )
        if times.size and np.any(times[1:] < times[:-1]):
            raise RecordingError(
                f"time_ns of a {kind} table runs backwards at row "
                f"{int(np.argmax(times[1:] < times[:-1])) + 1}"
            )
        fields = KINDS[kind].fields
        unknown = set(columns) - set(fields)
        if unknown:
            raise RecordingError(f"a {kind} table has no field {sorted(unknown)[0]!r}")
        self.kind = KINDS[kind]
        self.time_ns = frozen(times)
        self._columns = MappingProxyType(
            {
                name: _column(field, columns[name], times.size)
                for name, field in fields.items()
                if name in columns
            }
        )

    @classmethod
    def _of(cls, kind: Kind, time_ns: NDArray[np.int64], columns: Mapping[str, Column]) -> "Table":
        table = cls.__new__(cls)
        table.kind, table.time_ns, table._columns = kind, time_ns, MappingProxyType(dict(columns))
        return table

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild_table, (
            self.kind.name,
            self.time_ns.tobytes(),
            {
                name: (
                    c.values.tobytes(),
                    None if c.valid is None else c.valid.tobytes(),
                    c.categories,
                )
                for name, c in self._columns.items()
            },
        )

    def __len__(self) -> int:
        """Number of rows."""
        return self.time_ns.size

    def __bool__(self) -> bool:
        return True

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.column(name).values

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Table):
            return NotImplemented
        return (
            self.kind.name == other.kind.name
            and np.array_equal(self.time_ns, other.time_ns)
            and all(
                _same(self.column(name), other.column(name))
                for name in self._columns.keys() | other._columns.keys()
            )
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Table({self.kind.name!r}, {len(self)} rows, {', '.join(self)})"

    def column(self, name: str) -> Column:
        """Return one field's column, all absent where no row has it.

        Raises:
            RecordingError: the kind has no such field.
        """
        if name in self._columns:
            return self._columns[name]
        if name not in self.kind.fields:
            raise RecordingError(f"a {self.kind.name} table has no field {name!r}")
        return _absent(self.kind.fields[name], len(self))

    def valid(self, name: str) -> NDArray[np.bool_]:
        """Which rows have the field, bool ``(n,)``."""
        column = self.column(name)
        if column.values.dtype.kind == "f":
            return np.asarray(~np.isnan(column.values))
        if column.categories is not None:
            return np.asarray(column.values >= 0)
        return np.ones(len(self), bool) if column.valid is None else column.valid

    def has(self, *names: str) -> bool:
        """Whether each of these fields is present in at least one row."""
        return all(name in self._columns and bool(self.valid(name).any()) for name in names)

    def texts(self, name: str) -> list[Any]:
        """Return a text or bytes field's values, None where absent."""
        column = self.column(name)
        if column.categories is None:
            raise RecordingError(f"field {name!r} of a {self.kind.name} table is not text")
        return [None if code < 0 else column.categories[code] for code in column.values.tolist()]

    @staticmethod
    def concat(tables: Sequence["Table"]) -> "Table":
        """Return the rows of tables of one kind, one after the other; what one lacks is absent
        there.

        Args:
            tables: at least one; each must begin no earlier than the one before it ends.

        Raises:
            RecordingError: there is none, the kinds differ, or time would run backwards.
        """
        if len({table.kind.name for table in tables}) != 1:
            raise RecordingError("only tables of one kind, at least one, can be concatenated")
        kind, sizes = tables[0].kind, [len(table) for table in tables]
        columns = {
            name: concat_columns(field, [table._columns.get(name) for table in tables], sizes)
            for name, field in kind.fields.items()
            if any(name in table for table in tables)
        }
        return Table(kind.name, np.concatenate([table.time_ns for table in tables]), columns)

    def take(self, rows: Rows) -> "Table":
        """Return the rows that a slice, mask or index array selects; their order must stay that of
        time.
        """
        columns = {
            name: _compact(
                Column(c.values[rows], None if c.valid is None else c.valid[rows], c.categories)
            )
            for name, c in self._columns.items()
        }
        if isinstance(rows, slice) and (rows.step or 1) > 0:
            return Table._of(self.kind, self.time_ns[rows], columns)
        return Table(self.kind.name, self.time_ns[rows], columns)

    def replace(self, **columns: ArrayLike | Column | Sequence[Any] | None) -> "Table":
        """Return the table with these fields' columns exchanged; None takes a field away."""
        kept = {
            name: column
            for name, column in self._columns.items()
            if columns.get(name, column) is not None
        }
        return Table(
            self.kind.name,
            self.time_ns,
            {**kept, **{name: c for name, c in columns.items() if c is not None}},
        )

    def until(self, time_ns: int) -> "Table":
        """Return the rows at or before a time."""
        return self.take(slice(0, int(np.searchsorted(self.time_ns, time_ns, "right"))))

    def between(self, start_ns: int, end_ns: int) -> "Table":
        """Return the rows within ``[start_ns, end_ns)``."""
        first, last = np.searchsorted(self.time_ns, (start_ns, end_ns), "left")
        return self.take(slice(int(first), int(last)))

    def last_per_time(self) -> "Table":
        """Return one row per time: of rows that bear the same time, the last."""
        last = np.append(self.time_ns[1:] > self.time_ns[:-1], True)[: len(self)]
        return self if last.all() else self.take(last)


def _column(field: Field, given: Any, rows: int) -> Column:
    if field.category in ("text", "bytes"):
        column = as_column(field, given)
        if column.categories is None or not all(
            isinstance(word, str if field.category == "text" else bytes)
            for word in column.categories
        ):
            raise RecordingError(f"field {field.name!r} must be {field.category}")
        column = _compact(column)
    else:
        column = as_column(field, given)
    dtype, values = np.dtype(field.dtype), column.values
    if values.shape != (rows,) or (column.valid is not None and column.valid.shape != (rows,)):
        raise RecordingError(
            f"field {field.name!r} has shape {values.shape} where the table has {rows} rows"
        )
    if values.dtype != dtype:
        with np.errstate(invalid="ignore", over="ignore"):
            cast = values.astype(dtype)
        if dtype.kind != "f" and not np.array_equal(cast, values):
            raise RecordingError(f"field {field.name!r} has values that do not fit {dtype}")
        values = cast
    valid = column.valid
    if dtype.kind == "f":
        if valid is not None:
            values, valid = np.where(valid, values, np.array(np.nan, dtype)), None
    elif valid is not None:
        values, valid = (
            (values, None)
            if valid.all()
            else (np.where(valid, values, np.zeros((), dtype)), frozen(valid.astype(bool)))
        )
    return Column(frozen(values), valid, column.categories)


def _compact(column: Column) -> Column:
    """Number a text column's categories by first use and drop the unused, so that rows alone decide
    the column.
    """
    if column.categories is None:
        return column
    codes = column.values
    used, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    by_first_use = np.argsort(first)
    by_first_use = by_first_use[used[by_first_use] >= 0]
    new = np.full(used.size, -1, np.int32)
    new[by_first_use] = np.arange(by_first_use.size, dtype=np.int32)
    categories: Any = tuple(column.categories[code] for code in used[by_first_use].tolist())
    return Column(
        frozen(new[inverse.reshape(codes.shape)] if codes.size else codes.astype(np.int32)),
        None,
        categories,
    )


def _absent(field: Field, rows: int) -> Column:
    if field.category in ("text", "bytes"):
        return Column(frozen(np.full(rows, -1, np.int32)), None, ())
    dtype = np.dtype(field.dtype)
    if dtype.kind == "f":
        return Column(frozen(np.full(rows, np.nan, dtype)))
    return Column(frozen(np.zeros(rows, dtype)), frozen(np.zeros(rows, bool)))


def _same(a: Column, b: Column) -> bool:
    if a.categories is not None or b.categories is not None:
        return a.categories == b.categories and np.array_equal(a.values, b.values)
    if a.values.dtype.kind == "f":
        return np.array_equal(a.values, b.values, equal_nan=True)
    valid_a, valid_b = (
        np.ones(a.values.size, bool) if c.valid is None else c.valid for c in (a, b)
    )
    return np.array_equal(a.values, b.values) and np.array_equal(valid_a, valid_b)


def _rebuild_table(
    kind: str, time_ns: bytes, columns: Mapping[str, tuple[bytes, bytes | None, Any]]
) -> Table:
    fields = KINDS[kind].fields
    return Table._of(
        KINDS[kind],
        np.frombuffer(time_ns, np.int64),
        {
            name: Column(
                np.frombuffer(values, fields[name].dtype),
                None if valid is None else np.frombuffer(valid, bool),
                categories,
            )
            for name, (values, valid, categories) in columns.items()
        },
    )
