from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Mag(_message.Message):
    __slots__ = ("field_x_ut", "field_y_ut", "field_z_ut", "receive_time_ns")
    FIELD_X_UT_FIELD_NUMBER: _ClassVar[int]
    FIELD_Y_UT_FIELD_NUMBER: _ClassVar[int]
    FIELD_Z_UT_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    field_x_ut: float
    field_y_ut: float
    field_z_ut: float
    receive_time_ns: int
    def __init__(self, field_x_ut: _Optional[float] = ..., field_y_ut: _Optional[float] = ..., field_z_ut: _Optional[float] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class Baro(_message.Message):
    __slots__ = ("pressure_pa", "temperature_degc", "receive_time_ns")
    PRESSURE_PA_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_DEGC_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    pressure_pa: float
    temperature_degc: float
    receive_time_ns: int
    def __init__(self, pressure_pa: _Optional[float] = ..., temperature_degc: _Optional[float] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class Odometer(_message.Message):
    __slots__ = ("speed_mps", "distance_m", "ticks", "wheel", "receive_time_ns")
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    TICKS_FIELD_NUMBER: _ClassVar[int]
    WHEEL_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    speed_mps: float
    distance_m: float
    ticks: int
    wheel: str
    receive_time_ns: int
    def __init__(self, speed_mps: _Optional[float] = ..., distance_m: _Optional[float] = ..., ticks: _Optional[int] = ..., wheel: _Optional[str] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...
