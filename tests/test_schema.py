"""The schema: generated code is current, changes are additive, rows keep a constant layout."""

import runpy
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor import FieldDescriptor

from spoofbench.errors import RecordingError
from spoofbench.schema import KINDS, split_topic, topic_of

ROOT = Path(__file__).parent.parent
COMMITTED = Path(__file__).parent / "data" / "schema_v1.binpb"


def _files() -> descriptor_pb2.FileDescriptorSet:
    files = descriptor_pb2.FileDescriptorSet()
    for file in sorted({kind.message.file for kind in KINDS.values()}, key=lambda file: file.name):
        file.CopyToProto(files.file.add())
    return files


def test_generated_modules_are_current(tmp_path: Path) -> None:
    pytest.importorskip("grpc_tools", reason="grpcio-tools is a development requirement")
    runpy.run_path(str(ROOT / "schemas" / "generate.py"))["generate"](tmp_path)
    for path in tmp_path.rglob("*_pb2.py*"):
        assert path.read_text() == (ROOT / "src" / path.relative_to(tmp_path)).read_text()
    assert len(list(tmp_path.rglob("*_pb2.py"))) == len(list((ROOT / "schemas").rglob("*.proto")))


def test_changes_are_additive() -> None:
    """Every field and enum value that was ever committed keeps its name, number and type."""
    then = descriptor_pb2.FileDescriptorSet.FromString(COMMITTED.read_bytes())
    now = {file.package + "." + m.name: m for file in _files().file for m in file.message_type}
    now_enums = {
        file.package + "." + e.name: {(v.name, v.number) for v in e.value}
        for file in _files().file
        for e in file.enum_type
    }
    for file in then.file:
        assert file.package == "spoofbench.schema.v1"
        for message in file.message_type:
            fields = {
                (f.name, f.number, f.type) for f in now[f"{file.package}.{message.name}"].field
            }
            assert {(f.name, f.number, f.type) for f in message.field} <= fields
        for enum in file.enum_type:
            assert {(v.name, v.number) for v in enum.value} <= now_enums[
                f"{file.package}.{enum.name}"
            ]


@pytest.mark.parametrize("kind", KINDS)
def test_fields_are_optional_scalars_of_constant_width(kind: str) -> None:
    for field in KINDS[kind].message.fields:
        assert field.has_presence
        assert not field.is_repeated
        assert field.type not in (
            FieldDescriptor.TYPE_MESSAGE,
            FieldDescriptor.TYPE_INT32,
            FieldDescriptor.TYPE_UINT64,
        )
        if field.enum_type:
            assert all(0 <= value.number < 128 for value in field.enum_type.values)


@pytest.mark.parametrize(
    "topic", ["/imu0/imu", "/gnss0/gnss/pvt", "/reference/pva", "/truth/attack", "/truth/clean"]
)
def test_topics_split_and_join(topic: str) -> None:
    assert topic_of(*split_topic(topic)) == topic


@pytest.mark.parametrize(
    "topic",
    ["imu0/imu", "/imu", "/gnss0/gnss", "/gnss0/gnss/pvt/x", "//imu", "/a/truth/attack", ""],
)
def test_other_topics_are_refused(topic: str) -> None:
    with pytest.raises(RecordingError, match="is not a topic"):
        split_topic(topic)
