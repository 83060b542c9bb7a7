"""The receiver's integrated solution: ``ins/pva`` rows of navigation epochs, and of those between
them (HNR).
"""

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.serial.contract import Rows
from spoofbench_converters.ubx.batch import NO_ACCURACY, Batch, Fields, Picked, scaled
from spoofbench_converters.ubx.claims import Claims
from spoofbench_converters.ubx.frames import Ints
from spoofbench_converters.ubx.gpstime import MS_NS
from spoofbench_converters.ubx.grouping import WEEK_MS
from spoofbench_converters.ubx.solution import llh

_RATE = np.pi / 180 * 1e-3
_NO_VALUE = "no value valid"


def rates(head: NDArray[np.void]) -> dict[str, NDArray[np.float64]]:
    """Return rates (deg/s to rad/s) and accelerations without gravity of UBX-ESF-INS and -HNR-INS,
    NaN where their flags are clear.
    """
    columns = {}
    for bit, (name, field, scale) in enumerate(
        (
            ("rate_x_radps", "xAngRate", _RATE), ("rate_y_radps", "yAngRate", _RATE),
            ("rate_z_radps", "zAngRate", _RATE),
            ("linear_accel_x_mps2", "xAccel", 1e-2), ("linear_accel_y_mps2", "yAccel", 1e-2),
            ("linear_accel_z_mps2", "zAccel", 1e-2),
        ), 8,
    ):  # fmt: skip
        columns[name] = np.where(head["flags"] >> bit & 1 > 0, head[field] * scale, np.nan)
    return columns


def angles(head: NDArray[np.void]) -> dict[str, NDArray[np.float64]]:
    """Return roll, pitch, heading of UBX-NAV-ATT and -HNR-ATT, and the largest of their accuracies;
    none where all accuracies read 0.
    """
    accuracy = np.max([head["accRoll"], head["accPitch"], head["accHeading"]], axis=0)
    unset = accuracy == 0
    columns = {
        "roll_deg": head["roll"],
        "pitch_deg": head["pitch"],
        "yaw_deg": head["heading"],
        "attitude_acc_deg": accuracy,
    }
    return {name: np.where(unset, np.nan, values * 1e-5) for name, values in columns.items()}


def navigation(batch: Batch, source: str) -> list[Rows]:
    """Return one row per epoch of NAV-ATT, ESF-INS, NAV-PVAT, and of NAV-PVT with a vehicle
    heading, where any value is valid.
    """
    fields = Fields(batch.count)
    picked = {name: batch.one_of(name) for name in ("NAV-ATT", "ESF-INS", "NAV-PVAT", "NAV-PVT")}
    fields.fill(picked["NAV-ATT"].epoch, **angles(picked["NAV-ATT"].head))
    fields.fill(picked["ESF-INS"].epoch, **rates(picked["ESF-INS"].head))
    _vehicle(fields, picked["NAV-PVAT"])
    pvt = picked["NAV-PVT"]
    fields.fill(
        pvt.epoch, yaw_deg=np.where(pvt.head["flags"] & 32 > 0, pvt.head["headVeh"] * 1e-5, np.nan)
    )
    told = np.zeros(batch.count, bool)
    for name in fields:
        told |= ~np.isnan(fields[name])
    for name in ("NAV-ATT", "ESF-INS"):
        valid = np.zeros(picked[name].frames.size, bool)
        for values in (angles if name == "NAV-ATT" else rates)(picked[name].head).values():
            valid |= ~np.isnan(values)
        batch.use(picked[name].frames[valid])
        batch.refuse(picked[name].frames[~valid], _NO_VALUE)
    if not told.any():
        return []
    return [
        Rows(source, "ins/pva", np.flatnonzero(told), {name: fields[name][told] for name in fields})
    ]


