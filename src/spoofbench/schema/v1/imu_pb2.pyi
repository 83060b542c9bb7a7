from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Imu(_message.Message):
    __slots__ = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "gyro_x_radps", "gyro_y_radps", "gyro_z_radps", "interval_s", "temperature_degc", "linear_accel_x_mps2", "linear_accel_y_mps2", "linear_accel_z_mps2", "receive_time_ns")
    ACCEL_X_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Y_MPS2_FIELD_NUMBER: _ClassVar[int]
    ACCEL_Z_MPS2_FIELD_NUMBER: _ClassVar[int]
    GYRO_X_RADPS_FIELD_NUMBER: _ClassVar[int]
    GYRO_Y_RADPS_FIELD_NUMBER: _ClassVar[int]
    GYRO_Z_RADPS_FIELD_NUMBER: _ClassVar[int]
    INTERVAL_S_FIELD_NUMBER: _ClassVar[int]
    TEMPERATURE_DEGC_FIELD_NUMBER: _ClassVar[int]
    LINEAR_ACCEL_X_MPS2_FIELD_NUMBER: _ClassVar[int]
    LINEAR_ACCEL_Y_MPS2_FIELD_NUMBER: _ClassVar[int]
    LINEAR_ACCEL_Z_MPS2_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    accel_x_mps2: float
    accel_y_mps2: float
    accel_z_mps2: float
    gyro_x_radps: float
    gyro_y_radps: float
    gyro_z_radps: float
    interval_s: float
    temperature_degc: float
    linear_accel_x_mps2: float
    linear_accel_y_mps2: float
    linear_accel_z_mps2: float
    receive_time_ns: int
    def __init__(self, accel_x_mps2: _Optional[float] = ..., accel_y_mps2: _Optional[float] = ..., accel_z_mps2: _Optional[float] = ..., gyro_x_radps: _Optional[float] = ..., gyro_y_radps: _Optional[float] = ..., gyro_z_radps: _Optional[float] = ..., interval_s: _Optional[float] = ..., temperature_degc: _Optional[float] = ..., linear_accel_x_mps2: _Optional[float] = ..., linear_accel_y_mps2: _Optional[float] = ..., linear_accel_z_mps2: _Optional[float] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...
