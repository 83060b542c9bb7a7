"""What a mapping says of one field or of a time: read from TOML and held against the schema."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone
from types import MappingProxyType
from typing import Any

from spoofbench.schema import KINDS, Field, Kind
from spoofbench_converters.table.toml import Node
from spoofbench_converters.table.units import Unit, read_unit, unit_for

Constant = float | int | bool | str

VECTORS: Mapping[str, tuple[str, str, str]] = MappingProxyType(
    {
        "accel": ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2"),
        "gyro": ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps"),
        "linear_accel": ("linear_accel_x_mps2", "linear_accel_y_mps2", "linear_accel_z_mps2"),
        "field": ("field_x_ut", "field_y_ut", "field_z_ut"),
        "vel": ("vel_n_mps", "vel_e_mps", "vel_d_mps"),
        "rate": ("rate_x_radps", "rate_y_radps", "rate_z_radps"),
    }
)
"""Three fields that a mapping may give at once, in this order."""

ECEF = {"ecef_position": "position", "ecef_velocity": "velocity"}
"""Three columns of the Earth-centred frame each, which become geodetic coordinates and NED
velocity.
"""

_FIELD_SETTINGS = ("column", "unit", "offset", "missing", "values", "optional", "value")
_DAY_NS = 86_400_000_000_000
_EPOCHS = {
    "unix": 0,
    "gps": 3657 * _DAY_NS,
    "matlab": -719_529 * _DAY_NS,
}  # a MATLAB serial date counts days from the year 0


@dataclass(frozen=True, slots=True)
class FieldSpec:
    """Where a field's values come from: ``value = sign * unit(cell) + offset``, or a constant.

    Attributes:
        name: of the field, or ``ecef_position[0]`` and the like for what is turned into fields.
        column: None for a constant.
        negate: whether the sign is turned, beside a minus before the column's name.
        missing: cells that say that there is no value.
        values: by cell, the value; other cells are absent.
    """

    name: str
    column: str | None
    unit: Unit
    negate: bool = False
    offset: float = 0.0
    missing: tuple[str, ...] = ()
    values: Mapping[str, Constant] | None = None
    optional: bool = False
    constant: Constant | None = None


@dataclass(frozen=True, slots=True)
class TimeSpec:
    """How cells tell time.

    Attributes:
        column: a number or a text.
        unit: of the number; None: a text.
        format: of the text: ``iso``, or a pattern of ``strptime``.
        date: a column with the date, which stands before the text or whose day the number counts
            in.
        date_format: of the date where a number counts in its day: a pattern, else ``iso``.
        week: a column with the GPS week, whose second the number counts.
        since_ns: Unix time that the number counts from; None: when the clock was started, or a day
            that is given elsewhere.
        of_day: whether the number counts from midnight, or the text has no date.
        scale: ``utc`` or ``gps``; a time of GPS is ahead by the leap seconds.
        zone: what a text without zone is in.
        leap_seconds: GPS minus UTC where the mapping declares it.
        wraps: the number starts over at this value; 0: it does not.
        also: further columns that are read beside it.
    """

    column: str
    unit: Unit | None
    format: str
    date: str | None
    date_format: str
    week: str | None
    since_ns: int | None
    of_day: bool
    scale: str
    zone: timezone
    leap_seconds: int | None
    wraps: int
    also: tuple[str, ...] = ()

    @property
    def is_relative(self) -> bool:
        """Whether the day must come from elsewhere."""
        return (
            (self.unit is not None or self.of_day)
            and self.since_ns is None
            and self.week is None
            and self.date is None
        )

    def columns(self) -> tuple[str, ...]:
        return tuple(
            name for name in (self.column, self.date, self.week, *self.also) if name is not None
        )


def read_time(node: Node) -> TimeSpec:
    """Return what a mapping says of a time.

    Raises:
        ConversionError: it does not fit together.
    """
    node.only(
        "column",
        "unit",
        "format",
        "date",
        "week",
        "date_format",
        "since",
        "scale",
        "zone",
        "leap_seconds",
        "wraps",
    )
    if ("unit" in node) == ("format" in node):
        raise node.error(
            "needs a 'unit' if the column holds numbers, or else a 'format': 'iso' or a pattern "
            "such as '%d%m%y %H%M%S'"
        )
    unit = read_unit(node.text("unit")) if "unit" in node else None
    if unit is not None and unit.dimension != "time":
        raise node.error(f"has the unit {unit.name!r}, which is no unit of time")
    date, week = node.text("date", "") or None, node.text("week", "") or None
    since_ns, of_day = _since(node, unit is not None, date, week)
    of_day = of_day or (unit is None and date is None and _is_of_day(node.text("format")))
    return TimeSpec(
        column=node.text("column"),
        unit=unit,
        format=node.text("format", ""),
        date=date,
        date_format=node.text("date_format", "iso"),
        week=week,
        since_ns=since_ns,
        of_day=of_day,
        scale=node.one_of(
            "scale", ("utc", "gps"), "gps" if week or node.raw("since") == "gps" else "utc"
        ),
        zone=_zone(node),
        leap_seconds=node.count("leap_seconds") if "leap_seconds" in node else None,
        wraps=node.count("wraps"),
    )


def _since(
    node: Node, is_number: bool, date: str | None, week: str | None
) -> tuple[int | None, bool]:
    """Return where a number counts from, and whether from midnight."""
    given = node.text(
        "since", "" if not is_number else "day" if date else "week" if week else "unix"
    )
    if not is_number:
        if given or week:
            raise node.error("is a text, so it can have neither 'since' nor 'week'")
        return None, False
    if (given == "week") != (week is not None) or (date is not None and given != "day"):
        raise node.error(
            "must count since 'week' if it has a column 'week', and since 'day' if it has a "
            "column 'date'"
        )
    if given in ("start", "day", "week"):
        return None, given == "day"
    if given in _EPOCHS:
        return _EPOCHS[given], False
    try:
        return moment_ns(given), False
    except ValueError:
        raise node.error(
            f"has since {given!r}, which must be unix, gps, matlab, week, day, start or a date "
            "such as 2000-01-01"
        ) from None


def _is_of_day(pattern: str) -> bool:
    """Whether times in a pattern of ``strptime`` have no date."""
    return pattern != "iso" and not any(
        f"%{letter}" in pattern.replace("%%", "") for letter in "YyGcxDFsjdmbB"
    )


def moment_ns(text: str) -> int:
    """Return the Unix time of an ISO date or time; without zone it is UTC.

    Raises:
        ValueError: it is none.
    """
    moment = datetime.fromisoformat(text)
    aware = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
    return (aware - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000


def _zone(node: Node) -> timezone:
    text = node.text("zone", "+00:00")
    try:
        offset = datetime.strptime(text, "%z").utcoffset()
    except ValueError:
        offset = None
    if offset is None or abs(offset) > timedelta(hours=15):
        raise node.error(
            f"has the zone {text!r}, which must be written like +02:00; of zones with summer time "
            "give the offset of that day"
        )
    return timezone(offset)


def read_fields(
    node: Node, kind_name: str, settings: Sequence[str]
) -> tuple[tuple[FieldSpec, ...], TimeSpec | None, TimeSpec | None]:
    """Return what a topic's mapping says of its fields, of the time that a receiver claims, and of
    the time of receipt.

    Raises:
        ConversionError: there is no such field, or what is said does not fit it.
    """
    kind = KINDS[kind_name]
    vectors = [name for name, fields in VECTORS.items() if set(fields) <= set(kind.fields)]
    triples = list(ECEF) if {"lat_deg", "vel_n_mps"} <= set(kind.fields) else []
    times = [
        name
        for name in ("claims", "receive_time_ns")
        if name == "receive_time_ns" or {"gps_week", "tow_s"} <= set(kind.fields)
    ]
    node.only(*settings, *kind.fields, *vectors, *triples, *times)
    specs: list[FieldSpec] = []
    for key in node:
        if key in vectors:
            specs += _vector(node, key, VECTORS[key], kind)
        elif key in triples:
            specs += _ecef(node, key)
        elif key not in settings and key not in times:
            specs.append(_field(node, key, kind))
    names = [spec.name for spec in specs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise node.error(f"says what {twice!r} is twice")
    if not any(spec.column for spec in specs):
        raise node.error("has no field that comes from a column")
    claims, received = (
        read_time(node.child_of(name)) if name in node and name in times else None
        for name in ("claims", "receive_time_ns")
    )
    if claims and set(names) & {"gps_week", "tow_s"}:
        raise node.error("has 'claims', which gives 'gps_week' and 'tow_s': leave those out")
    return tuple(specs), claims, received


def _vector(node: Node, key: str, fields: Sequence[str], kind: Kind) -> Iterator[FieldSpec]:
    given = node.raw(key)
    inner = (
        Node({"columns": given}, f"{node.where}, {key!r}")
        if isinstance(given, list)
        else node.child_of(key)
    )
    inner.only("columns", "unit", "missing", "optional", *(["at_rest"] if key == "accel" else []))
    columns = inner.texts("columns")
    if len(columns) != 3:
        raise inner.error(
            f"has {len(columns)} columns, which must be three: those of {', '.join(fields)}"
        )
    down = inner.one_of("at_rest", ("up", "down"), "up") == "down"
    for field, column in zip(fields, columns, strict=True):
        settings = {
            name: inner.raw(name) for name in ("unit", "missing", "optional") if name in inner
        }
        spec = _field(Node({field: {"column": column, **settings}}, inner.where), field, kind)
        yield replace(spec, negate=down)


def _ecef(node: Node, key: str) -> Iterator[FieldSpec]:
    columns = node.texts(key)
    if len(columns) != 3:
        raise node.error(f"has {len(columns)} columns for {key!r}, which must be three: x, y and z")
    unit = unit_for("x_m" if key == "ecef_position" else "x_mps", None)
    yield from (FieldSpec(f"{key}[{place}]", column, unit) for place, column in enumerate(columns))


def _field(node: Node, name: str, kind: Kind) -> FieldSpec:
    field, given = kind.fields[name], node.raw(name)
    if field.category == "bytes":
        raise node.error(f"cannot fill {name!r}: a table has no bytes")
    if isinstance(given, str):
        return FieldSpec(name, given, unit_for(name, None))
    inner = node.child_of(name)
    inner.only(*_FIELD_SETTINGS)
    if ("column" in inner) == ("value" in inner):
        raise inner.error("needs either a 'column' or a constant 'value'")
    if "value" in inner:
        inner.only("value")
        return FieldSpec(
            name,
            None,
            unit_for(name, None),
            constant=_constant(inner, field, kind, inner.raw("value")),
        )
    if field.category != "float" and (
        "offset" in inner or ("unit" in inner and field.category != "integer")
    ):
        raise inner.error("is no measured quantity, so it has neither 'unit' nor 'offset'")
    values = inner.child("values")
    return FieldSpec(
        name,
        inner.text("column"),
        unit_for(name, inner.text("unit") if "unit" in inner else None),
        offset=inner.number("offset", 0.0),
        missing=inner.words("missing"),
        values={key: _constant(values, field, kind, values.raw(key)) for key in values}
        if values
        else None,
        optional=inner.flag("optional", False),
    )


def _constant(node: Node, field: Field, kind: Kind, given: Any) -> Constant:
    """Return a constant of a field: of an enum its number, by name with or without the enum's own
    prefix.
    """
    if field.category == "enum" and isinstance(given, str):
        numbers = enum_numbers(kind, field)
        if given not in numbers:
            raise node.error(
                f"has {given!r}, which is none of "
                f"{sorted(name for name in numbers if not name.startswith(_prefix(kind, field)))}"
            )
        return numbers[given]
    fits = {"float": int | float, "integer": int, "boolean": bool, "text": str}.get(field.category)
    if (
        fits is None
        or not isinstance(given, fits)
        or (isinstance(given, bool) and field.category != "boolean")
    ):
        raise node.error(f"has {given!r}, which does not fit {field.name!r}")
    if isinstance(given, int | float) and not isinstance(given, bool) and not abs(given) < 2**63:
        raise node.error(f"has {given!r}, which does not fit {field.name!r}")
    return float(given) if field.category == "float" else given


def _prefix(kind: Kind, field: Field) -> str:
    names: list[str] = [
        value.name for value in kind.message.fields_by_name[field.name].enum_type.values
    ]
    zero = min(names, key=len)
    while not all(name.startswith(zero) for name in names):
        zero = zero[:-1]
    return zero


def enum_numbers(kind: Kind, field: Field) -> dict[str, int]:
    """Return the numbers of an enum field's values by their names, with and without what all of
    them start with.
    """
    prefix = _prefix(kind, field)
    values = kind.message.fields_by_name[field.name].enum_type.values
    return {
        name: value.number
        for value in values
        for name in (value.name, value.name.removeprefix(prefix))
    }
