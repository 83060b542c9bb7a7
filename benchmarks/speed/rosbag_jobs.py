"""A ROS 2 bag in SQLite to columns and to MCAP, against rosbags, and against it with
mcap-protobuf-support.

The bag is a part of the real drive, so that the peers' rounds stay short; both sides do the same
part. It is in the page cache. Peers read a message at a time, as their interfaces have it, and keep
the fields that we keep; to MCAP they write the same rows, zstd 3. Our conversion to MCAP digests
the bag and keeps its ledger besides.
"""

import math
import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from mcap_protobuf.writer import Writer as PairWriter
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from spoofbench_converters import rosbag
from spoofbench_converters.rosbag import aspn23

from benchmarks.speed.frame import Job
from spoofbench.codec import read
from spoofbench.conversion import Block, Source, convert
from spoofbench.schema.v1.gnss_pb2 import Pvt
from spoofbench.schema.v1.imu_pb2 import Imu
from spoofbench.schema.v1.ins_pb2 import Pva

MESSAGES = 200_000
IMU, POSITION, VELOCITY, PVA = "/imu0/imu", "position", "velocity", "/reference/pva"
PVT = "/gnss0/gnss/pvt"

Rows = dict[str, list[tuple[Any, ...]]]
Columns = dict[str, np.ndarray[Any, Any]]

_STORE = get_typestore(Stores.EMPTY)
_STORE.register(
    {
        name: (list(constants), list(fields))
        for name, (constants, fields) in aspn23.definitions().items()
    }
)
_COVARIANCE = (0, 1, 2, 4, 5, 8)


def jobs(folder: Path) -> Iterator[Job]:
    """Yield the rosbag jobs, none where the drive is not installed."""
    spec = find_spec("pntos_cobra_datasets_ros")
    if spec is None or not spec.submodule_search_locations:
        print(
            "rosbag2: the package pntos-cobra-datasets-ros is not installed; its jobs are left out"
        )
        return
    bag = _part(
        Path(spec.submodule_search_locations[0]) / "cobra_gps_ins_example_data", folder / "part"
    )
    what = f"{MESSAGES:,} messages of the real drive"
    yield Job(
        "rosbag2-to-columns",
        f"{what}, to columns",
        partial(_our_columns, bag),
        {"rosbags": partial(_peer_columns, bag)},
        (),
        _same,
    )
    ours, theirs = (
        partial(_our_file, bag, folder / "ours.mcap"),
        partial(_peer_file, bag, folder / "theirs.mcap"),
    )
    yield Job(
        "rosbag2-to-mcap",
        f"{what}, to a closed file, zstd 3",
        ours,
        {"rosbags": theirs},
        (),
        _same_files,
    )


def _part(bag: Path, folder: Path) -> Path:
    """Return a bag of the first messages of a bag."""
    folder.mkdir()
    name = next(bag.glob("*.db3")).name
    with closing(sqlite3.connect(folder / name)) as part:
        part.execute("ATTACH ? AS whole", (f"file:{bag / name}?mode=ro",))
        for (schema,) in part.execute(
            "SELECT sql FROM whole.sqlite_master WHERE sql IS NOT NULL"
        ).fetchall():
            part.execute(schema)
        part.execute("INSERT INTO topics SELECT * FROM whole.topics")
        part.execute("INSERT INTO messages SELECT * FROM whole.messages WHERE id <= ?", (MESSAGES,))
        part.commit()
    whole = next(
        line.split(":")[1].strip()
        for line in (bag / "metadata.yaml").read_text().splitlines()
        if "  message_count:" in line[:17]
    )
    (folder / "metadata.yaml").write_text(
        (bag / "metadata.yaml").read_text().replace(whole, str(MESSAGES))
    )
    return folder


def _our_columns(bag: Path) -> Columns:
    parts: dict[str, list[np.ndarray[Any, Any]]] = defaultdict(list)
    for item in rosbag.convert(Source(bag, b""), rosbag.Options()):
        if isinstance(item, Block):
            for name, values in {"time_ns": item.table.time_ns, **item.table}.items():
                parts[f"{item.topic} {name}"].append(values)
    return {name: np.concatenate(values) for name, values in parts.items()}


