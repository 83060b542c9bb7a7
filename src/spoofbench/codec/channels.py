"""Channels and their protobuf schemas: ours as MCAP wants them, and which topics and fields of ours
the channels of any writer's file have.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel, Schema

from spoofbench.codec.scan import McapFile
from spoofbench.errors import FormatError, RecordingError
from spoofbench.schema import KINDS, Category, Field, Kind, split_topic

ENCODING = "protobuf"
LOCATION_FIX = "foxglove.LocationFix"
LOCATION_SUFFIX = "/location_fix"

VARINT, FIXED64, DELIMITED, FIXED32 = 0, 1, 2, 5
"""Wire types of protobuf."""

_FLOATS = {FieldDescriptor.TYPE_DOUBLE: FIXED64, FieldDescriptor.TYPE_FLOAT: FIXED32}
_INTEGERS = {
    FieldDescriptor.TYPE_FIXED32: FIXED32,
    FieldDescriptor.TYPE_SFIXED32: FIXED32,
    FieldDescriptor.TYPE_FIXED64: FIXED64,
    FieldDescriptor.TYPE_SFIXED64: FIXED64,
    FieldDescriptor.TYPE_INT32: VARINT,
    FieldDescriptor.TYPE_INT64: VARINT,
    FieldDescriptor.TYPE_UINT32: VARINT,
    FieldDescriptor.TYPE_UINT64: VARINT,
    FieldDescriptor.TYPE_SINT32: VARINT,
    FieldDescriptor.TYPE_SINT64: VARINT,
}
_ENUM = {FieldDescriptor.TYPE_ENUM: VARINT}
_READABLE: Mapping[Category, Mapping[int, int]] = {
    "float": {**_FLOATS, **_INTEGERS},
    "integer": _INTEGERS,
    "boolean": {FieldDescriptor.TYPE_BOOL: VARINT},
    "enum": {**_ENUM, **_INTEGERS},
    "text": {FieldDescriptor.TYPE_STRING: DELIMITED},
    "bytes": {FieldDescriptor.TYPE_BYTES: DELIMITED},
}
"""The declared types that a column of each category can be read from, and their wire types."""


@dataclass(frozen=True, slots=True)
class WireField:
    """How a file writes one of our fields; without presence, a field that is left out is zero."""

    field: Field
    number: int
    type: int
    wire_type: int
    has_presence: bool


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """A channel that holds rows of one of our topics.

    Attributes:
        topic: its name in the recording.
        kind: of the rows.
        wires: how the file writes those of our fields that the channel has.
        message: the file's own message class.
        is_plain: no field takes the place of another, as the members of a oneof do.
    """

    topic: str
    kind: Kind
    wires: tuple[WireField, ...]
    message: Any
    is_plain: bool


@cache
def descriptor_set(message: Any) -> bytes:
    """Return a message descriptor's serialised FileDescriptorSet, dependencies first."""
    files = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: Any) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(files.file.add())

    add(message.file)
    return files.SerializeToString(deterministic=True)


def topic_channels(file: McapFile) -> tuple[dict[int, TopicChannel], dict[str, str]]:
    """Return what each channel of ours is, by id, and what the others are, by topic.

    Raises:
        FormatError: a channel's schema is missing, or messages belong to no channel.
    """
    ours, unread = {}, {}
    for channel in file.channels.values():
        schema = file.schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            raise FormatError(
                f"channel {channel.topic!r} of {file.name} has no schema {channel.schema_id!r}"
            )
        topic_channel = _topic_channel(channel, schema)
        if topic_channel is not None:
            ours[channel.id] = topic_channel
        elif not _is_derived(channel, schema):
            unread[channel.topic] = (
                f"{schema.name if schema else 'no schema'} ({channel.message_encoding})"
            )
    for section in file.sections:
        undefined = section.channels - file.channels.keys()
        if undefined:
            raise FormatError(
                f"{file.name} has messages of channel {min(undefined)!r}, which it does not define"
            )
    return ours, unread


def _topic_channel(channel: Channel, schema: Schema | None) -> TopicChannel | None:
    """Return what a file's channel is to us, None where it is nothing of ours."""
    if channel.message_encoding != ENCODING or schema is None or schema.encoding != ENCODING:
        return None
    topic = _our_topic(channel.topic, schema.name)
    if topic is None:
        return None
    kind = KINDS[split_topic(topic)[1]]
    if schema.name == kind.message.full_name and schema.data == descriptor_set(kind.message):
        message: Any = kind.message
    else:
        message = _message_of(schema)
    if message is None:
        return None
    wires = tuple(
        wire
        for field in kind.fields.values()
        if (wire := _wire(field, message.fields_by_name.get(field.name)))
    )
    if not wires:
        return None
    return TopicChannel(
        topic,
        kind,
        wires,
        GetMessageClass(message),
        all(len(oneof.fields) == 1 for oneof in message.oneofs),
    )


def _is_derived(channel: Channel, schema: Schema | None) -> bool:
    """Whether a channel is a view that the codec derives from others and never reads back."""
    return (
        schema is not None
        and schema.name == LOCATION_FIX
        and channel.topic.endswith(LOCATION_SUFFIX)
    )


def _our_topic(topic: str, schema_name: str) -> str | None:
    try:
        split_topic(topic)
    except RecordingError:
        kinds = [kind for kind in KINDS.values() if kind.message.full_name == schema_name]
        # Pva is the message of two kinds; the reference is known by its topic alone.
        return (
            f"/{topic.strip('/').replace('/', '_') or 'unnamed'}/{kinds[0].name}" if kinds else None
        )
    return topic


def _message_of(schema: Schema) -> Any | None:
    """Return the message descriptor that a schema record names, None where its descriptors are
    invalid.
    """
    pool = DescriptorPool()
    try:
        files = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
        for name in list(files):
            _add(pool, files, name)
        return pool.FindMessageTypeByName(schema.name)
    except (DecodeError, KeyError, TypeError, ValueError, RecursionError):
        return None


def _add(pool: DescriptorPool, files: dict[str, Any], name: str) -> None:
    file = files.pop(name, None)
    if file is not None:
        for dependency in file.dependency:
            _add(pool, files, dependency)
        pool.Add(file)


def _wire(field: Field, theirs: Any | None) -> WireField | None:
    if theirs is None or theirs.is_repeated or theirs.type not in _READABLE[field.category]:
        return None
    return WireField(
        field,
        theirs.number,
        theirs.type,
        _READABLE[field.category][theirs.type],
        theirs.has_presence,
    )
