"""Navigation solutions: one ``gnss/pvt`` row per epoch, from all messages that report it.

Where several messages report the same, the most exact comes first: NAV-HPPOSLLH, -PVT, -PVAT,
-POSLLH, then the earth-centred ones. NAV2 messages are the second solution of one receiver, without
inertial sensors.
"""

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Floats
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Column
from spoofbench_converters.serial.contract import EpochRows
from spoofbench_converters.ubx.batch import (
    NO_ACCURACY,
    NO_DOP,
    EpochBatch,
    EpochColumns,
    FieldColumns,
    MessageFrames,
    absent_where,
    scaled,
    whole,
)
from spoofbench_converters.ubx.times import EpochTimes

_SOLUTIONS = (
    "PVT",
    "PVAT",
    "HPPOSLLH",
    "POSLLH",
    "HPPOSECEF",
    "SOL",
    "POSECEF",
    "VELNED",
    "VELECEF",
)
_PRIMARY_ONLY = frozenset({"HPPOSLLH", "HPPOSECEF", "SOL"})
_FIX = np.array(
    [
        gnss_pb2.FIX_TYPE_NONE,
        gnss_pb2.FIX_TYPE_DEAD_RECKONING,
        gnss_pb2.FIX_TYPE_2D,
        gnss_pb2.FIX_TYPE_3D,
        gnss_pb2.FIX_TYPE_GNSS_DEAD_RECKONING,
        gnss_pb2.FIX_TYPE_TIME_ONLY,
    ],
    float,
)
_FUSED = (1, 4)  # u-blox's number of fixes with inertial sensors
_WHOLE = {"fix_type": "int32", "num_sv": "int64", "gps_week": "int64"}
_POSITION = ("lat_deg", "lon_deg", "height_m", "height_msl_m")
_VELOCITY = ("vel_n_mps", "vel_e_mps", "vel_d_mps")


def fix_type(
    fix: NDArray[np.integer],
    ok: Bools,
    differential: Bools,
    carrier: NDArray[np.integer],
) -> Floats:
    """Return the schema's ``FixType`` of u-blox's, as floats ``(n,)``, NaN where it is none of the
    described (UBX-NAV-PVT, fixType and flags).

    Args:
        fix: 0 none, 1 dead reckoning, 2 2D, 3 3D, 4 GNSS and dead reckoning, 5 time only.
        ok: within the limits of accuracy and dilution that the user set; what is not is no fix.
        differential: corrections were applied; reported of 3D fixes only, for others it is the
            lesser fact.
        carrier: carrier phase solution: 1 with floating ambiguities, 2 with fixed ones.
    """
    result = np.where(fix < _FIX.size, _FIX[np.minimum(fix, _FIX.size - 1)], np.nan)
    result[(fix == 3) & differential] = gnss_pb2.FIX_TYPE_DIFFERENTIAL
    satellites = (fix >= 2) & (fix <= 4)
    result[satellites & (carrier == 1)] = gnss_pb2.FIX_TYPE_RTK_FLOAT
    result[satellites & (carrier == 2)] = gnss_pb2.FIX_TYPE_RTK_FIXED
    result[~ok & ~np.isnan(result)] = gnss_pb2.FIX_TYPE_NONE
    return result