def _vehicle(fields: Fields, picked: Picked) -> None:
    """Take position, velocity and the valid angles of NAV-PVAT where it has a fix."""
    head, epoch = picked.head, picked.epoch
    flags = head["flags"]
    none = (flags & 1 == 0) | (head["fixType"] == 0)
    fields.fill_together(epoch, **llh(head, none))
    velocity = {
        f"vel_{axis.lower()}_mps": np.where(none, np.nan, head[f"vel{axis}"] * 1e-3)
        for axis in "NED"
    }
    fields.fill(epoch, **velocity)
    accuracy = {"h_acc_m": "hAcc", "v_acc_m": "vAcc", "s_acc_mps": "sAcc"}
    fields.fill(
        epoch,
        **{
            name: np.where(none, np.nan, scaled(head[field], 1e-3, NO_ACCURACY))
            for name, field in accuracy.items()
        },
    )
    largest = np.full(epoch.size, np.nan)
    for bit, name, field, spread in (
        (8, "roll_deg", "vehRoll", "accRoll"),
        (16, "pitch_deg", "vehPitch", "accPitch"),
        (32, "yaw_deg", "vehHeading", "accHeading"),
    ):
        valid = flags & bit > 0
        fields.fill(epoch, **{name: np.where(valid, head[field] * 1e-5, np.nan)})
        largest = np.fmax(largest, np.where(valid, head[spread] * 1e-2, np.nan))
    fields.fill(epoch, attitude_acc_deg=largest)


def high_rate(batch: Batch, claims: Claims, source: str) -> list[Rows]:
    """Return one row per instant of HNR-PVT, HNR-ATT and HNR-INS, where any value is valid.

    HNR-PVT has the speed over ground and no components of velocity, which the schema's row cannot
    hold.
    """
    picked = [batch.all_of(name) for name in ("HNR-PVT", "HNR-ATT", "HNR-INS")]
    epoch = np.concatenate([one.epoch for one in picked])
    if not epoch.size:
        return []
    time = np.concatenate([one.head["iTOW"] for one in picked]).astype(np.int64)
    frames = np.concatenate([one.frames for one in picked])
    instants, place = _instants(frames, epoch, time)
    fields = Fields(instants.size)
    valid = np.zeros(frames.size, bool)
    start = 0
    for one, read in zip(picked, (_high_rate_pvt, angles, rates), strict=True):
        mine = slice(start, start + one.frames.size)
        for name, values in read(one.head).items():
            fields.fill(place[mine], **{name: values})
            valid[mine] |= ~np.isnan(values)
        start += one.frames.size
    batch.use(frames[valid])
    for one in picked:
        batch.refuse(one.frames[~np.isin(one.frames, frames[valid])], _NO_VALUE)
    told = np.isin(np.arange(instants.size), place[valid])
    first = instants[told]
    after = (
        time[first] - np.maximum(claims.time_ms[epoch[first]], 0) + WEEK_MS // 2
    ) % WEEK_MS - WEEK_MS // 2
    columns = {name: fields[name][told] for name in fields}
    return [batch.rows(source, "ins/pva", frames[first], columns, offset_ns=after * MS_NS)]


def _instants(frames: Ints, epoch: Ints, time: Ints) -> tuple[Ints, Ints]:
    """Return the first frame of each instant within its epoch, in file order, and the instant of
    each frame.
    """
    order = np.argsort(frames, kind="stable")
    pairs = np.stack([epoch[order], time[order]])
    _, first, inverse = np.unique(pairs, axis=1, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    place = np.empty(frames.size, np.int64)
    place[order] = rank[inverse.ravel()]
    return order[np.sort(first)], place


def _high_rate_pvt(head: NDArray[np.void]) -> dict[str, NDArray[np.float64]]:
    none = (head["flags"] & 1 == 0) | (head["gpsFix"] == 0)
    columns = llh(head, none)
    for name, field in (("h_acc_m", "hAcc"), ("v_acc_m", "vAcc"), ("s_acc_mps", "sAcc")):
        columns[name] = np.where(none, np.nan, scaled(head[field], 1e-3, NO_ACCURACY))
    columns["yaw_deg"] = np.where(head["flags"] & 16 > 0, head["headVeh"] * 1e-5, np.nan)
    return columns
