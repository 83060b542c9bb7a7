"""Recordings of a drive that never existed, for tests of detectors, attacks and everything that
reads recordings.

They are realistic where it matters: the sensors see one motion, epochs jitter, rows are missing,
one epoch has no fix, and every kind of the schema is there. The same arguments give the same rows.
"""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.recording import Recording
from spoofbench.schema import SCHEMA_VERSION
from spoofbench.table import Table
from spoofbench.testing.motion import Floats, VehicleMotion, make_motion

START_NS = 1_700_000_000_000_000_000
_SATELLITES = 8
_FIX_NONE, _FIX_3D, _CONSTELLATION_GPS = 1, 4, 1


def drive(
    seed: int = 0,
    duration_s: float = 240.0,
    gnss_hz: float = 1.0,
    *,
    flaws: bool = True,
    second_sources: bool = False,
    lag_s: float = 0.0,
) -> Recording:
    """Return a car drive with turns, hills and stops, of which ``imu0`` and ``gnss0`` are the
    primary sources.

    The IMU (100 Hz, axes forward-right-down, specific force and angular rate averaged over 10 ms)
    has bias and noise; the receiver's velocity has white noise of 2 cm/s, its position wanders by a
    metre.

    Args:
        seed: of the motion and all noise.
        duration_s: 60 s or more give turns and stops.
        gnss_hz: epochs of the receiver per second.
        flaws: whether epochs jitter, rows are missing (8 s of GNSS, 1.5 s of IMU) and one epoch has
            no fix.
        second_sources: whether a second receiver ``gnss1`` and IMU ``imu1`` ride along.
        lag_s: how late the stamps of ``gnss0`` are against the IMU's.
    """
    rng = np.random.default_rng(seed)
    motion = make_motion(rng, duration_s)
    tables = {"/imu0/imu": _imu(rng, motion, flaws)}
    epochs = _epochs(rng, duration_s, gnss_hz, flaws)
    receiver = _receiver(rng, "gnss0", motion, epochs, flaws)
    tables |= {topic: _late(table, lag_s) for topic, table in receiver.items()}
    tables |= _aiding(rng, motion)
    sources = {"source/imu0": {"axes": "frd"}, "source/gnss0": {"solution": "gnss"}}
    if second_sources:
        tables |= {"/imu1/imu": _imu(rng, motion, flaws)}
        tables |= _receiver(rng, "gnss1", motion, _epochs(rng, duration_s, 5.0, flaws), flaws)
        sources |= {"source/imu1": {"axes": "frd"}, "source/gnss1": {"solution": "gnss"}}
    primary = {
        topic.split("/", 2)[2]: topic.split("/")[1]
        for topic in tables
        if topic.split("/")[1] in ("imu0", "gnss0", "car0")
    }
    tables["/reference/pva"] = _pva("reference/pva", motion, np.arange(0, motion.time_s.size, 10))
    about = {"schema_version": SCHEMA_VERSION, "clock": "sensor", "session_id": f"drive-{seed}"}
    metadata = {
        "recording": about,
        "primary": primary,
        "origin": {"file": f"drive-{seed}.log"},
        **sources,
    }
    return Recording(tables, metadata)


def spoofed_drive(seed: int = 0, duration_s: float = 240.0, gnss_hz: float = 1.0) -> Recording:
    """Return a drive whose receiver repeats what it saw 15 s before, from the middle on, with its
    truth row.
    """
    clean = drive(seed, duration_s, gnss_hz)
    table = clean["/gnss0/gnss/pvt"]
    times = table.time_ns
    donor = np.searchsorted(times, times - 15_000_000_000)
    start = START_NS + int(duration_s / 2 * 1e9)
    rows = np.where(times >= start, donor, np.arange(times.size))
    copied = {
        name: table[name][rows]
        for name in ("lat_deg", "lon_deg", "height_m", "vel_n_mps", "vel_e_mps", "vel_d_mps")
    }
    truth: dict[str, Any] = {
        "start_ns": [start],
        "end_ns": [int(times[-1]) + 1],
        "attack": ["repeat-back"],
        "sources": [json.dumps(["gnss0"])],
    }
    return clean.replace(
        {
            "/gnss0/gnss/pvt": table.replace(**copied),
            "/truth/attack": Table("truth/attack", np.array([start], np.int64), truth),
        }
    )