class Solutions:
    """Makes ``gnss/pvt`` rows; remembers whether inertial sensors had part in any."""

    def __init__(self) -> None:
        self.fused = False
        self.fixed = False

    def rows(
        self, batch: EpochBatch, times: EpochTimes, system: str, source: str
    ) -> list[EpochRows]:
        """Return the rows of the solutions of one system, ``NAV`` or ``NAV2``."""
        names = [name for name in _SOLUTIONS if system == "NAV" or name not in _PRIMARY_ONLY]
        frames = {name: batch.one_of(f"{system}-{name}") for name in names}
        reported = np.zeros(batch.count, bool)
        for one in frames.values():
            reported[one.epoch] = True
            batch.use(one.index)
        if not reported.any():
            return []
        fields = EpochColumns(batch.count)
        self._fix(fields, batch, system, frames)
        _geodetic(fields, frames)
        _earth_centred(fields, frames)
        _precision(fields, batch, system, frames)
        nowhere = fields["fix_type"] == gnss_pb2.FIX_TYPE_NONE
        for name in (*_POSITION, *_VELOCITY, "speed_mps", "course_deg"):
            fields[name][nowhere] = np.nan
        epochs = np.arange(batch.count)
        fields.fill(epochs, gps_week=times.week, tow_s=times.tow_s)
        columns: FieldColumns = {
            name: whole(fields[name][reported], _WHOLE[name])
            if name in _WHOLE
            else fields[name][reported]
            for name in fields
        }
        valid = times.time_valid[reported]
        columns["time_valid"] = Column(valid == 1, ~np.isnan(valid))
        return [EpochRows.of(source, "gnss/pvt", epochs[reported], columns)]

    def _fix(
        self, fields: EpochColumns, batch: EpochBatch, system: str, frames: dict[str, MessageFrames]
    ) -> None:
        for name in ("PVT", "PVAT"):
            head = frames[name].head
            flags = head["flags"]
            found = fix_type(head["fixType"], flags & 1 > 0, flags & 2 > 0, flags >> 6)
            fields.fill(frames[name].epoch, fix_type=found, num_sv=head["numSV"].astype(float))
            self.fused |= bool(np.any(np.isin(head["fixType"], _FUSED) & (flags & 1 > 0)))
        status = batch.one_of(f"{system}-STATUS")
        for one in (status, frames["SOL"]) if "SOL" in frames else (status,):
            flags, names = one.head["flags"], one.head.dtype.names or ()
            carrier = one.head["flags2"] >> 6 if "flags2" in names else np.zeros_like(flags)
            found = fix_type(one.head["gpsFix"], flags & 1 > 0, flags & 2 > 0, carrier)
            fields.fill(one.epoch, fix_type=found)
            self.fused |= bool(np.any(np.isin(one.head["gpsFix"], _FUSED) & (flags & 1 > 0)))
            if "numSV" in names:
                fields.fill(one.epoch, num_sv=one.head["numSV"].astype(float))
        self.fixed |= bool(np.any(fields["fix_type"] > gnss_pb2.FIX_TYPE_NONE))


def llh(head: NDArray[np.void], invalid: Bools) -> dict[str, Floats]:
    """Return position columns ``(n,)`` of the fields lon, lat (1e-7 deg), height, hMSL (mm), with
    their extra digits where the message has them; NaN where ``invalid``.
    """
    fine = "latHp" in (head.dtype.names or ())
    result = {}
    for name, field, unit, digits in (
        ("lat_deg", "lat", 1e7, 1e9), ("lon_deg", "lon", 1e7, 1e9),
        ("height_m", "height", 1e3, 1e4), ("height_msl_m", "hMSL", 1e3, 1e4)
    ):  # fmt: skip
        value = head[field].astype(np.float64)
        extra = round(digits / unit)
        exact = (value * extra + head[f"{field}Hp"]) / digits if fine else value / unit
        result[name] = absent_where(invalid, exact)
    return result


def _geodetic(fields: EpochColumns, frames: dict[str, MessageFrames]) -> None:
    for name in ("HPPOSLLH", "PVT", "PVAT", "POSLLH"):
        if name not in frames:
            continue
        epoch, head = frames[name].epoch, frames[name].head
        invalid = np.zeros(epoch.size, bool)
        if name == "HPPOSLLH":
            invalid = head["flags"] & 1 > 0
        elif name == "PVT":
            invalid = head["flags3"] & 1 > 0
        if name in ("HPPOSLLH", "POSLLH"):
            invalid = invalid | (head["hAcc"] == NO_ACCURACY)
        unit = 1e-4 if name == "HPPOSLLH" else 1e-3
        fields.fill_together(epoch, **llh(head, invalid))
        fields.fill(
            epoch,
            h_acc_m=scaled(head["hAcc"], unit, NO_ACCURACY),
            v_acc_m=scaled(head["vAcc"], unit, NO_ACCURACY),
        )
    for name, unit, course in (
        ("PVT", 1e-3, "headMot"),
        ("PVAT", 1e-3, "motHeading"),
        ("VELNED", 1e-2, "heading"),
    ):
        epoch, head = frames[name].epoch, frames[name].head
        north, east, down = (scaled(head[axis], unit) for axis in ("velN", "velE", "velD"))
        fields.fill_together(epoch, vel_n_mps=north, vel_e_mps=east, vel_d_mps=down)
        fields.fill(
            epoch, speed_mps=scaled(head["gSpeed"], unit), course_deg=head[course] / 1e5 % 360
        )
        fields.fill(epoch, s_acc_mps=scaled(head["sAcc"], unit, NO_ACCURACY))


