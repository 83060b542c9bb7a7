from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Pva(_message.Message):
    __slots__ = ("lat_deg", "lon_deg", "height_m", "vel_n_mps", "vel_e_mps", "vel_d_mps", "roll_deg", "pitch_deg", "yaw_deg", "h_acc_m", "v_acc_m", "s_acc_mps", "attitude_acc_deg", "receive_time_ns", "linear_accel_x_mps2", "linear_accel_y_mps2", "linear_accel_z_mps2", "rate_x_radps", "rate_y_radps", "rate_z_radps", "height_msl_m")
    LAT_DEG_FIELD_NUMBER: _ClassVar[int]
    LON_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    VEL_N_MPS_FIELD_NUMBER: _ClassVar[int]
    VEL_E_MPS_FIELD_NUMBER: _ClassVar[int]
    VEL_D_MPS_FIELD_NUMBER: _ClassVar[int]
    ROLL_DEG_FIELD_NUMBER: _ClassVar[int]
    PITCH_DEG_FIELD_NUMBER: _ClassVar[int]
    YAW_DEG_FIELD_NUMBER: _ClassVar[int]
    H_ACC_M_FIELD_NUMBER: _ClassVar[int]
    V_ACC_M_FIELD_NUMBER: _ClassVar[int]
    S_ACC_MPS_FIELD_NUMBER: _ClassVar[int]
    ATTITUDE_ACC_DEG_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    LINEAR_ACCEL_X_MPS2_FIELD_NUMBER: _ClassVar[int]
    LINEAR_ACCEL_Y_MPS2_FIELD_NUMBER: _ClassVar[int]
    LINEAR_ACCEL_Z_MPS2_FIELD_NUMBER: _ClassVar[int]
    RATE_X_RADPS_FIELD_NUMBER: _ClassVar[int]
    RATE_Y_RADPS_FIELD_NUMBER: _ClassVar[int]
    RATE_Z_RADPS_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_MSL_M_FIELD_NUMBER: _ClassVar[int]
    lat_deg: float
    lon_deg: float
    height_m: float
    vel_n_mps: float
    vel_e_mps: float
    vel_d_mps: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    h_acc_m: float
    v_acc_m: float
    s_acc_mps: float
    attitude_acc_deg: float
    receive_time_ns: int
    linear_accel_x_mps2: float
    linear_accel_y_mps2: float
    linear_accel_z_mps2: float
    rate_x_radps: float
    rate_y_radps: float
    rate_z_radps: float
    height_msl_m: float
    def __init__(self, lat_deg: _Optional[float] = ..., lon_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., vel_n_mps: _Optional[float] = ..., vel_e_mps: _Optional[float] = ..., vel_d_mps: _Optional[float] = ..., roll_deg: _Optional[float] = ..., pitch_deg: _Optional[float] = ..., yaw_deg: _Optional[float] = ..., h_acc_m: _Optional[float] = ..., v_acc_m: _Optional[float] = ..., s_acc_mps: _Optional[float] = ..., attitude_acc_deg: _Optional[float] = ..., receive_time_ns: _Optional[int] = ..., linear_accel_x_mps2: _Optional[float] = ..., linear_accel_y_mps2: _Optional[float] = ..., linear_accel_z_mps2: _Optional[float] = ..., rate_x_radps: _Optional[float] = ..., rate_y_radps: _Optional[float] = ..., rate_z_radps: _Optional[float] = ..., height_msl_m: _Optional[float] = ...) -> None: ...
