"""Bags made by rosbags' own writer from messages drawn at random."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore
from spoofbench_converters import rosbag
from spoofbench_converters.rosbag import aspn23

from spoofbench.conversion import Block, Reject, Rejects, Source, SourceMetadata
from spoofbench.recording import Recording
from spoofbench.table import Column, Table

START_NS = 1_700_000_000_000_000_000
Message = tuple[str, str, int, Any]
"""BagTopic, type, the recorder's stamp, and the message (or its bytes)."""


@dataclass(frozen=True)
class Result:
    """What a conversion of a bag yields."""

    recording: Recording
    rejects: list[Reject]
    used: int

    @property
    def skipped(self) -> int:
        return sum(reject.length for reject in self.rejects)

    @property
    def reasons(self) -> set[str]:
        return {reject.reason for reject in self.rejects}


@pytest.fixture(scope="session")
def typestore() -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(dict(aspn23.definitions()))
    return store


class Maker:
    """Makes ASPN-23 messages, and bags of any messages."""

    imu = "/sensor/unit/imu"
    position = "/sensor/receiver/position"
    velocity = "/sensor/receiver/velocity"
    pva = "/sensor/ins/pva"

    def __init__(self, store: Typestore, folder: Path) -> None:
        self.store = store
        self.rng = np.random.default_rng(1)
        self._folder = folder

    def message(
        self,
        kind: str,
        time_ns: int,
        stamp_ns: int | None = None,
        topic: str | None = None,
        **changes: Any,
    ) -> Message:
        """Return one message of a kind ``imu``, ``position``, ``velocity`` or ``pva`` with random
        values.
        """
        types, draw = self.store.types, self.rng.normal
        name = {
            "imu": aspn23.IMU,
            "position": aspn23.POSITION,
            "velocity": aspn23.VELOCITY,
            "pva": aspn23.PVA,
        }[kind]
        size = {"position": 3, "velocity": 3, "pva": 9}.get(kind, 0)
        header = types[f"{aspn23.IMU.rpartition('/')[0]}/TypeHeader"](
            vendor_id=1, device_id=2, context_id=3, sequence_id=4
        )
        stamp = types[f"{aspn23.IMU.rpartition('/')[0]}/TypeTimestamp"](elapsed_nsec=time_ns)
        values: dict[str, Any] = {
            "header": header,
            "time_of_validity": stamp,
            "num_integrity": 0,
            "integrity": [],
        }
        if kind == "imu":
            values |= {"imu_type": 0, "meas_accel": draw(size=3), "meas_gyro": draw(size=3)}
        else:
            values |= {
                "reference_frame": 2 if kind == "velocity" else 1,
                "num_meas": size,
                "covariance": draw(size=size * size),
            }
            values |= {
                "error_model": 0,
                "num_error_model_params": 0,
                "error_model_params": np.zeros(0),
            }
        if kind == "velocity":
            values |= dict(zip("xyz", draw(size=3), strict=True))
        if kind in ("position", "pva"):
            terms = ("term1", "term2", "term3") if kind == "position" else ("p1", "p2", "p3")
            values |= dict(
                zip(terms, (*self.rng.uniform(-1.5, 1.5, 2), float(draw())), strict=True)
            )
        if kind == "pva":
            quaternion = draw(size=4)
            values |= dict(zip(("v1", "v2", "v3"), draw(size=3), strict=True))
            values["quaternion"] = quaternion / np.linalg.norm(quaternion)
        message = types[name](**{**values, **changes})
        return (
            topic or getattr(self, kind),
            name,
            time_ns - 200_000_000 if stamp_ns is None else stamp_ns,
            message,
        )

    def session(self, seconds: int = 30) -> list[Message]:
        """Return a session of 50 Hz inertial rows, 1 Hz epochs and 10 Hz solutions, in the
        recorder's order.
        """
        messages = [
            self.message("imu", START_NS + i * 20_000_000 + int(self.rng.integers(-(10**6), 10**6)))
            for i in range(50 * seconds)
        ]
        messages += [self.message("pva", START_NS + i * 100_000_000) for i in range(10 * seconds)]
        for i in range(seconds):
            messages += [
                self.message(kind, START_NS + i * 1_000_000_000)
                for kind in ("position", "velocity")
            ]
        return sorted(messages, key=lambda message: message[2])

    def bag(self, messages: Sequence[Message], name: str = "bag") -> Path:
        """Write a bag folder."""
        path = self._folder / name
        with Writer(path, version=8) as writer:
            connections = {}
            for topic, kind, stamp_ns, message in messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                data = (
                    message
                    if isinstance(message, bytes)
                    else self.store.serialize_cdr(message, kind)
                )
                writer.write(connections[topic], stamp_ns, bytes(data))
        return path


@pytest.fixture
def maker(typestore: Typestore, tmp_path: Path) -> Maker:
    return Maker(typestore, tmp_path)


def _convert(path: Path, **options: Any) -> Result:
    tables: dict[str, list[Table]] = {}
    rejects: list[Reject] = []
    used, metadata = 0, {}
    for item in rosbag.convert(Source.of(path), rosbag.Options(**options)):
        if isinstance(item, Block):
            tables.setdefault(item.topic, []).append(item.table)
            used += item.used
        elif isinstance(item, Reject):
            rejects.append(item)
        elif isinstance(item, Rejects):
            rejects += [
                Reject(offset, length, item.reason)
                for offset, length in zip(item.offsets, item.lengths, strict=True)
            ]
        elif isinstance(item, SourceMetadata):
            for name, record in item.metadata.items():
                metadata[name] = {**metadata.get(name, {}), **record}
    return Result(
        Recording({topic: _joined(parts) for topic, parts in tables.items()}, metadata),
        rejects,
        used,
    )


def _joined(parts: Sequence[Table]) -> Table:
    columns = {name: _column(parts, name) for name in parts[0]}
    return Table(parts[0].kind.name, np.concatenate([part.time_ns for part in parts]), columns)


def _column(parts: Sequence[Table], name: str) -> Any:
    if parts[0].kind.fields[name].category == "text":
        return [word for part in parts for word in part.texts(name)]
    return Column(
        np.concatenate([part[name] for part in parts]),
        np.concatenate([part.valid(name) for part in parts]),
    )


@pytest.fixture
def convert_bag() -> Callable[..., Result]:
    return _convert


@pytest.fixture(scope="session")
def drive() -> Result:
    """The real drive, converted once."""
    package = pytest.importorskip(
        "pntos_cobra_datasets_ros", reason="the package pntos-cobra-datasets-ros is not installed"
    )
    return _convert(Path(package.EXAMPLE_ROS_LOG).parent)


def _sessions() -> Any:
    spec = spec_from_file_location("rosbag_sessions", Path(__file__).with_name("sessions.py"))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for their own module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def sessions() -> Any:
    """The module that makes sessions of standard messages and writes bags of them."""
    return _sessions()


@pytest.fixture(scope="session")
def expected(sessions: Any, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """What the session ``sessions.drive(40)`` gives, from an SQLite bag."""
    return _convert(
        sessions.write_ros2(tmp_path_factory.mktemp("expected") / "bag", sessions.drive(40))
    )
