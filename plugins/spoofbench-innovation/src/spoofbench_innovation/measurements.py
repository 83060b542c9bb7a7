"""What a receiver measured, as the filter takes it: position and velocity in metres, NED, with
variances.
"""

from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Floats, Times
from spoofbench.navigation.gnss import lacks_fix, travelled_ned, velocity_ned
from spoofbench.table import Table

_LARGEST = 1e9  # metres, metres per second or degrees, beyond what any receiver measures


@dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """Epochs of distinct times.

    Attributes:
        time_ns: ``(m,)``.
        values: position about the first one known, m, and velocity, m/s, NED, ``(m, 6)``; NaN where
            there is none. The two horizontal components of either are there together or not at all.
        variances: of the values, ``(m, 6)``; equal in north and east.
        lat_rad, height_m: of the epochs, ``(m,)``; NaN where unknown.
    """

    time_ns: Times
    values: Floats
    variances: Floats
    lat_rad: Floats
    height_m: Floats


def measurements(
    pvt: Table, floor: tuple[float, float, float, float], reported: bool
) -> Measurements:
    """Return the epochs of a receiver.

    Velocity comes from speed and course where there is no vector; down is then not measured. Where
    the first height is not above the ellipsoid, that above mean sea level takes its place. Epochs
    without a fix, and those whose position or velocity is the receiver's own dead reckoning,
    measure nothing; nor do values beyond 1e9.

    Args:
        pvt: rows of kind ``gnss/pvt``; of several at one time the last counts.
        floor: standard deviations per axis of position, horizontal and vertical, m, and of
            velocity, likewise, m/s.
        reported: whether the receiver's own accuracy, where it has one and it is worse, takes the
            floor's place.
    """
    pvt = pvt.last_per_time()
    refused = lacks_fix(pvt)
    first = (
        np.argmax(pvt.valid("height_m") | pvt.valid("height_msl_m")) if len(pvt) else 0
    )  # later rows must not decide
    height = "height_m" if pvt.valid("height_m")[first : first + 1].any() else "height_msl_m"
    lat_deg, lon_deg, height_m = (
        np.where(refused | ~(np.abs(pvt[name]) < _LARGEST), np.nan, pvt[name])
        for name in ("lat_deg", "lon_deg", height)
    )
    position = travelled_ned(lat_deg, lon_deg, height_m)
    values = np.concatenate([position, velocity_ned(pvt)], axis=1)
    values[refused] = np.nan
    values[~(np.abs(values) < _LARGEST)] = np.nan
    for pair in (slice(0, 2), slice(3, 5)):
        values[np.isnan(values[:, pair]).any(axis=1), pair] = np.nan
    deviations = np.tile(np.array(floor), (len(pvt), 1))
    if reported:
        deviations = np.fmin(np.fmax(deviations, _reported(pvt)), _LARGEST)
    return Measurements(
        pvt.time_ns, values, deviations[:, [0, 0, 1, 2, 2, 3]] ** 2, np.radians(lat_deg), height_m
    )


def _reported(pvt: Table) -> Floats:
    """Return the receiver's own standard deviations per axis, ``(m, 4)``, from covariances or else
    from its accuracies.
    """
    horizontal, vertical, speed = (
        pvt["h_acc_m"] / np.sqrt(2),
        pvt["v_acc_m"],
        pvt["s_acc_mps"] / np.sqrt(3),
    )
    with np.errstate(invalid="ignore"):
        spread = [
            np.sqrt(
                np.stack(
                    [
                        (pvt[f"cov_{part}nn_{unit}"] + pvt[f"cov_{part}ee_{unit}"]) / 2,
                        pvt[f"cov_{part}dd_{unit}"],
                    ]
                )
            )
            for part, unit in (("", "m2"), ("vel_", "m2ps2"))
        ]
    stated = np.stack([horizontal, vertical, speed, speed])
    return np.where(np.isnan(covariances := np.concatenate(spread)), stated, covariances).T
