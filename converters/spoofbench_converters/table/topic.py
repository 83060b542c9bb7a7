"""From the cells of a table to the columns of one topic."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.conversion import RowBatch
from spoofbench.gnss_time import SECOND_NS, utc_to_gps, week_and_tow
from spoofbench.schema import KINDS
from spoofbench.table import Column
from spoofbench_converters.table import cells
from spoofbench_converters.table.fields import FieldSpec, enum_numbers
from spoofbench_converters.table.mapping import TopicSpec
from spoofbench_converters.table.settings import ECEF, Constant
from spoofbench_converters.table.times import TableClock

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


@dataclass(frozen=True, slots=True)
class TopicCells:
    """What the rows of a table say of a topic.

    Attributes:
        selected: which rows are the topic's by its conditions, bool ``(n,)``.
        bad: by column of the table, which of them have a wrong cell there, bool ``(n,)`` each.
        some: which of them say something new, bool ``(n,)``.
        repeated: which of them only repeat, bool ``(n,)``.
        columns: of all rows, by field; and the columns from which :meth:`TopicReader.derived` makes
            fields.
    """

    selected: Bools
    bad: Mapping[str, Bools]
    some: Bools
    repeated: Bools
    columns: Mapping[str, Column]


class TopicReader:
    """Reads one topic of a table.

    Attributes:
        repeated: how many rows only repeated the row before.
    """

    def __init__(self, spec: TopicSpec) -> None:
        self.spec = spec
        self.repeated = 0
        self._kind = KINDS[spec.kind]
        self._last: dict[str, str | None] = {}
        self._clocks = {
            name: TableClock(time)
            for name, time in (("claims", spec.claims), ("receive_time_ns", spec.receive_time))
            if time
        }

    def read(self, available: Mapping[str, Any], count: int) -> TopicCells:
        """Read the next rows, of which there are ``count``, from the table's columns by name."""
        selected = self._selected(available, count)
        changed = self._changed(available, selected)
        columns: dict[str, Column] = {}
        bad: dict[str, Bools] = {}
        some = np.zeros(count, bool)
        for field in self.spec.fields:
            if field.column is None:
                columns[field.name] = self._constant(field, count)
            elif (column := resolve(field.column, available)) is not None:
                name, minus = column
                minus = minus != field.negate
                columns[field.name], there, wrong = self._values(field, available[name], minus)
                some |= there
                bad[field.column] = bad.get(field.column, False) | wrong
        for name, clock in self._clocks.items():
            found, wrong = _time(name, clock, available)
            columns |= found
            bad[clock.spec.column] = bad.get(clock.spec.column, False) | wrong
        repeated = selected & ~changed
        self.repeated += int(repeated.sum())
        fresh = selected & changed
        return TopicCells(
            selected,
            {name: wrong & fresh for name, wrong in bad.items() if wrong.any()},
            fresh & some,
            repeated,
            columns,
        )

    def derived(self, rows: RowBatch) -> RowBatch:
        """Return rows with the fields that are made of the Earth-centred frame's columns."""
        if not any(f"{triple}[0]" in rows.columns for triple in ECEF):
            return rows
        numbers = {name: c.values for name, c in rows.columns.items() if c.categories is None}
        made = {name: Column(values) for name, values in geodetic(numbers).items()}
        return replace(rows, columns={**rows.columns, **made})

    def _selected(self, available: Mapping[str, Any], count: int) -> Bools:
        selected = np.ones(count, bool)
        for name, wanted in self.spec.where:
            selected &= cells.matches(available[name], wanted)
        for name, unwanted in self.spec.unless:
            selected &= ~cells.matches(available[name], unwanted)
        return selected

    def _changed(self, available: Mapping[str, Any], selected: Bools) -> Bools:
        """Which rows differ from the row of this topic before them in a column that must change."""
        import pyarrow as pa
        import pyarrow.compute as pc

        if not self.spec.changes or not selected.any():
            return np.ones(selected.size, bool)
        changed = np.zeros(int(selected.sum()), bool)
        for name in self.spec.changes:
            texts = pc.fill_null(pc.filter(cells.words(available[name]), pa.array(selected)), "")
            before = pa.array([self._last.get(name)], pa.string())
            shifted = pa.concat_arrays([before, texts.slice(0, len(texts) - 1)])
            changed |= np.array(
                pc.fill_null(pc.not_equal(texts, shifted), True).to_numpy(zero_copy_only=False),
                bool,
            )
            self._last[name] = texts[len(texts) - 1].as_py()
        result = np.zeros(selected.size, bool)
        result[selected] = changed
        return result

    def _constant(self, spec: FieldSpec, count: int) -> Column:
        assert spec.constant is not None
        if isinstance(spec.constant, str):
            return Column(np.zeros(count, np.int32), None, (spec.constant,))
        return Column(np.full(count, spec.constant))

    def _values(self, spec: FieldSpec, raw: Any, minus: bool) -> tuple[Column, Bools, Bools]:
        """Return a field's values, which are there, and which cells are wrong."""
        gone = cells.matches(raw, spec.missing) if spec.missing else np.zeros(len(raw), bool)
        field = self._kind.fields.get(spec.name)
        category = field.category if field else "float"
        if spec.values is not None:
            return *_mapped(spec.values, raw, gone, category), np.zeros(len(raw), bool)
        if category == "text":
            coded = cells.words(raw).dictionary_encode()
            codes = np.asarray(coded.indices.fill_null(-1).to_numpy(zero_copy_only=False), np.int32)
            codes = np.where(gone, np.int32(-1), codes)
            words = tuple(coded.dictionary.to_pylist())
            return Column(codes, None, words), codes >= 0, np.zeros(len(raw), bool)
        if category == "float" or (category == "integer" and (spec.unit.factor != 1 or minus)):
            numbers, bad = cells.numbers(raw)
            numbers = spec.unit.to_schema(-numbers if minus else numbers) + spec.offset
            bad |= np.isinf(numbers)
            numbers = np.where(gone | bad, np.nan, numbers)
            there = ~np.isnan(numbers)
            if category == "float":
                return Column(numbers), there, bad & ~gone
            bad |= there & (numbers != np.rint(numbers))
            there &= ~bad
            whole = np.where(there, numbers, 0).astype(np.int64)
        elif category == "integer":
            whole, there, bad = cells.integers(raw)
        else:
            whole, there, bad = cells.choices(raw, self._choices(spec.name, category))
        there = there & ~gone
        return Column(np.where(gone, 0, whole), there), there, bad & ~gone

    def _choices(self, name: str, category: str) -> Mapping[str, int]:
        if category == "boolean":
            return _FLAGS
        numbers = enum_numbers(self._kind, self._kind.fields[name])
        return {
            **{str(number): number for number in numbers.values()},
            **{text.lower(): number for text, number in numbers.items()},
        }


