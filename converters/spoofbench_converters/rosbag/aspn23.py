"""ASPN-23 messages: inertial increments, positions, velocities and navigation solutions.

Fields and types are those of the package ``aspn23_ros_interfaces`` (ASPN-Generated, Copyright
2022-2026 Integrated Solutions for Systems, Inc., Apache-2.0); a bag of them need not carry its
definitions.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion import Block, Columns, Reject, Rejects, SourceMetadata
from spoofbench.conversion.rows import take
from spoofbench_converters.rosbag.batches import BagTopic, TopicMessages
from spoofbench_converters.rosbag.contract import Options, Refusal, in_bag_order, refused
from spoofbench_converters.rosbag.definitions import Definitions, parse
from spoofbench_converters.rosbag.layouts import Group
from spoofbench_converters.rosbag.rows import ImuStream, PvaStream, PvtStream

_PACKAGE = "aspn23_ros_interfaces/msg/"
IMU, POSITION, VELOCITY, PVA = (
    f"{_PACKAGE}Measurement{name}"
    for name in ("Imu", "Position", "Velocity", "PositionVelocityAttitude")
)
TYPES = frozenset({IMU, POSITION, VELOCITY, PVA})

_STAMP = "TypeHeader header\nTypeTimestamp time_of_validity\n"
_COVARIANCE = (
    "uint8 num_meas\nfloat64[] covariance\nuint8 error_model\nuint16 num_error_model_params\n"
    "float64[] error_model_params\n"
)
_INTEGRITY = "uint8 num_integrity\nTypeIntegrity[] integrity\n"
_DEFINITIONS = {
    f"{_PACKAGE}TypeHeader": (
        "uint32 vendor_id\nuint64 device_id\nuint32 context_id\nuint16 sequence_id\n"
    ),
    f"{_PACKAGE}TypeTimestamp": "int64 elapsed_nsec\n",
    f"{_PACKAGE}TypeIntegrity": "uint8 integrity_method\nfloat64 integrity_value\n",
    IMU: f"{_STAMP}uint8 imu_type\nfloat64[3] meas_accel\nfloat64[3] meas_gyro\n{_INTEGRITY}",
    POSITION: (
        f"{_STAMP}uint8 reference_frame\nfloat64 term1\nfloat64 term2\nfloat64 term3\n"
        f"{_COVARIANCE}{_INTEGRITY}"
    ),
    VELOCITY: (
        f"{_STAMP}uint8 reference_frame\nfloat64 x\nfloat64 y\nfloat64 z\n{_COVARIANCE}{_INTEGRITY}"
    ),
    PVA: (
        f"{_STAMP}uint8 reference_frame\nfloat64 p1\nfloat64 p2\nfloat64 p3\nfloat64 v1\nfloat64 "
        "v2\nfloat64 v3\n"
        f"float64[4] quaternion\n{_COVARIANCE}{_INTEGRITY}"
    ),
}

_SIDES = {POSITION: "position", VELOCITY: "velocity"}
_INTEGRATED, _SAMPLED = 0, 1
_FRAMES = {POSITION: (1, "geodetic"), VELOCITY: (2, "NED"), PVA: (1, "geodetic")}
_UPPER = ((0, 0, "nn"), (0, 1, "ne"), (0, 2, "nd"), (1, 1, "ee"), (1, 2, "ed"), (2, 2, "dd"))

# Devices that do not keep to the declared frames, by vendor number and name of the device in the
# topic.
_SENDS_ENU_RFU = frozenset({(0x24000006, "ins_d")})
_SENDS_COVARIANCE_DOWN = frozenset({(0x24000002, "ublox_ZED_F9T")})
_QUIRKS = {
    "attitude": "quaternion (a, b, c, d) taken as (a, c, b, -d): it is of right-forward-up "
    "against ENU, not as declared, "
    "for tilt then follows the accelerometers at rest and yaw the course",
    "covariance": "third axis of the position covariance taken as down, as in the velocity "
    "covariance, not up as declared, "
    "for the geometry of the satellites gives both the same correlations",
}


@cache
def definitions() -> Definitions:
    """Return the definitions of all types of the family."""
    parsed: dict[str, Any] = {}
    for name, text in _DEFINITIONS.items():
        parsed.update(parse(text, name))
    return parsed


def open(topics: Sequence[BagTopic], options: Options) -> "Aspn23":  # noqa: A001 - the family's word
    """Return a session for these topics."""
    return Aspn23(topics, options)


class Aspn23:
    """The ASPN-23 topics of one bag.

    A device is a topic's name without its last part. The position and the velocity topic of one
    device are one GNSS receiver.
    """

    def __init__(self, topics: Sequence[BagTopic], options: Options) -> None:
        self._options = options
        self._quirks: dict[str, set[str]] = {}
        self._streams: dict[str, ImuStream | PvtStream | PvaStream] = {}
        imus = [topic for topic in topics if topic.type == IMU]
        receivers = _receivers(topics)
        for number, topic in enumerate(imus):
            self._streams[topic.name] = ImuStream(
                f"imu{number}", topic.name, options.imu_interval_s
            )
        for number, mine in enumerate(receivers):
            stream = PvtStream(
                f"gnss{number}",
                device(mine[0].name),
                {topic.name: _SIDES[topic.type] for topic in mine},
            )
            self._streams |= dict.fromkeys((topic.name for topic in mine), stream)
        solutions = [topic.name for topic in topics if topic.type == PVA]
        sensors = {device(topic.name) for topic in topics if topic.type != PVA}
        reference = _reference(solutions, sensors, options.reference)
        for number, name in enumerate(name for name in solutions if name != reference):
            self._streams[name] = PvaStream(f"ins{number}", name)
        if reference:
            self._streams[reference] = PvaStream("", reference)

    def take(
        self, topic: BagTopic, groups: Sequence[Group], messages: TopicMessages
    ) -> Iterator[Block | Reject | Rejects]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        pieces = []
        for group in groups:
            columns, refusals = self._columns(topic, group.rows)
            columns["time_ns"] = messages.appended(columns["time_ns"], group.index)
            columns |= {
                "record": messages.records[group.index],
                "receive_time_ns": messages.stamps_ns[group.index],
            }
            if self._options.time == "recorder":
                columns["time_ns"] = columns["receive_time_ns"]
            kept, given = refused(refusals, columns["record"], topic.name)
            yield from given
            pieces.append(columns if kept.all() else take(columns, kept))
        if pieces:
            yield from self._streams[topic.name].push(topic.name, in_bag_order(pieces))

    def _columns(self, topic: BagTopic, rows: NDArray[Any]) -> tuple[Columns, Sequence[Refusal]]:
        """Return what messages of one layout say; the columns of a topic are the same for all
        layouts.
        """
        columns: Columns = {"time_ns": rows["time_of_validity.elapsed_nsec"]}
        if topic.type == IMU:
            return columns | _imu(rows), [
                (rows["imu_type"] > _SAMPLED, "the IMU type is neither integrated nor sampled")
            ]
        frame, name = _FRAMES[topic.type]
        refusals: list[Refusal] = [(rows["reference_frame"] != frame, f"the frame is not {name}")]
        known = (int(rows["header.vendor_id"][0]), device(topic.name).rpartition("/")[2])
        if topic.type == POSITION:
            down = known in _SENDS_COVARIANCE_DOWN
            self._note(topic, "covariance", down)
            columns |= _position(rows, ("term1", "term2", "term3")) | _covariance(
                rows, "cov_{}_m2", flip_third=not down
            )
        elif topic.type == VELOCITY:
            columns |= _velocity(rows, ("x", "y", "z")) | _covariance(
                rows, "cov_vel_{}_m2ps2", flip_third=False
            )
        else:
            enu = self._options.attitude == "enu-rfu" or (
                self._options.attitude == "auto" and known in _SENDS_ENU_RFU
            )
            self._note(topic, "attitude", enu)
            columns |= _position(rows, ("p1", "p2", "p3")) | _velocity(rows, ("v1", "v2", "v3"))
            columns |= roll_pitch_yaw(enu_to_ned(rows["quaternion"]) if enu else rows["quaternion"])
        values = [columns[name] for name in columns if name in ("lat_deg", "lon_deg")]
        if values:
            refusals.append(
                (
                    (np.abs(values[0]) > 90) | (np.abs(values[1]) > 360),
                    "the position is not on the globe",
                )
            )
        return columns, refusals

    def settle(self) -> Iterator[Block | Reject | Rejects]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        for stream in dict.fromkeys(self._streams.values()):
            if isinstance(stream, PvtStream):
                yield from stream.settle()

    def finish(self) -> Iterator[Block | Reject | Rejects | SourceMetadata]:
        """See :class:`spoofbench_converters.rosbag.contract.MessageReader`."""
        about: dict[str, dict[str, str]] = {}
        for stream in dict.fromkeys(self._streams.values()):
            yield from stream.finish()
            notes = {
                name: _QUIRKS[name]
                for topic in stream.topics
                for name in sorted(self._quirks.get(topic, ()))
            }
            about[f"source/{stream.source or 'reference'}"] = {**stream.about(), **notes}
        recording = {"clock": "recorder" if self._options.time == "recorder" else "sensor"}
        if self._options.session:
            recording["session_id"] = self._options.session
        yield SourceMetadata({**about, "recording": recording})

    def _note(self, topic: BagTopic, quirk: str, applies: bool) -> None:
        if applies:
            self._quirks.setdefault(topic.name, set()).add(quirk)


def device(topic: str) -> str:
    """Return a topic's name without its last part."""
    return topic.rpartition("/")[0] or topic