def _at(time_s: Floats) -> NDArray[np.int64]:
    return START_NS + np.round(time_s * 1e9).astype(np.int64)


def _late(table: Table, lag_s: float) -> Table:
    columns = {name: table.column(name) for name in table}
    return Table(table.kind.name, table.time_ns + round(lag_s * 1e9), columns)


def _epochs(rng: np.random.Generator, duration_s: float, rate_hz: float, flaws: bool) -> Floats:
    time_s = np.arange(1, int(duration_s * rate_hz)) / rate_hz
    if not flaws:
        return time_s
    gap_s = 0.4 * duration_s
    time_s = time_s[(time_s < gap_s) | (time_s >= gap_s + 8)]
    return time_s + rng.uniform(-2e-3, 2e-3, time_s.size)


def _imu(rng: np.random.Generator, motion: VehicleMotion, flaws: bool) -> Table:
    time_s = motion.time_s[1:]
    moving = np.linalg.norm(motion.velocity_mps[1:], axis=1, keepdims=True)
    force = (
        motion.specific_force_mps2[1:]
        + rng.normal(0, 0.02, 3)
        + rng.normal(0, 0.03, (time_s.size, 3)) * (1 + moving / 10)
    )
    rate = (
        motion.angular_rate_radps[1:]
        + rng.normal(0, 5e-4, 3)
        + rng.normal(0, 2e-3, (time_s.size, 3))
    )
    kept = np.ones(time_s.size, bool)
    if flaws:
        gap_s = 0.7 * time_s[-1]
        kept = (time_s < gap_s) | (time_s >= gap_s + 1.5)
        time_s = time_s + rng.uniform(-2e-4, 2e-4, time_s.size)
    columns = {f"accel_{axis}_mps2": force[kept, i] for i, axis in enumerate("xyz")}
    columns |= {f"gyro_{axis}_radps": rate[kept, i] for i, axis in enumerate("xyz")}
    return Table("imu", _at(time_s[kept]), {**columns, "interval_s": np.full(kept.sum(), 0.01)})