def _earth_centred(fields: EpochColumns, frames: dict[str, MessageFrames]) -> None:
    """Take positions in cm and velocities in cm/s, earth-centred, where no message reports them
    otherwise.
    """
    for name in ("HPPOSECEF", "SOL", "POSECEF"):
        if name not in frames:
            continue
        epoch, head = frames[name].epoch, frames[name].head
        axes = np.stack([head[f"ecef{axis}"].astype(np.float64) for axis in "XYZ"]) * 1e-2
        invalid = ~axes.any(axis=0)
        if name == "HPPOSECEF":
            axes += np.stack([head[f"ecef{axis}Hp"].astype(np.float64) for axis in "XYZ"]) * 1e-4
            invalid |= head["flags"] & 1 > 0
        lacking = np.isnan(fields["lat_deg"][epoch]) & ~invalid
        if lacking.any():
            import pymap3d

            lat, lon, height = pymap3d.ecef2geodetic(*axes[:, lacking])
            fields.fill_together(epoch[lacking], lat_deg=lat, lon_deg=lon, height_m=height)
    for name in ("SOL", "VELECEF"):
        if name not in frames:
            continue
        epoch, head = frames[name].epoch, frames[name].head
        axes = np.stack([head[f"ecefV{axis}"].astype(np.float64) for axis in "XYZ"]) * 1e-2
        north, east, down = ned(axes, fields["lat_deg"][epoch], fields["lon_deg"][epoch])
        fields.fill_together(epoch, vel_n_mps=north, vel_e_mps=east, vel_d_mps=down)
        fields.fill(epoch, s_acc_mps=scaled(head["sAcc"], 1e-2, NO_ACCURACY))


def ned(velocity: Floats, lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, ...]:
    """Turn earth-centred velocities ``(3, n)`` into north, east and down at these places."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    x, y, z = velocity
    outward = np.cos(lon) * x + np.sin(lon) * y
    return (
        np.cos(lat) * z - np.sin(lat) * outward,
        np.cos(lon) * y - np.sin(lon) * x,
        -(np.cos(lat) * outward + np.sin(lat) * z),
    )


def _precision(
    fields: EpochColumns, batch: EpochBatch, system: str, frames: dict[str, MessageFrames]
) -> None:
    """Take dilutions, covariances and the accuracy of time."""
    dop = batch.one_of(f"{system}-DOP")
    for column, field in (("pdop", "pDOP"), ("hdop", "hDOP"), ("vdop", "vDOP")):
        fields.fill(dop.epoch, **{column: scaled(dop.head[field], 0.01, NO_DOP)})
    for one in [frames[name] for name in ("PVT", "SOL") if name in frames]:
        fields.fill(one.epoch, pdop=scaled(one.head["pDOP"], 0.01, NO_DOP))
    cov = batch.one_of(f"{system}-COV")
    for prefix, kind, unit in (("cov", "pos", "m2"), ("cov_vel", "vel", "m2ps2")):
        invalid = cov.head[f"{kind}CovValid"] == 0
        for axes in ("NN", "NE", "ND", "EE", "ED", "DD"):
            fields.fill(
                cov.epoch,
                **{
                    f"{prefix}_{axes.lower()}_{unit}": absent_where(
                        invalid, cov.head[f"{kind}Cov{axes}"]
                    )
                },
            )
    times = [
        frames["PVT"],
        frames["PVAT"],
        *(batch.one_of(f"{system}-{name}") for name in ("TIMEGPS", "TIMEUTC", "CLOCK")),
    ]
    for one in times:
        fields.fill(one.epoch, time_acc_s=scaled(one.head["tAcc"], 1e-9, NO_ACCURACY))