def _receivers(topics: Sequence[BagTopic]) -> list[list[BagTopic]]:
    """Return the topics of each GNSS receiver: one of each type for one device, or else each topic
    alone.
    """
    devices: dict[str, list[BagTopic]] = {}
    for topic in topics:
        if topic.type in _SIDES:
            devices.setdefault(device(topic.name), []).append(topic)
    pairs = [mine for mine in devices.values() if len({topic.type for topic in mine}) == len(mine)]
    return sorted(
        [*pairs, *([topic] for mine in devices.values() if mine not in pairs for topic in mine)],
        key=lambda mine: mine[0].name,
    )


def _reference(solutions: Sequence[str], sensors: set[str], wanted: str) -> str | None:
    """Return the topic that is the independent reference, if any."""
    if wanted != "auto":
        return wanted if wanted in solutions else None
    return next((name for name in solutions if device(name) not in sensors), None)


def _imu(rows: NDArray[Any]) -> Columns:
    accel, gyro = rows["meas_accel"], rows["meas_gyro"]
    columns: Columns = {f"accel_{axis}_mps2": accel[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"gyro_{axis}_radps": gyro[:, i] for i, axis in enumerate("xyz")}
    return columns | {"integrated": rows["imu_type"] == _INTEGRATED}


def _position(rows: NDArray[Any], terms: tuple[str, str, str]) -> Columns:
    return {
        "lat_deg": degrees(rows[terms[0]]),
        "lon_deg": degrees(rows[terms[1]]),
        "height_m": rows[terms[2]],
    }


def _velocity(rows: NDArray[Any], terms: tuple[str, str, str]) -> Columns:
    return {f"vel_{axis}_mps": rows[term] for axis, term in zip("ned", terms, strict=True)}


def _covariance(rows: NDArray[Any], name: str, *, flip_third: bool) -> Columns:
    """Return the upper triangle in NED of a complete 3 x 3 covariance; of any other, absent
    values.
    """
    given = "covariance" in (rows.dtype.names or ()) and rows.dtype["covariance"].shape == (9,)
    if not given:
        return {name.format(axes): np.full(rows.size, np.nan) for _, _, axes in _UPPER}
    matrix = rows["covariance"].reshape(-1, 3, 3)
    sign = np.array([1.0, 1.0, -1.0 if flip_third else 1.0])
    return {name.format(axes): matrix[:, i, j] * (sign[i] * sign[j]) for i, j, axes in _UPPER}


def degrees(radians: NDArray[Any]) -> NDArray[np.float64]:
    """Return degrees, of any shape; where a decimal of nine places converts to precisely these
    radians, that decimal.

    Receivers say degrees in decimals and recorders turn them to radians: this undoes it without
    float dust.
    """
    exact = np.rad2deg(radians.astype(np.float64))
    decimal = np.round(exact, 9)
    return np.where(np.deg2rad(decimal) == radians, decimal, exact)


_NORM_TOLERANCE = 1e-3


def enu_to_ned(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return NED to forward-right-down of ENU to right-forward-up, both ``(n, 4)`` as (a, b, c, d),
    a the scalar.

    Both frames swap their first two axes and turn their third round: (a, b, c, d) becomes (a, c, b,
    -d).
    """
    return np.asarray(quaternion[:, [0, 2, 1, 3]] * np.array([1.0, 1.0, 1.0, -1.0]))


def roll_pitch_yaw(quaternion: NDArray[np.float64]) -> Columns:
    """Return ``roll_deg pitch_deg yaw_deg`` of quaternions ``(n, 4)`` that turn NED into the body
    frame.

    Yaw, then pitch, then roll (Groves, Principles of GNSS, Inertial, and Multisensor Integrated
    Navigation Systems, 2nd ed., 2013, section 2.2); yaw from 0 to 360. Absent where the norm is not
    1.
    """
    norm = np.linalg.norm(quaternion, axis=1)
    proper = np.abs(norm - 1) < _NORM_TOLERANCE
    a, b, c, d = np.divide(
        quaternion.T, norm, out=np.full(quaternion.T.shape, np.nan), where=proper
    )
    roll = np.arctan2(2 * (a * b + c * d), 1 - 2 * (b * b + c * c))
    pitch = np.arcsin(np.clip(2 * (a * c - b * d), -1, 1))
    yaw = np.arctan2(2 * (a * d + b * c), 1 - 2 * (c * c + d * d))
    return {
        "roll_deg": np.rad2deg(roll),
        "pitch_deg": np.rad2deg(pitch),
        "yaw_deg": np.rad2deg(yaw) % 360,
    }