def _receiver(
    rng: np.random.Generator, source: str, motion: VehicleMotion, time_s: Floats, flaws: bool
) -> dict[str, Table]:
    n, time_ns = time_s.size, _at(time_s)
    fix = np.full(n, _FIX_3D)
    fix[n // 3 : n // 3 + flaws] = _FIX_NONE
    velocity = _interpolate(time_s, motion, motion.velocity_mps) + rng.normal(0, 0.02, (n, 3))
    position = _interpolate(time_s, motion, motion.position) + _wander(rng, n) * [9e-6, 1.2e-5, 1.0]
    velocity[fix == _FIX_NONE] = position[fix == _FIX_NONE] = np.nan
    pvt = {
        "lat_deg": np.round(position[:, 0], 9),
        "lon_deg": np.round(position[:, 1], 9),
        "height_m": np.round(position[:, 2], 3),
        "vel_n_mps": np.round(velocity[:, 0], 3),
        "vel_e_mps": np.round(velocity[:, 1], 3),
        "vel_d_mps": np.round(velocity[:, 2], 3),
        "h_acc_m": np.full(n, 1.2),
        "v_acc_m": np.full(n, 1.8),
        "s_acc_mps": np.full(n, 0.05),
        "fix_type": fix,
        "num_sv": np.full(n, _SATELLITES),
        "gps_week": np.full(n, 2288),
        "tow_s": np.round(time_s + 259_200, 3),
        "time_valid": np.ones(n, bool),
    }
    each = np.repeat(np.arange(n), _SATELLITES)
    signal: dict[str, Any] = {
        "constellation": np.full(each.size, _CONSTELLATION_GPS),
        "svid": np.tile(np.arange(1, _SATELLITES + 1), n),
    }
    signal |= {
        "signal": ["1C"] * each.size,
        "cn0_dbhz": np.round(rng.normal(42, 1.5, each.size), 1),
    }
    ranges = 2.2e7 + 1e6 * np.tile(np.arange(_SATELLITES), n) + 300 * np.sin(time_s[each] / 600)
    observed = {
        "pseudorange_m": ranges + rng.normal(0, 0.5, each.size),
        "carrier_cycles": ranges / 0.19029,
        "doppler_hz": ranges * 0,
    }
    tables = {
        "gnss/pvt": Table("gnss/pvt", time_ns, pvt),
        "gnss/signal": Table(
            "gnss/signal", time_ns[each], {**signal, "used": np.ones(each.size, bool)}
        ),
        "gnss/observation": Table("gnss/observation", time_ns[each], {**signal, **observed}),
        "gnss/clock": Table(
            "gnss/clock", time_ns, {"bias_s": 1e-4 + 1e-7 * time_s, "drift_sps": np.full(n, 1e-7)}
        ),
        "gnss/rf": Table(
            "gnss/rf",
            time_ns,
            {"band": ["L1"] * n, "agc": rng.normal(0.5, 0.01, n), "noise": rng.normal(90, 2, n)},
        ),
        "gnss/navdata": Table(
            "gnss/navdata",
            time_ns[::6],
            {"svid": np.ones(n, int)[::6], "subframe": [bytes(40)] * len(time_ns[::6])},
        ),
        "gnss/integrity": Table(
            "gnss/integrity", time_ns, {"spoofing": np.ones(n, int), "jamming": np.ones(n, int)}
        ),
        "gnss/timemark": Table(
            "gnss/timemark",
            time_ns[::10],
            {"channel": np.zeros(n, int)[::10], "rising_tow_s": pvt["tow_s"][::10]},
        ),
        "ins/pva": _pva(
            "ins/pva",
            motion,
            np.clip(np.round(time_s * 100).astype(int), 0, motion.time_s.size - 1),
        ),
    }
    return {f"/{source}/{kind}": table for kind, table in tables.items()}


def _aiding(rng: np.random.Generator, motion: VehicleMotion) -> dict[str, Table]:
    rows = np.arange(10, motion.time_s.size, 10)
    time_ns, yaw = _at(motion.time_s[rows]), motion.attitude_rad[rows, 2]
    field = {
        "field_x_ut": 20 * np.cos(yaw),
        "field_y_ut": -20 * np.sin(yaw),
        "field_z_ut": np.full(rows.size, 43.0),
    }
    pressure = 101_325 - 12.0 * motion.position[rows, 2] + rng.normal(0, 3, rows.size)
    speed = np.linalg.norm(motion.velocity_mps[rows], axis=1)
    return {
        "/car0/mag": Table("mag", time_ns, field),
        "/car0/baro": Table("baro", time_ns, {"pressure_pa": pressure}),
        "/car0/odometer": Table("odometer", time_ns, {"speed_mps": np.round(speed * 1.01, 2)}),
    }


def _pva(kind: str, motion: VehicleMotion, rows: NDArray[np.intp]) -> Table:
    names = (
        "lat_deg",
        "lon_deg",
        "height_m",
        "vel_n_mps",
        "vel_e_mps",
        "vel_d_mps",
        "roll_deg",
        "pitch_deg",
        "yaw_deg",
    )
    values = np.column_stack(
        [motion.position[rows], motion.velocity_mps[rows], np.degrees(motion.attitude_rad[rows])]
    )
    return Table(kind, _at(motion.time_s[rows]), dict(zip(names, values.T, strict=True)))


def _interpolate(time_s: Floats, motion: VehicleMotion, values: Floats) -> Floats:
    return np.column_stack([np.interp(time_s, motion.time_s, column) for column in values.T])


def _wander(rng: np.random.Generator, n: int) -> Floats:
    """First-order Gauss-Markov noise of unit standard deviation, ``(n, 3)``."""
    steps, noise = rng.normal(0, 1, (n, 3)), np.zeros((n, 3))
    for row in range(1, n):
        noise[row] = 0.99 * noise[row - 1] + np.sqrt(1 - 0.99**2) * steps[row]
    return noise