def _rows(bag: Path) -> Rows:
    """Read by rosbags: per kind of message the fields that we keep, units as they are."""
    rows: Rows = {IMU: [], POSITION: [], VELOCITY: [], PVA: []}
    kinds = {aspn23.IMU: IMU, aspn23.POSITION: POSITION, aspn23.VELOCITY: VELOCITY, aspn23.PVA: PVA}
    with Reader(bag) as reader:
        for connection, stamp, raw in reader.messages():
            message: Any = _STORE.deserialize_cdr(raw, connection.msgtype)
            head, kind = (message.time_of_validity.elapsed_nsec, stamp), kinds[connection.msgtype]
            if kind == IMU:
                rows[kind].append((*head, *message.meas_accel, *message.meas_gyro))
            elif kind == PVA:
                place = (message.p1, message.p2, message.p3, message.v1, message.v2, message.v3)
                rows[kind].append((*head, *place, *message.quaternion))
            else:
                terms = (
                    (message.term1, message.term2, message.term3)
                    if kind == POSITION
                    else (message.x, message.y, message.z)
                )
                rows[kind].append((*head, *terms, *(message.covariance[i] for i in _COVARIANCE)))
    return rows


def _peer_columns(bag: Path) -> Columns:
    return {
        f"{kind} {i}": np.array(column)
        for kind, rows in _rows(bag).items()
        for i, column in enumerate(zip(*rows, strict=True))
    }


def _our_file(bag: Path, path: Path) -> Path:
    convert(bag, path)
    return path


def _peer_file(bag: Path, path: Path) -> Path:
    rows = _rows(bag)
    velocities = {row[0]: row for row in rows[VELOCITY]}
    with path.open("wb") as stream, PairWriter(stream) as writer:
        for row in rows[IMU]:
            writer.write_message(IMU, _imu(*row), row[0], row[0])
        for row in rows[POSITION]:
            writer.write_message(PVT, _pvt(row, velocities[row[0]]), row[0], row[0])
        for row in rows[PVA]:
            writer.write_message(PVA, _pva(*row), row[0], row[0])
    return path


def _imu(_: int, stamp: int, *increments: float) -> Imu:
    names = (
        "accel_x_mps2",
        "accel_y_mps2",
        "accel_z_mps2",
        "gyro_x_radps",
        "gyro_y_radps",
        "gyro_z_radps",
    )
    rates = {name: value / 0.01 for name, value in zip(names, increments, strict=True)}
    return Imu(receive_time_ns=stamp, interval_s=0.01, **rates)


def _pvt(position: tuple[Any, ...], velocity: tuple[Any, ...]) -> Pvt:
    _, stamp, lat, lon, height, *covariance = position
    _, received, north, east, down, *spread = velocity
    axes = ("nn", "ne", "nd", "ee", "ed", "dd")
    fields: dict[str, Any] = {
        f"cov_{a}_m2": value for a, value in zip(axes, covariance, strict=True)
    }
    fields |= {f"cov_vel_{a}_m2ps2": value for a, value in zip(axes, spread, strict=True)}
    fields |= {"lat_deg": math.degrees(lat), "lon_deg": math.degrees(lon), "height_m": height}
    return Pvt(
        receive_time_ns=max(stamp, received),
        vel_n_mps=north,
        vel_e_mps=east,
        vel_d_mps=down,
        **fields,
    )


def _pva(_: int, stamp: int, *values: float) -> Pva:
    lat, lon, height, north, east, down, *quaternion = values
    roll, pitch, yaw = _angles(*quaternion)
    place = {"lat_deg": math.degrees(lat), "lon_deg": math.degrees(lon), "height_m": height}
    turn = {"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw}
    return Pva(
        receive_time_ns=stamp, vel_n_mps=north, vel_e_mps=east, vel_d_mps=down, **place, **turn
    )


def _angles(a: float, c: float, b: float, d: float) -> tuple[float, float, float]:
    """Return roll, pitch, yaw in degrees; the quaternion is of right-forward-up against ENU."""
    d = -d
    roll = math.atan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    yaw = math.atan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    return math.degrees(roll), math.degrees(math.asin(2 * (a * c - b * d))), math.degrees(yaw) % 360


def _same(ours: Columns, theirs: Columns) -> None:
    pairs = {
        f"{IMU} accel_z_mps2": theirs[f"{IMU} 4"] / 0.01,
        f"{IMU} time_ns": theirs[f"{IMU} 0"],
        f"{PVA} vel_d_mps": theirs[f"{PVA} 7"],
    }
    pairs |= {
        f"{PVT} height_m": theirs[f"{POSITION} 4"],
        f"{PVT} cov_vel_dd_m2ps2": theirs[f"{VELOCITY} 10"],
    }
    for name, values in pairs.items():
        np.testing.assert_array_equal(ours[name], values, name)


def _same_files(ours: Path, theirs: Path) -> None:
    one, two = read(ours), read(theirs)
    for topic in (IMU, PVT, PVA):
        for name in one[topic]:
            np.testing.assert_allclose(
                one[topic][name], two[topic][name], rtol=1e-12, atol=1e-9, err_msg=f"{topic} {name}"
            )
