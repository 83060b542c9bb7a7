"""What a mapping says of one field or of a time, held against the schema."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone

from spoofbench.schema import KINDS, Field, Kind
from spoofbench_converters.table.settings import (
    ECEF,
    VECTORS,
    AccelSettings,
    Constant,
    FieldSettings,
    TimeSettings,
    TopicSettings,
    VectorSettings,
    cells_as_text,
)
from spoofbench_converters.table.units import Unit, read_unit, unit_for
from spoofbench_converters.text.numbers import moment_ns

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


def time_spec(settings: TimeSettings) -> TimeSpec:
    """Return how cells tell time, as a mapping says.

    Raises:
        ValueError, ConversionError: it does not fit together.
    """
    unit = read_unit(settings.unit) if settings.unit is not None else None
    if unit is not None and unit.dimension != "time":
        raise ValueError(f"unit = {unit.name!r} is no unit of time")
    date, week, pattern = settings.date or None, settings.week or None, settings.format or ""
    since_ns, of_day = _since(settings, date, week) if unit is not None else (None, False)
    is_gps = week is not None or settings.since == "gps"
    return TimeSpec(
        column=settings.column,
        unit=unit,
        format=pattern,
        date=date,
        date_format=settings.date_format,
        week=week,
        since_ns=since_ns,
        of_day=of_day or (unit is None and date is None and _is_of_day(pattern)),
        scale=settings.scale or ("gps" if is_gps else "utc"),
        zone=_zone(settings.zone),
        leap_seconds=settings.leap_seconds,
        wraps=settings.wraps,
    )


def _since(settings: TimeSettings, date: str | None, week: str | None) -> tuple[int | None, bool]:
    """Return where a number counts from, and whether from midnight."""
    since = settings.since
    if since is None:
        since = "day" if date else "week" if week else "unix"
    if (since == "week") != (week is not None) or (date is not None and since != "day"):
        raise ValueError(
            "a time must count since 'week' if it has a column 'week', and since 'day' if it has a "
            "column 'date'"
        )
    if since in ("start", "day", "week"):
        return None, since == "day"
    if since in _EPOCHS:
        return _EPOCHS[since], False
    try:
        return moment_ns(since), False
    except ValueError:
        raise ValueError(
            f"since = {since!r} must be unix, gps, matlab, week, day, start or a date such as "
            "2000-01-01"
        ) from None


def _is_of_day(pattern: str) -> bool:
    """Whether times in a pattern of ``strptime`` have no date."""
    return pattern != "iso" and not any(
        f"%{letter}" in pattern.replace("%%", "") for letter in "YyGcxDFsjdmbB"
    )


def _zone(text: str) -> timezone:
    try:
        offset = datetime.strptime(text, "%z").utcoffset()
    except ValueError:
        offset = None
    if offset is None or abs(offset) > timedelta(hours=15):
        raise ValueError(
            f"zone = {text!r} must be written like +02:00; of zones with summer time give the "
            "offset of that day"
        )
    return timezone(offset)


def field_specs(
    settings: TopicSettings, keys: Sequence[str], kind_name: str
) -> tuple[FieldSpec, ...]:
    """Return what a topic's mapping says of its fields, in the order of its keys.

    Raises:
        ValueError, ConversionError: what is said does not fit the field.
    """
    kind = KINDS[kind_name]
    specs: list[FieldSpec] = []
    for key in keys:
        given = getattr(settings, key)
        if key in VECTORS and key not in kind.fields:
            specs += _vector(key, given, kind)
        elif key in ECEF:
            unit = unit_for("x_m" if key == "ecef_position" else "x_mps", None)
            specs += (FieldSpec(f"{key}[{i}]", column, unit) for i, column in enumerate(given))
        elif key in kind.fields and not isinstance(given, TimeSettings):
            specs.append(_field(key, given, kind))
    names = [spec.name for spec in specs]
    duplicated = next((name for name in names if names.count(name) > 1), None)
    if duplicated:
        raise ValueError(f"the field {duplicated!r} is duplicated")
    if not any(spec.column for spec in specs):
        raise ValueError("the topic has no field that comes from a column")
    if getattr(settings, "claims", None) and set(names) & {"gps_week", "tow_s"}:
        raise ValueError("'claims' gives 'gps_week' and 'tow_s': leave those out")
    return tuple(specs)


def _vector(
    key: str, given: tuple[str, str, str] | VectorSettings, kind: Kind
) -> Iterator[FieldSpec]:
    vector = VectorSettings(given) if isinstance(given, tuple) else given
    down = isinstance(vector, AccelSettings) and vector.at_rest == "down"
    for name, column in zip(VECTORS[key], vector.columns, strict=True):
        settings = FieldSettings(
            column, vector.unit, missing=vector.missing, optional=vector.optional
        )
        yield replace(_field(name, settings, kind), negate=down)


def _field(name: str, given: str | FieldSettings, kind: Kind) -> FieldSpec:
    field = kind.fields[name]
    if field.category == "bytes":
        raise ValueError(f"{name!r} cannot be filled: a table has no bytes")
    settings = FieldSettings(given) if isinstance(given, str) else given
    if settings.value is not None:
        constant = _constant(field, kind, settings.value)
        return FieldSpec(name, None, unit_for(name, None), constant=constant)
    has_unit = settings.unit is not None and field.category != "integer"
    if field.category != "float" and (settings.offset or has_unit):
        raise ValueError(f"{name!r} is no measured quantity, so it has neither 'unit' nor 'offset'")
    values = settings.values
    return FieldSpec(
        name,
        settings.column,
        unit_for(name, settings.unit),
        offset=settings.offset,
        missing=cells_as_text(settings.missing),
        values=values and {key: _constant(field, kind, value) for key, value in values.items()},
        optional=settings.optional,
    )


def _constant(field: Field, kind: Kind, value: Constant) -> Constant:
    """Return a constant of a field: of an enum its number, by name with or without the enum's own
    prefix.
    """
    if field.category == "enum" and isinstance(value, str):
        numbers = enum_numbers(kind, field)
        if value not in numbers:
            prefix = _prefix(kind, field)
            names = sorted(name for name in numbers if not name.startswith(prefix))
            raise ValueError(f"{field.name!r} has {value!r}, which is none of {names}")
        return numbers[value]
    fits = {"float": int | float, "integer": int, "boolean": bool, "text": str}.get(field.category)
    if (
        fits is None
        or not isinstance(value, fits)
        or (isinstance(value, bool) and field.category != "boolean")
        or (isinstance(value, float) and not abs(value) < 2**63)
    ):
        raise ValueError(f"{value!r} does not fit {field.name!r}")
    return float(value) if field.category == "float" else value


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
