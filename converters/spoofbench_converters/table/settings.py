"""What the sections of a mapping may say: the keys of its TOML file, with their types."""

from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass
from functools import cache
from types import MappingProxyType
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Lt, MinLen, doc

from spoofbench.config import NOT_ONLY_FINITE
from spoofbench.schema import KINDS

Format = Literal["csv", "parquet", "mat", "npy", "json"]
Clock = Literal["sensor", "recorder", "gnss"]
Constant = bool | int | float | str
Count = Annotated[int, Ge(0)]

Texts = Annotated[
    str | tuple[Annotated[str, MinLen(1)], ...], doc("a string or a list of non-empty strings")
]
Cells = Annotated[
    Constant | tuple[Constant, ...], NOT_ONLY_FINITE, doc("strings or numbers that cells hold")
]
"""What cells of a table may hold."""

Three = Annotated[
    tuple[str, str, str], doc("a list of three columns: x, y and z, or north, east and down")
]

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


@dataclass(frozen=True, slots=True)
class TimeSettings:
    """A time; see :class:`spoofbench_converters.table.fields.TimeSpec`."""

    column: str
    unit: str | None = None
    format: str | None = None
    date: str | None = None
    week: str | None = None
    date_format: str = "iso"
    since: str | None = None
    scale: Literal["utc", "gps"] | None = None
    zone: str = "+00:00"
    leap_seconds: Count | None = None
    wraps: Count = 0

    def __post_init__(self) -> None:
        if (self.unit is None) == (self.format is None):
            raise ValueError(
                "a time needs a 'unit' if the column holds numbers, or else a 'format': 'iso' or a "
                "pattern such as '%d%m%y %H%M%S'"
            )
        if self.unit is None and (self.since or self.week):
            raise ValueError("a time that is a text can have neither 'since' nor 'week'")


@dataclass(frozen=True, slots=True)
class FieldSettings:
    """A field; see :class:`spoofbench_converters.table.fields.FieldSpec`."""

    column: str | None = None
    unit: str | None = None
    offset: Annotated[float, Gt(-1e30), Lt(1e30)] = 0.0
    missing: Cells = ()
    values: Mapping[str, Constant] | None = None
    optional: bool = False
    value: Constant | None = None

    def __post_init__(self) -> None:
        if (self.column is None) == (self.value is None):
            raise ValueError("a field needs either a 'column' or a constant 'value'")
        others = (self.unit, self.offset, self.missing, self.values, self.optional)
        if self.value is not None and others != (None, 0.0, (), None, False):
            raise ValueError("a constant 'value' has no further settings")


@dataclass(frozen=True, slots=True)
class VectorSettings:
    """Three fields of one vector."""

    columns: Three
    unit: str | None = None
    missing: Cells = ()
    optional: bool = False


@dataclass(frozen=True, slots=True)
class AccelSettings(VectorSettings):
    """Three fields of an acceleration.

    Attributes:
        at_rest: whether the columns show specific force, which points up at rest, or gravity.
    """

    at_rest: Literal["up", "down"] = "up"


@dataclass(frozen=True)
class TopicSettings:
    """A topic, apart from its fields: :func:`topic_settings` adds those of its kind."""

    where: Mapping[str, Cells] = field(default_factory=dict)
    unless: Mapping[str, Cells] = field(default_factory=dict)
    changes: Texts = ()


@cache
def topic_settings(kind_name: str) -> type[TopicSettings]:
    """Return the dataclass of a topic of a kind, with what of the schema a mapping can fill."""
    names = set(KINDS[kind_name].fields)
    annotations: dict[str, object] = dict.fromkeys(KINDS[kind_name].fields, str | FieldSettings)
    for name, parts in VECTORS.items():
        if set(parts) <= names:
            annotations[name] = Three | (AccelSettings if name == "accel" else VectorSettings)
    if {"lat_deg", "vel_n_mps"} <= names:
        annotations |= dict.fromkeys(ECEF, Three)
    if {"gps_week", "tow_s"} <= names:
        annotations["claims"] = TimeSettings
    annotations["receive_time_ns"] = TimeSettings
    return make_dataclass(
        kind_name.replace("/", "_").title(),
        [(name, annotation, None) for name, annotation in annotations.items()],
        bases=(TopicSettings,),
        frozen=True,
        eq=False,
        repr=False,
    )


@dataclass(frozen=True, slots=True)
class TableSettings:
    """A table, apart from its topics; see :class:`spoofbench_converters.table.mapping.TableSpec`
    and :class:`~spoofbench_converters.table.mapping.Layout`.
    """

    files: Texts = ()
    messages: Texts = ()
    format: Format | None = None
    delimiter: str = ","
    header: bool = True
    columns: Texts = ()
    signature: str = ""
    comment: str = ""
    skip_lines: Count = 0
    decimal_comma: bool = False
    encoding: Literal["utf-8", "latin-1"] = "utf-8"
    variable: str = ""
    index: str = ""
    flight: Texts = ()
    time: TimeSettings | None = None

    def __post_init__(self) -> None:
        files, columns = as_tuple(self.files), as_tuple(self.columns)
        if any(pattern.startswith("/") or ".." in pattern.split("/") for pattern in files):
            raise ValueError(f"files = {list(files)!r} must lie within the mapping's own folder")
        if self.time is None and not self.messages:
            raise ValueError(
                "the table has no time: say at least which column it is, as in time = { column = "
                "'t', unit = 's' }"
            )
        is_character = len(self.delimiter) == 1 and self.delimiter.isascii()
        if self.delimiter != "whitespace" and (not is_character or self.delimiter in '"\r\n'):
            raise ValueError(
                f"delimiter = {self.delimiter!r} must be one ASCII character or 'whitespace'"
            )
        if not self.header and not columns and self.format in (None, "csv"):
            raise ValueError(
                "a table without header needs 'columns': a name for each, from the left"
            )
        if len(set(columns)) < len(columns):
            raise ValueError("'columns' names a column twice")


@dataclass(frozen=True, slots=True)
class AnchorSettings:
    """Where a clock without date meets time."""

    table: str
    time: TimeSettings | None = None
    rtklib_tags: str = ""

    def __post_init__(self) -> None:
        if (self.time is None) == (not self.rtklib_tags):
            raise ValueError("an anchor needs one of 'time' and 'rtklib_tags'")


@dataclass(frozen=True, slots=True)
class MappingSettings:
    """A mapping; what its tables hold is read table by table."""

    clock: Clock
    about: str = ""
    recognise: bool = False
    source: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    table: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    anchor: AnchorSettings | None = None


def as_tuple(texts: Texts) -> tuple[str, ...]:
    """Return one string, or several, as a tuple."""
    return (texts,) if isinstance(texts, str) else texts


def cells_as_text(cells: Cells) -> tuple[str, ...]:
    """Return what cells may hold as the texts that they hold."""
    several = cells if isinstance(cells, tuple) else (cells,)
    return tuple(str(each).lower() if isinstance(each, bool) else str(each) for each in several)
