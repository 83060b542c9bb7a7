from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Attack(_message.Message):
    __slots__ = ("start_ns", "end_ns", "attack", "strength", "strength_unit", "level", "sources", "base_ids", "seed", "parameters", "provenance", "labelled_by", "label_source", "time_base", "time_check")
    START_NS_FIELD_NUMBER: _ClassVar[int]
    END_NS_FIELD_NUMBER: _ClassVar[int]
    ATTACK_FIELD_NUMBER: _ClassVar[int]
    CLASS_FIELD_NUMBER: _ClassVar[int]
    STRENGTH_FIELD_NUMBER: _ClassVar[int]
    STRENGTH_UNIT_FIELD_NUMBER: _ClassVar[int]
    LEVEL_FIELD_NUMBER: _ClassVar[int]
    SOURCES_FIELD_NUMBER: _ClassVar[int]
    BASE_IDS_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    PROVENANCE_FIELD_NUMBER: _ClassVar[int]
    LABELLED_BY_FIELD_NUMBER: _ClassVar[int]
    LABEL_SOURCE_FIELD_NUMBER: _ClassVar[int]
    TIME_BASE_FIELD_NUMBER: _ClassVar[int]
    TIME_CHECK_FIELD_NUMBER: _ClassVar[int]
    start_ns: int
    end_ns: int
    attack: str
    strength: float
    strength_unit: str
    level: str
    sources: str
    base_ids: str
    seed: int
    parameters: str
    provenance: str
    labelled_by: str
    label_source: str
    time_base: str
    time_check: str
    def __init__(self, start_ns: _Optional[int] = ..., end_ns: _Optional[int] = ..., attack: _Optional[str] = ..., strength: _Optional[float] = ..., strength_unit: _Optional[str] = ..., level: _Optional[str] = ..., sources: _Optional[str] = ..., base_ids: _Optional[str] = ..., seed: _Optional[int] = ..., parameters: _Optional[str] = ..., provenance: _Optional[str] = ..., labelled_by: _Optional[str] = ..., label_source: _Optional[str] = ..., time_base: _Optional[str] = ..., time_check: _Optional[str] = ..., **kwargs) -> None: ...

class CleanInterval(_message.Message):
    __slots__ = ("start_ns", "end_ns", "labelled_by", "label_source", "time_base", "time_check")
    START_NS_FIELD_NUMBER: _ClassVar[int]
    END_NS_FIELD_NUMBER: _ClassVar[int]
    LABELLED_BY_FIELD_NUMBER: _ClassVar[int]
    LABEL_SOURCE_FIELD_NUMBER: _ClassVar[int]
    TIME_BASE_FIELD_NUMBER: _ClassVar[int]
    TIME_CHECK_FIELD_NUMBER: _ClassVar[int]
    start_ns: int
    end_ns: int
    labelled_by: str
    label_source: str
    time_base: str
    time_check: str
    def __init__(self, start_ns: _Optional[int] = ..., end_ns: _Optional[int] = ..., labelled_by: _Optional[str] = ..., label_source: _Optional[str] = ..., time_base: _Optional[str] = ..., time_check: _Optional[str] = ...) -> None: ...
