"""What a class of vehicles can do, from published sources: each limit as a ratio that is 1 at it.

Unknown is NaN. The README has the sources in full.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from spoofbench.arrays import Floats

Vehicle = Literal["airliner", "car"]

GRAVITY_MPS2 = 9.80665
_KNOT_MPS = 1852 / 3600
_FOOT_M = 0.3048

# ICAO standard atmosphere (Doc 7488, equal to ISO 2533) below 20 km
_SEA_PRESSURE_PA = 101_325.0
_SEA_TEMPERATURE_K = 288.15
_LAPSE_KPM = 0.0065
_TROPOPAUSE_M, _HIGHEST_M = 11_000.0, 20_000.0
_GAS_JPKGK = 287.05287
_HEAT_RATIO = 1.4

# the lightest wing loading of an empty airliner and the highest limits of any in OpenAP
_EMPTY_WING_LOADING_KGPM2 = 12_110 / 51.2  # Embraer ERJ-145
_VMO_MPS, _MMO = 365 * _KNOT_MPS, 0.92  # Boeing 747-400
_LARGEST_CLEAN_LIFT = 1.8  # Roskam, Airplane Design I, Table 3.1: transport jets 1.2 to 1.8
_LOWEST_OVER_STALL = 1.3  # BADA user manual, 5.7: minimum speed coefficient
_STEEPEST_BANK_DEG = 45.0  # BADA user manual, 5.3: civil flight
_CLEAN_ABOVE_M = 20_000 * _FOOT_M  # flaps are certified up to there
_FASTEST_CLIMB_MPS = 10_000 * _FOOT_M / 60  # what TCAS II is built for

_CAR_TOP_SPEED_MPS = 240 / 3.6  # UN Regulation 30, tyres of the speed category V
_ROAD_FRICTION = 0.9  # UN Regulation 140: peak braking coefficient of a dry test surface
_STEEPEST_STREET = 0.348  # Baldwin Street, Dunedin


@dataclass(frozen=True, slots=True)
class VehicleLimits:
    """The envelope of a class of vehicles.

    Attributes:
        speed_excess: from speed over ground, m/s, and height, m: above 1 where it is too fast or
            too slow.
        acceleration_mps2: largest change of the level velocity.
        climb_mps: fastest climb or descent.
        hold_s: how long a violation has to last.
    """

    speed_excess: Callable[[Floats, Floats], Floats]
    acceleration_mps2: float
    climb_mps: float
    hold_s: float


def airliner_speed_excess(speed_mps: Floats, height_m: Floats) -> Floats:
    """Return the wind that a jet's speed over ground takes, over the ICAO standard wind, ``(n,)``.

    A tailwind is needed above the true airspeed of the operating limit (VMO, MMO), a headwind below
    the lowest airspeed without flaps, which is not asked for below 20,000 ft. It is 0 where no wind
    is needed.

    Args:
        speed_mps: over ground, ``(n,)``.
        height_m: pressure altitude, or height above the ellipsoid or mean sea level, ``(n,)``.
    """
    fastest, slowest = airspeed_limits_mps(height_m)
    too_slow = np.where(height_m > _CLEAN_ABOVE_M, slowest - speed_mps, 0.0)
    needed = np.maximum(np.maximum(speed_mps - fastest, too_slow), 0.0)
    return np.asarray(needed / standard_wind_mps(height_m))


def airspeed_limits_mps(height_m: Floats) -> tuple[Floats, Floats]:
    """Return the highest and the lowest true airspeed of jets without flaps, m/s, ``(n,)`` each."""
    temperature_k, pressure_pa = standard_atmosphere(height_m)
    sound_mps = np.sqrt(_HEAT_RATIO * _GAS_JPKGK * temperature_k)
    sea_sound_mps = np.sqrt(_HEAT_RATIO * _GAS_JPKGK * _SEA_TEMPERATURE_K)
    impact_pa = _SEA_PRESSURE_PA * ((1 + 0.2 * (_VMO_MPS / sea_sound_mps) ** 2) ** 3.5 - 1)
    mach = np.sqrt(5 * ((impact_pa / pressure_pa + 1) ** (2 / 7) - 1))
    density = pressure_pa / (_GAS_JPKGK * temperature_k)
    weight_pa = _EMPTY_WING_LOADING_KGPM2 * GRAVITY_MPS2
    stall_mps = np.sqrt(2 * weight_pa / (density * _LARGEST_CLEAN_LIFT))
    return np.minimum(mach, _MMO) * sound_mps, _LOWEST_OVER_STALL * stall_mps


def standard_atmosphere(height_m: Floats) -> tuple[Floats, Floats]:
    """Return temperature, K, and pressure, Pa, of the standard atmosphere, ``(n,)`` each."""
    height = np.clip(height_m, -1000.0, _HIGHEST_M)
    temperature_k = _SEA_TEMPERATURE_K - _LAPSE_KPM * np.minimum(height, _TROPOPAUSE_M)
    exponent = GRAVITY_MPS2 / (_LAPSE_KPM * _GAS_JPKGK)
    pressure_pa = _SEA_PRESSURE_PA * (temperature_k / _SEA_TEMPERATURE_K) ** exponent
    above_m = np.maximum(height - _TROPOPAUSE_M, 0.0)
    return temperature_k, pressure_pa * np.exp(
        -GRAVITY_MPS2 * above_m / (_GAS_JPKGK * temperature_k)
    )


def standard_wind_mps(height_m: Floats) -> Floats:
    """Return the ICAO standard wind, m/s, ``(n,)``: 2 h + 47 knots, h in thousands of feet."""
    thousands_ft = np.clip(height_m, 0.0, _HIGHEST_M) / _FOOT_M / 1000
    return np.asarray((2 * thousands_ft + 47) * _KNOT_MPS)


def car_speed_excess(speed_mps: Floats, height_m: Floats) -> Floats:
    """Return a car's speed over its top speed, at any height, ``(n,)``."""
    del height_m
    return speed_mps / _CAR_TOP_SPEED_MPS


LIMITS: Mapping[Vehicle, VehicleLimits] = {
    "airliner": VehicleLimits(
        airliner_speed_excess,
        acceleration_mps2=GRAVITY_MPS2 * np.tan(np.radians(_STEEPEST_BANK_DEG)),
        climb_mps=_FASTEST_CLIMB_MPS,
        hold_s=15.0,
    ),
    "car": VehicleLimits(
        car_speed_excess,
        acceleration_mps2=GRAVITY_MPS2 * _ROAD_FRICTION,
        climb_mps=_CAR_TOP_SPEED_MPS * _STEEPEST_STREET,
        hold_s=0.0,
    ),
}