def _mapped(
    values: Mapping[str, Constant], raw: Any, gone: Bools, category: str
) -> tuple[Column, Bools]:
    """Return the values that a mapping has for cells, and which cells it has one for."""
    words = tuple(dict.fromkeys(value for value in values.values() if isinstance(value, str)))
    found = np.full(len(raw), np.nan if category == "float" else -1 if category == "text" else 0)
    there = np.zeros(len(raw), bool)
    for text, value in values.items():
        same = cells.matches(raw, (text,))
        found[same] = words.index(value) if isinstance(value, str) else value
        there |= same
    there &= ~gone
    if category == "float":
        return Column(found), there
    if category == "text":
        return Column(found.astype(np.int32), None, words), there
    return Column(found.astype(np.int64), there), there


def _time(
    name: str, clock: TableClock, available: Mapping[str, Any]
) -> tuple[dict[str, Column], Bools]:
    """Return the fields of a time, and which rows have something there that is no time."""
    spec = clock.spec
    time_ns, bad = clock.read(available)
    if name == "receive_time_ns":
        columns = {name: Column(time_ns, ~bad)}
    else:
        gps_ns = utc_to_gps(time_ns, spec.leap_seconds)
        bad = bad | (gps_ns < 0)
        week, tow_ns = week_and_tow(gps_ns)
        columns = {
            "gps_week": Column(np.where(bad, 0, week), ~bad),
            "tow_s": Column(np.where(bad, np.nan, tow_ns / SECOND_NS)),
        }
    there = np.logical_and.reduce([cells.present(available[name]) for name in spec.columns()])
    return columns, np.asarray(bad & there)


def geodetic(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return ``lat_deg lon_deg height_m`` on WGS 84 and ``vel_n_mps vel_e_mps vel_d_mps``, each
    ``(n,)``.

    Args:
        columns: ``ecef_position[0..2]`` in metres, and, if there is a velocity,
            ``ecef_velocity[0..2]`` in m/s.
    """
    import pymap3d

    x, y, z = (columns[f"ecef_position[{place}]"] for place in range(3))
    if not x.size:
        return {}
    lat, lon, height = pymap3d.ecef2geodetic(x, y, z)
    found = {"lat_deg": lat, "lon_deg": lon, "height_m": height}
    if "ecef_velocity[0]" in columns:
        east, north, up = pymap3d.ecef2enuv(
            *(columns[f"ecef_velocity[{place}]"] for place in range(3)), lat, lon
        )
        found |= {"vel_n_mps": north, "vel_e_mps": east, "vel_d_mps": -up}
    absent = np.isnan(x + y + z)
    return {name: np.where(absent, np.nan, values) for name, values in found.items()}


def earth_centred(rows: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return ``ecef_position[0..2]`` in metres and ``ecef_velocity[0..2]`` in m/s, ``(n,)`` each:
    the reverse of :func:`geodetic`.
    """
    import pymap3d

    lat, lon = rows["lat_deg"], rows["lon_deg"]
    position = pymap3d.geodetic2ecef(lat, lon, rows["height_m"])
    velocity = pymap3d.enu2uvw(rows["vel_e_mps"], rows["vel_n_mps"], -rows["vel_d_mps"], lat, lon)
    triples = (("ecef_position", position), ("ecef_velocity", velocity))
    return {
        f"{name}[{place}]": np.asarray(values)
        for name, triple in triples
        for place, values in enumerate(triple)
    }
