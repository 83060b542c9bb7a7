"""The schema: which kinds of rows there are and which columns each has.

The only list of fields is in ``schemas/spoofbench/schema/v1/*.proto``; everything here is derived
from the protobuf descriptors of the generated modules in :mod:`spoofbench.schema.v1`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from google.protobuf.descriptor import FieldDescriptor

from spoofbench.errors import RecordingError
from spoofbench.schema.v1 import aiding_pb2, attack_pb2, gnss_pb2, imu_pb2, ins_pb2

SCHEMA_VERSION = "1"

Category = Literal["float", "integer", "boolean", "enum", "text", "bytes"]

_TYPES: Mapping[int, tuple[Category, str]] = {
    FieldDescriptor.TYPE_DOUBLE: ("float", "float64"),
    FieldDescriptor.TYPE_FLOAT: ("float", "float32"),
    FieldDescriptor.TYPE_FIXED32: ("integer", "uint32"),
    FieldDescriptor.TYPE_FIXED64: ("integer", "uint64"),
    FieldDescriptor.TYPE_SFIXED32: ("integer", "int32"),
    FieldDescriptor.TYPE_SFIXED64: ("integer", "int64"),
    FieldDescriptor.TYPE_BOOL: ("boolean", "bool"),
    FieldDescriptor.TYPE_ENUM: ("enum", "int32"),
    FieldDescriptor.TYPE_STRING: ("text", "int32"),
    FieldDescriptor.TYPE_BYTES: ("bytes", "int32"),
}


@dataclass(frozen=True, slots=True)
class Field:
    """One column of a kind.

    ``dtype`` is the numpy dtype name of the column's values; text and bytes are dictionary-coded,
    so theirs is the int32 of the codes.
    """

    name: str
    number: int
    category: Category
    dtype: str


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of row: its name, its protobuf message descriptor and its fields by name, in
    field-number order.
    """

    name: str
    message: Any
    fields: Mapping[str, Field]

    @property
    def is_gnss_derived(self) -> bool:
        """Whether a spoofer of GNSS signals can change rows of this kind."""
        return self.name.startswith("gnss/") or self.name == "ins/pva"


def _kind(name: str, message: Any) -> Kind:
    fields = {
        field.name: Field(field.name, field.number, *_TYPES[field.type])
        for field in sorted(message.fields, key=lambda field: field.number)
    }
    return Kind(name, message, MappingProxyType(fields))


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        name: _kind(name, message)
        for name, message in {
            "imu": imu_pb2.Imu.DESCRIPTOR,
            "gnss/pvt": gnss_pb2.Pvt.DESCRIPTOR,
            "gnss/signal": gnss_pb2.Signal.DESCRIPTOR,
            "gnss/observation": gnss_pb2.Observation.DESCRIPTOR,
            "gnss/clock": gnss_pb2.Clock.DESCRIPTOR,
            "gnss/rf": gnss_pb2.Rf.DESCRIPTOR,
            "gnss/navdata": gnss_pb2.NavData.DESCRIPTOR,
            "gnss/integrity": gnss_pb2.Integrity.DESCRIPTOR,
            "gnss/timemark": gnss_pb2.TimeMark.DESCRIPTOR,
            "ins/pva": ins_pb2.Pva.DESCRIPTOR,
            "mag": aiding_pb2.Mag.DESCRIPTOR,
            "baro": aiding_pb2.Baro.DESCRIPTOR,
            "odometer": aiding_pb2.Odometer.DESCRIPTOR,
            "reference/pva": ins_pb2.Pva.DESCRIPTOR,
            "truth/attack": attack_pb2.Attack.DESCRIPTOR,
            "truth/clean": attack_pb2.CleanInterval.DESCRIPTOR,
        }.items()
    }
)

SENSOR_KINDS = frozenset(KINDS) - {"reference/pva", "truth/attack", "truth/clean"}
"""The kinds that a detector may see."""

REFERENCE_TOPIC = "/reference/pva"
TRUTH_TOPIC = "/truth/attack"
CLEAN_TOPIC = "/truth/clean"
LABEL_TOPICS = frozenset({TRUTH_TOPIC, CLEAN_TOPIC})
"""What says where a recording is attacked, and where it is not."""


def split_topic(topic: str) -> tuple[str, str]:
    """Return ``(source, kind)`` of a topic; the source of the reference and the truth is empty.

    Raises:
        RecordingError: the topic is not ``/<source>/<kind>`` with a kind of the schema.
    """
    if topic in {REFERENCE_TOPIC, *LABEL_TOPICS}:
        return "", topic[1:]
    source, _, kind = topic.removeprefix("/").partition("/")
    if not topic.startswith("/") or not source or kind not in SENSOR_KINDS:
        raise RecordingError(
            f"{topic!r} is not a topic: it must be /<source>/<kind> with a kind of "
            f"{sorted(SENSOR_KINDS)}"
        )
    return source, kind


def topic_of(source: str, kind: str) -> str:
    """Return the topic of a source's rows of one kind."""
    return f"/{source}/{kind}" if source else f"/{kind}"
