"""One session of standard messages, written by rosbags in every kind of bag."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

START_NS = 1_700_000_000_000_000_000
SECOND_NS = 1_000_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)

IMU, FIX, TWIST, MAG = (
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "geometry_msgs/msg/TwistStamped",
    "sensor_msgs/msg/MagneticField",
)


@dataclass(frozen=True)
class Message:
    """One message: what it holds by path of its fields; the rest is zero."""

    topic: str
    type: str
    stamp_ns: int
    values: Mapping[str, Any]


def time(path: str, time_ns: int) -> dict[str, int]:
    return {f"{path}.sec": time_ns // SECOND_NS, f"{path}.nanosec": time_ns % SECOND_NS}


def vector(path: str, values: Sequence[float]) -> dict[str, float]:
    return {f"{path}.{axis}": float(value) for axis, value in zip("xyz", values, strict=True)}


def drive(
    seconds: int = 30, header_off_ns: Mapping[str, int] | None = None, seed: int = 1
) -> list[Message]:
    """Return 50 Hz inertial, 10 Hz magnetic, 1 Hz position and velocity messages that vary in
    length, in the recorder's order.
    """
    rng, off = np.random.default_rng(seed), header_off_ns or {}
    messages = []

    def add(topic: str, kind: str, time_ns: int, values: Mapping[str, Any]) -> None:
        header = {
            "header.frame_id": "f" * int(rng.integers(1, 9)),
            **time("header.stamp", time_ns + off.get(topic, 0)),
        }
        messages.append(
            Message(topic, kind, time_ns + int(rng.integers(10**6, 10**7)), {**header, **values})
        )

    for i in range(50 * seconds):
        accel, gyro = (
            vector("linear_acceleration", rng.normal(size=3)),
            vector("angular_velocity", rng.normal(size=3)),
        )
        add("/imu/data", IMU, START_NS + i * 20_000_000, {**accel, **gyro})
    for i in range(10 * seconds):
        add(
            "/imu/mag",
            MAG,
            START_NS + i * 100_000_000,
            vector("magnetic_field", rng.normal(size=3) * 1e-5),
        )
    for i in range(seconds):
        place = {
            "latitude": 42 + i * 1e-5,
            "longitude": -71.0,
            "altitude": 30.0 + i,
            "status.status": 0,
        }
        covariance = {
            "position_covariance": rng.normal(size=9) + 9 * np.eye(3).reshape(-1),
            "position_covariance_type": i % 4,
        }
        add("/gps/fix", FIX, START_NS + i * SECOND_NS, {**place, **covariance})
        add("/gps/vel", TWIST, START_NS + i * SECOND_NS, vector("twist.linear", rng.normal(size=3)))
    return sorted(messages, key=lambda message: message.stamp_ns)


def moved(message: Message, by_ns: int) -> Message:
    """Return a message as of another time of the host's clock, which stamps its header too."""
    own_ns = (
        message.values["header.stamp.sec"] * SECOND_NS
        + message.values["header.stamp.nanosec"]
        + by_ns
    )
    return replace(
        message,
        stamp_ns=message.stamp_ns + by_ns,
        values={**message.values, **time("header.stamp", own_ns)},
    )


def build(store: Typestore, kind: str, values: Mapping[str, Any], prefix: str = "") -> Any:
    """Return a message of a type."""
    from rosbags.interfaces import Nodetype

    made: dict[str, Any] = {}
    for name, (node, inner) in store.fielddefs[kind][1]:
        path = f"{prefix}{name}"
        if node == Nodetype.NAME:
            made[name] = build(store, inner, values, f"{path}.")
        elif path in values:
            made[name] = values[path]
        elif node == Nodetype.BASE:
            made[name] = "" if inner[0] == "string" else 0
        else:
            made[name] = np.zeros(inner[1] if node == Nodetype.ARRAY else 0, "f8")
    return store.types[kind](**made)


def write_ros1(
    path: Path, messages: Sequence[Message], packing: str = "", store: Typestore = ROS1
) -> Path:
    """Write a ROS 1 bag, its chunks packed by nothing, ``BZ2`` or ``LZ4``."""
    writer = rosbag1.Writer(path)
    writer.chunk_threshold = 65_536
    if packing:
        writer.set_compression(rosbag1.Writer.CompressionFormat[packing])
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, message.type, typestore=store
                )
            data = store.serialize_ros1(build(store, message.type, message.values), message.type)
            writer.write(connections[message.topic], message.stamp_ns, data)
    return path


def write_ros2(
    path: Path,
    messages: Sequence[Message],
    storage: str = "SQLITE3",
    packing: str = "NONE",
    store: Typestore = ROS2,
) -> Path:
    """Write a ROS 2 bag folder, packed by nothing, as a ``FILE``, by ``MESSAGE`` or by
    ``STORAGE``.
    """
    writer = rosbag2.Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if packing != "NONE":
        writer.set_compression(CompressionMode[packing], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(
                    message.topic, message.type, typestore=store
                )
            data = store.serialize_cdr(build(store, message.type, message.values), message.type)
            writer.write(connections[message.topic], message.stamp_ns, data)
    return path


def rewrite(bag: Path, path: Path, compression: CompressionType, **options: Any) -> Path:
    """Write an MCAP bag again by the mcap library, in small chunks with checksums."""
    with bag.open("rb") as read, path.open("wb") as written:
        writer = McapWriter(written, chunk_size=20_000, compression=compression, **options)
        writer.start("ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(read).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                schemas.setdefault(
                    schema.id, writer.register_schema(schema.name, schema.encoding, schema.data)
                )
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()
    return path


WRITERS: Mapping[str, Callable[[Path, Sequence[Message]], Path]] = {
    "ros1": write_ros1,
    "ros1-bz2": lambda path, messages: write_ros1(path, messages, "BZ2"),
    "ros1-lz4": lambda path, messages: write_ros1(path, messages, "LZ4"),
    "sqlite": write_ros2,
    "sqlite-file-zstd": lambda path, messages: write_ros2(path, messages, packing="FILE"),
    "sqlite-message-zstd": lambda path, messages: write_ros2(path, messages, packing="MESSAGE"),
    "mcap": lambda path, messages: write_ros2(path, messages, "MCAP"),
    "mcap-file-zstd": lambda path, messages: write_ros2(path, messages, "MCAP", "FILE"),
    "mcap-message-zstd": lambda path, messages: write_ros2(path, messages, "MCAP", "MESSAGE"),
    "mcap-chunk-zstd": lambda path, messages: write_ros2(path, messages, "MCAP", "STORAGE"),
}
"""By name, what writes a bag at a path."""
