"""The rows that the MCAP jobs work on, and a file of another writer with awkward layouts."""

import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap_protobuf.writer import Writer as PairWriter

from spoofbench.codec import read
from spoofbench.table import Table

ROWS = 260_000


def imu_rows() -> tuple[str, Table]:
    """Return where the IMU rows are from, and the rows: of the real drive where it is installed,
    else synthetic.
    """
    spec = find_spec("pntos_cobra_datasets_ros")
    if spec is not None and spec.submodule_search_locations:
        from spoofbench.conversion import convert

        with tempfile.TemporaryDirectory() as folder:
            convert(
                Path(spec.submodule_search_locations[0]) / "cobra_gps_ins_example_data",
                Path(folder) / "drive.mcap",
            )
            return "real drive", read(Path(folder) / "drive.mcap").primary("imu").take(
                slice(0, ROWS)
            )
    rng = np.random.default_rng(1)
    axes = [
        f"{quantity}_{axis}_{unit}"
        for quantity, unit in (("accel", "mps2"), ("gyro", "radps"))
        for axis in "xyz"
    ]
    columns = {axis: rng.normal(size=ROWS).astype(np.float32).astype(np.float64) for axis in axes}
    time_ns = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(ROWS)
    return "synthetic rows", Table("imu", time_ns, {**columns, "interval_s": np.full(ROWS, 0.01)})


_AWKWARD = (
    ("note", 1, "STRING"),
    ("gyro_z_radps", 2, "DOUBLE"),
    ("gyro_y_radps", 3, "DOUBLE"),
    ("gyro_x_radps", 4, "DOUBLE"),
    ("receive_time_ns", 5, "INT64"),
    ("accel_x_mps2", 6, "FLOAT"),
    ("accel_y_mps2", 7, "DOUBLE"),
    ("accel_z_mps2", 21, "DOUBLE"),
    ("temperature_degc", 22, "SINT32"),
)


def write_awkward(path: Path, table: Table) -> Path:
    """Write a foreign file by mcap_protobuf's own writer, from a seed.

    Fields have other numbers, orders and types, integers are of variable width, an unknown text
    stands in front, and there is no presence: values that are 0 (a tenth of each angular rate) are
    dropped, which gives 16 layouts. A second channel is interleaved.
    """
    imu = _message("Imu", _AWKWARD)
    blink = _message("Blink", (("count", 1, "INT32"),))
    rng = np.random.default_rng(2)
    columns: dict[str, list[Any]] = {
        name: table[name].tolist() for name, _, _ in _AWKWARD if name in table
    }
    for name in ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps"):
        columns[name] = np.where(rng.random(len(table)) < 0.1, 0, table[name]).tolist()
    columns["temperature_degc"] = rng.integers(0, 60, len(table)).tolist()
    columns["receive_time_ns"] = (table.time_ns + rng.integers(0, 10**7, len(table))).tolist()
    columns["note"] = ["ok"] * len(table)
    with path.open("wb") as stream, PairWriter(stream) as writer:
        for row, time in enumerate(table.time_ns.tolist()):
            writer.write_message(
                "/imu0/imu",
                imu(**{name: values[row] for name, values in columns.items()}),
                time,
                time,
            )
            if row % 7 == 0:
                writer.write_message("/blink", blink(count=row), time, time)
    return path


def _message(name: str, fields: tuple[tuple[str, int, str], ...]) -> Any:
    message = DescriptorProto(name=name)
    for field, number, kind in fields:
        message.field.add(
            name=field, number=number, type=getattr(FieldDescriptorProto, f"TYPE_{kind}"), label=1
        )
    pool = DescriptorPool()
    pool.Add(
        FileDescriptorProto(
            name=f"{name}.proto", package="someone", syntax="proto3", message_type=[message]
        )
    )
    return GetMessageClass(pool.FindMessageTypeByName(f"someone.{name}"))
