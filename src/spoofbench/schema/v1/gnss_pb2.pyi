from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class FixType(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FIX_TYPE_UNSPECIFIED: _ClassVar[FixType]
    FIX_TYPE_NONE: _ClassVar[FixType]
    FIX_TYPE_DEAD_RECKONING: _ClassVar[FixType]
    FIX_TYPE_2D: _ClassVar[FixType]
    FIX_TYPE_3D: _ClassVar[FixType]
    FIX_TYPE_GNSS_DEAD_RECKONING: _ClassVar[FixType]
    FIX_TYPE_TIME_ONLY: _ClassVar[FixType]
    FIX_TYPE_DIFFERENTIAL: _ClassVar[FixType]
    FIX_TYPE_RTK_FLOAT: _ClassVar[FixType]
    FIX_TYPE_RTK_FIXED: _ClassVar[FixType]
    FIX_TYPE_PPP: _ClassVar[FixType]
    FIX_TYPE_SIMULATED: _ClassVar[FixType]

class Constellation(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CONSTELLATION_UNSPECIFIED: _ClassVar[Constellation]
    CONSTELLATION_GPS: _ClassVar[Constellation]
    CONSTELLATION_SBAS: _ClassVar[Constellation]
    CONSTELLATION_GALILEO: _ClassVar[Constellation]
    CONSTELLATION_BEIDOU: _ClassVar[Constellation]
    CONSTELLATION_IMES: _ClassVar[Constellation]
    CONSTELLATION_QZSS: _ClassVar[Constellation]
    CONSTELLATION_GLONASS: _ClassVar[Constellation]
    CONSTELLATION_NAVIC: _ClassVar[Constellation]

class SpoofingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SPOOFING_STATE_UNKNOWN: _ClassVar[SpoofingState]
    SPOOFING_STATE_NONE: _ClassVar[SpoofingState]
    SPOOFING_STATE_INDICATED: _ClassVar[SpoofingState]
    SPOOFING_STATE_CONFIRMED: _ClassVar[SpoofingState]

class JammingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    JAMMING_STATE_UNKNOWN: _ClassVar[JammingState]
    JAMMING_STATE_NONE: _ClassVar[JammingState]
    JAMMING_STATE_WARNING: _ClassVar[JammingState]
    JAMMING_STATE_CRITICAL: _ClassVar[JammingState]

class AuthenticationState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    AUTHENTICATION_STATE_UNKNOWN: _ClassVar[AuthenticationState]
    AUTHENTICATION_STATE_INITIALISING: _ClassVar[AuthenticationState]
    AUTHENTICATION_STATE_ERROR: _ClassVar[AuthenticationState]
    AUTHENTICATION_STATE_OK: _ClassVar[AuthenticationState]
    AUTHENTICATION_STATE_FAILED: _ClassVar[AuthenticationState]
FIX_TYPE_UNSPECIFIED: FixType
FIX_TYPE_NONE: FixType
FIX_TYPE_DEAD_RECKONING: FixType
FIX_TYPE_2D: FixType
FIX_TYPE_3D: FixType
FIX_TYPE_GNSS_DEAD_RECKONING: FixType
FIX_TYPE_TIME_ONLY: FixType
FIX_TYPE_DIFFERENTIAL: FixType
FIX_TYPE_RTK_FLOAT: FixType
FIX_TYPE_RTK_FIXED: FixType
FIX_TYPE_PPP: FixType
FIX_TYPE_SIMULATED: FixType
CONSTELLATION_UNSPECIFIED: Constellation
CONSTELLATION_GPS: Constellation
CONSTELLATION_SBAS: Constellation
CONSTELLATION_GALILEO: Constellation
CONSTELLATION_BEIDOU: Constellation
CONSTELLATION_IMES: Constellation
CONSTELLATION_QZSS: Constellation
CONSTELLATION_GLONASS: Constellation
CONSTELLATION_NAVIC: Constellation
SPOOFING_STATE_UNKNOWN: SpoofingState
SPOOFING_STATE_NONE: SpoofingState
SPOOFING_STATE_INDICATED: SpoofingState
SPOOFING_STATE_CONFIRMED: SpoofingState
JAMMING_STATE_UNKNOWN: JammingState
JAMMING_STATE_NONE: JammingState
JAMMING_STATE_WARNING: JammingState
JAMMING_STATE_CRITICAL: JammingState
AUTHENTICATION_STATE_UNKNOWN: AuthenticationState
AUTHENTICATION_STATE_INITIALISING: AuthenticationState
AUTHENTICATION_STATE_ERROR: AuthenticationState
AUTHENTICATION_STATE_OK: AuthenticationState
AUTHENTICATION_STATE_FAILED: AuthenticationState

class Pvt(_message.Message):
    __slots__ = ("lat_deg", "lon_deg", "height_m", "height_msl_m", "vel_n_mps", "vel_e_mps", "vel_d_mps", "speed_mps", "course_deg", "h_acc_m", "v_acc_m", "s_acc_mps", "fix_type", "num_sv", "receive_time_ns", "pdop", "gps_week", "tow_s", "time_valid", "cov_nn_m2", "cov_ne_m2", "cov_nd_m2", "cov_ee_m2", "cov_ed_m2", "cov_dd_m2", "cov_vel_nn_m2ps2", "cov_vel_ne_m2ps2", "cov_vel_nd_m2ps2", "cov_vel_ee_m2ps2", "cov_vel_ed_m2ps2", "cov_vel_dd_m2ps2", "hdop", "vdop", "diff_age_s", "time_acc_s")
    LAT_DEG_FIELD_NUMBER: _ClassVar[int]
    LON_DEG_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_MSL_M_FIELD_NUMBER: _ClassVar[int]
    VEL_N_MPS_FIELD_NUMBER: _ClassVar[int]
    VEL_E_MPS_FIELD_NUMBER: _ClassVar[int]
    VEL_D_MPS_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    COURSE_DEG_FIELD_NUMBER: _ClassVar[int]
    H_ACC_M_FIELD_NUMBER: _ClassVar[int]
    V_ACC_M_FIELD_NUMBER: _ClassVar[int]
    S_ACC_MPS_FIELD_NUMBER: _ClassVar[int]
    FIX_TYPE_FIELD_NUMBER: _ClassVar[int]
    NUM_SV_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    PDOP_FIELD_NUMBER: _ClassVar[int]
    GPS_WEEK_FIELD_NUMBER: _ClassVar[int]
    TOW_S_FIELD_NUMBER: _ClassVar[int]
    TIME_VALID_FIELD_NUMBER: _ClassVar[int]
    COV_NN_M2_FIELD_NUMBER: _ClassVar[int]
    COV_NE_M2_FIELD_NUMBER: _ClassVar[int]
    COV_ND_M2_FIELD_NUMBER: _ClassVar[int]
    COV_EE_M2_FIELD_NUMBER: _ClassVar[int]
    COV_ED_M2_FIELD_NUMBER: _ClassVar[int]
    COV_DD_M2_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_NN_M2PS2_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_NE_M2PS2_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_ND_M2PS2_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_EE_M2PS2_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_ED_M2PS2_FIELD_NUMBER: _ClassVar[int]
    COV_VEL_DD_M2PS2_FIELD_NUMBER: _ClassVar[int]
    HDOP_FIELD_NUMBER: _ClassVar[int]
    VDOP_FIELD_NUMBER: _ClassVar[int]
    DIFF_AGE_S_FIELD_NUMBER: _ClassVar[int]
    TIME_ACC_S_FIELD_NUMBER: _ClassVar[int]
    lat_deg: float
    lon_deg: float
    height_m: float
    height_msl_m: float
    vel_n_mps: float
    vel_e_mps: float
    vel_d_mps: float
    speed_mps: float
    course_deg: float
    h_acc_m: float
    v_acc_m: float
    s_acc_mps: float
    fix_type: FixType
    num_sv: int
    receive_time_ns: int
    pdop: float
    gps_week: int
    tow_s: float
    time_valid: bool
    cov_nn_m2: float
    cov_ne_m2: float
    cov_nd_m2: float
    cov_ee_m2: float
    cov_ed_m2: float
    cov_dd_m2: float
    cov_vel_nn_m2ps2: float
    cov_vel_ne_m2ps2: float
    cov_vel_nd_m2ps2: float
    cov_vel_ee_m2ps2: float
    cov_vel_ed_m2ps2: float
    cov_vel_dd_m2ps2: float
    hdop: float
    vdop: float
    diff_age_s: float
    time_acc_s: float
    def __init__(self, lat_deg: _Optional[float] = ..., lon_deg: _Optional[float] = ..., height_m: _Optional[float] = ..., height_msl_m: _Optional[float] = ..., vel_n_mps: _Optional[float] = ..., vel_e_mps: _Optional[float] = ..., vel_d_mps: _Optional[float] = ..., speed_mps: _Optional[float] = ..., course_deg: _Optional[float] = ..., h_acc_m: _Optional[float] = ..., v_acc_m: _Optional[float] = ..., s_acc_mps: _Optional[float] = ..., fix_type: _Optional[_Union[FixType, str]] = ..., num_sv: _Optional[int] = ..., receive_time_ns: _Optional[int] = ..., pdop: _Optional[float] = ..., gps_week: _Optional[int] = ..., tow_s: _Optional[float] = ..., time_valid: _Optional[bool] = ..., cov_nn_m2: _Optional[float] = ..., cov_ne_m2: _Optional[float] = ..., cov_nd_m2: _Optional[float] = ..., cov_ee_m2: _Optional[float] = ..., cov_ed_m2: _Optional[float] = ..., cov_dd_m2: _Optional[float] = ..., cov_vel_nn_m2ps2: _Optional[float] = ..., cov_vel_ne_m2ps2: _Optional[float] = ..., cov_vel_nd_m2ps2: _Optional[float] = ..., cov_vel_ee_m2ps2: _Optional[float] = ..., cov_vel_ed_m2ps2: _Optional[float] = ..., cov_vel_dd_m2ps2: _Optional[float] = ..., hdop: _Optional[float] = ..., vdop: _Optional[float] = ..., diff_age_s: _Optional[float] = ..., time_acc_s: _Optional[float] = ...) -> None: ...

class Signal(_message.Message):
    __slots__ = ("constellation", "svid", "signal", "cn0_dbhz", "elevation_deg", "azimuth_deg", "used", "residual_m", "receive_time_ns")
    CONSTELLATION_FIELD_NUMBER: _ClassVar[int]
    SVID_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_FIELD_NUMBER: _ClassVar[int]
    CN0_DBHZ_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_M_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    constellation: Constellation
    svid: int
    signal: str
    cn0_dbhz: float
    elevation_deg: float
    azimuth_deg: float
    used: bool
    residual_m: float
    receive_time_ns: int
    def __init__(self, constellation: _Optional[_Union[Constellation, str]] = ..., svid: _Optional[int] = ..., signal: _Optional[str] = ..., cn0_dbhz: _Optional[float] = ..., elevation_deg: _Optional[float] = ..., azimuth_deg: _Optional[float] = ..., used: _Optional[bool] = ..., residual_m: _Optional[float] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class Observation(_message.Message):
    __slots__ = ("constellation", "svid", "signal", "pseudorange_m", "carrier_cycles", "doppler_hz", "cn0_dbhz", "lock_time_s", "pseudorange_std_m", "carrier_std_cycles", "doppler_std_hz", "frequency_slot", "receive_time_ns")
    CONSTELLATION_FIELD_NUMBER: _ClassVar[int]
    SVID_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_FIELD_NUMBER: _ClassVar[int]
    PSEUDORANGE_M_FIELD_NUMBER: _ClassVar[int]
    CARRIER_CYCLES_FIELD_NUMBER: _ClassVar[int]
    DOPPLER_HZ_FIELD_NUMBER: _ClassVar[int]
    CN0_DBHZ_FIELD_NUMBER: _ClassVar[int]
    LOCK_TIME_S_FIELD_NUMBER: _ClassVar[int]
    PSEUDORANGE_STD_M_FIELD_NUMBER: _ClassVar[int]
    CARRIER_STD_CYCLES_FIELD_NUMBER: _ClassVar[int]
    DOPPLER_STD_HZ_FIELD_NUMBER: _ClassVar[int]
    FREQUENCY_SLOT_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    constellation: Constellation
    svid: int
    signal: str
    pseudorange_m: float
    carrier_cycles: float
    doppler_hz: float
    cn0_dbhz: float
    lock_time_s: float
    pseudorange_std_m: float
    carrier_std_cycles: float
    doppler_std_hz: float
    frequency_slot: int
    receive_time_ns: int
    def __init__(self, constellation: _Optional[_Union[Constellation, str]] = ..., svid: _Optional[int] = ..., signal: _Optional[str] = ..., pseudorange_m: _Optional[float] = ..., carrier_cycles: _Optional[float] = ..., doppler_hz: _Optional[float] = ..., cn0_dbhz: _Optional[float] = ..., lock_time_s: _Optional[float] = ..., pseudorange_std_m: _Optional[float] = ..., carrier_std_cycles: _Optional[float] = ..., doppler_std_hz: _Optional[float] = ..., frequency_slot: _Optional[int] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class Clock(_message.Message):
    __slots__ = ("bias_s", "drift_sps", "acc_s", "drift_acc_sps", "host_offset_s", "receive_time_ns")
    BIAS_S_FIELD_NUMBER: _ClassVar[int]
    DRIFT_SPS_FIELD_NUMBER: _ClassVar[int]
    ACC_S_FIELD_NUMBER: _ClassVar[int]
    DRIFT_ACC_SPS_FIELD_NUMBER: _ClassVar[int]
    HOST_OFFSET_S_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    bias_s: float
    drift_sps: float
    acc_s: float
    drift_acc_sps: float
    host_offset_s: float
    receive_time_ns: int
    def __init__(self, bias_s: _Optional[float] = ..., drift_sps: _Optional[float] = ..., acc_s: _Optional[float] = ..., drift_acc_sps: _Optional[float] = ..., host_offset_s: _Optional[float] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class Rf(_message.Message):
    __slots__ = ("band", "agc", "noise", "jam_indicator", "agc_db", "receive_time_ns")
    BAND_FIELD_NUMBER: _ClassVar[int]
    AGC_FIELD_NUMBER: _ClassVar[int]
    NOISE_FIELD_NUMBER: _ClassVar[int]
    JAM_INDICATOR_FIELD_NUMBER: _ClassVar[int]
    AGC_DB_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    band: str
    agc: float
    noise: float
    jam_indicator: float
    agc_db: float
    receive_time_ns: int
    def __init__(self, band: _Optional[str] = ..., agc: _Optional[float] = ..., noise: _Optional[float] = ..., jam_indicator: _Optional[float] = ..., agc_db: _Optional[float] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class NavData(_message.Message):
    __slots__ = ("constellation", "svid", "signal", "subframe", "receive_time_ns")
    CONSTELLATION_FIELD_NUMBER: _ClassVar[int]
    SVID_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_FIELD_NUMBER: _ClassVar[int]
    SUBFRAME_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    constellation: Constellation
    svid: int
    signal: str
    subframe: bytes
    receive_time_ns: int
    def __init__(self, constellation: _Optional[_Union[Constellation, str]] = ..., svid: _Optional[int] = ..., signal: _Optional[str] = ..., subframe: _Optional[bytes] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class Integrity(_message.Message):
    __slots__ = ("spoofing", "jamming", "authentication", "raw", "receive_time_ns")
    SPOOFING_FIELD_NUMBER: _ClassVar[int]
    JAMMING_FIELD_NUMBER: _ClassVar[int]
    AUTHENTICATION_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    spoofing: SpoofingState
    jamming: JammingState
    authentication: AuthenticationState
    raw: int
    receive_time_ns: int
    def __init__(self, spoofing: _Optional[_Union[SpoofingState, str]] = ..., jamming: _Optional[_Union[JammingState, str]] = ..., authentication: _Optional[_Union[AuthenticationState, str]] = ..., raw: _Optional[int] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...

class TimeMark(_message.Message):
    __slots__ = ("channel", "count", "rising_week", "rising_tow_s", "falling_week", "falling_tow_s", "acc_s", "time_base", "receive_time_ns")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    RISING_WEEK_FIELD_NUMBER: _ClassVar[int]
    RISING_TOW_S_FIELD_NUMBER: _ClassVar[int]
    FALLING_WEEK_FIELD_NUMBER: _ClassVar[int]
    FALLING_TOW_S_FIELD_NUMBER: _ClassVar[int]
    ACC_S_FIELD_NUMBER: _ClassVar[int]
    TIME_BASE_FIELD_NUMBER: _ClassVar[int]
    RECEIVE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    channel: int
    count: int
    rising_week: int
    rising_tow_s: float
    falling_week: int
    falling_tow_s: float
    acc_s: float
    time_base: str
    receive_time_ns: int
    def __init__(self, channel: _Optional[int] = ..., count: _Optional[int] = ..., rising_week: _Optional[int] = ..., rising_tow_s: _Optional[float] = ..., falling_week: _Optional[int] = ..., falling_tow_s: _Optional[float] = ..., acc_s: _Optional[float] = ..., time_base: _Optional[str] = ..., receive_time_ns: _Optional[int] = ...) -> None: ...
