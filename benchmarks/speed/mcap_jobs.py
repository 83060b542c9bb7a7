"""MCAP written, read and validated: 260,000 IMU rows, against the libraries that people use for it.

Writers start from numpy columns and end with a closed file that was not there before; readers start
from a file that is in the page cache and end with one numpy array per field. Checksums of chunks
are written and checked on all sides, and for each row everybody writes the same fields, in chunks
of 1 MiB.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer as PairWriter

from benchmarks.speed.frame import Job
from benchmarks.speed.mcap_rows import imu_rows, write_awkward
from spoofbench.codec import Compression, read, validate, write
from spoofbench.codec.channels import descriptor_set
from spoofbench.recording import Recording
from spoofbench.schema import KINDS
from spoofbench.schema.v1.imu_pb2 import Imu
from spoofbench.table import Table

TOPIC = "/imu0/imu"
SCHEMA = KINDS["imu"].message.full_name
OPTIONAL_PEERS = {"small-mcap": "small_mcap", "foxglove-sdk": "foxglove"}

Columns = dict[str, np.ndarray[Any, Any]]


def jobs(folder: Path) -> Iterator[Job]:
    """Yield the MCAP jobs; their files are in the folder."""
    origin, table = imu_rows()
    what = f"{len(table):,} IMU rows, {origin}"
    missing = [peer for peer, module in OPTIONAL_PEERS.items() if find_spec(module) is None]
    yield from _writing(folder, table, what, missing)
    path = folder / "read.mcap"
    write(Recording({TOPIC: table}), path)
    yield from _reading(
        folder, path, table, what, [peer for peer in missing if peer == "small-mcap"]
    )
    awkward = write_awkward(folder / "awkward.mcap", table)
    pair = {"mcap-protobuf": partial(_pair_read, awkward, in_order=False)}
    timed = f"{what}, in 16 foreign layouts, file order, to columns"
    yield Job("mcap-read-foreign", timed, partial(_our_read, awkward), pair, check=_same_columns)
    yield Job(
        "mcap-validate",
        f"{what}: the whole file",
        partial(validate, path),
        {"mcap": partial(_mcap_validate, path)},
    )


def _writing(folder: Path, table: Table, what: str, missing: list[str]) -> Iterator[Job]:
    recording, settings = (
        Recording({TOPIC: table}),
        (("zstd3", "zstd", 3), ("zstd1", "zstd", 1), ("none", "none", 0)),
    )
    compression: Compression
    for name, compression, level in settings:  # type: ignore[assignment]

        def ours(
            path: Path = folder / "ours.mcap",
            compression: Compression = compression,
            level: int = level,
        ) -> Path:
            write(recording, path, compression=compression, level=level)
            return path

        writers: dict[str, Callable[[Table, Path, int], Path]] = {"mcap-protobuf": _pair_write}
        writers |= {
            peer: {"small-mcap": _small_write, "foxglove-sdk": _sdk_write}[peer]
            for peer in OPTIONAL_PEERS
            if peer not in missing
        }
        peers = {
            peer: partial(writer, table, folder / f"{peer}.mcap", level)
            for peer, writer in writers.items()
        }

        def remove(
            files: tuple[Path, ...] = (
                folder / "ours.mcap",
                *(folder / f"{peer}.mcap" for peer in peers),
            ),
        ) -> None:
            for file in files:
                file.unlink(missing_ok=True)

        yield Job(
            f"mcap-write-{name}",
            f"{what}, columns to a new file, {name}",
            ours,
            peers,
            missing,
            _same_files,
            remove,
        )


def _reading(
    folder: Path, path: Path, table: Table, what: str, missing: list[str]
) -> Iterator[Job]:
    ours = partial(_our_read, path)
    parquet = folder / "read.parquet"
    columns = {"time_ns": table.time_ns, **table}
    pq.write_table(
        pa.table(columns),
        parquet,
        compression="zstd",
        compression_level=3,
        write_page_checksum=True,
    )
    peers: dict[str, Callable[[], Any]] = {
        "mcap-protobuf": partial(_pair_read, path, in_order=True)
    }
    if not missing:
        peers["small-mcap"] = partial(_small_read, path)
    peers["parquet"] = partial(_parquet_read, parquet)
    yield Job(
        "mcap-read",
        f"{what}, zstd 3, order of time, to columns",
        ours,
        peers,
        missing,
        _same_columns,
    )
    in_file_order = {"mcap-protobuf": partial(_pair_read, path, in_order=False)}
    yield Job(
        "mcap-read-file-order",
        f"{what}, zstd 3, file order, to columns",
        ours,
        in_file_order,
        check=_same_columns,
    )


def _messages(table: Table) -> Iterator[tuple[int, Imu]]:
    """A table's rows as messages, the way that costs least."""
    names = list(table)
    for time, *values in zip(
        table.time_ns.tolist(), *(table[name].tolist() for name in names), strict=True
    ):
        yield time, Imu(**dict(zip(names, values, strict=True)))


def _pair_write(table: Table, path: Path, level: int) -> Path:
    """Write by mcap and mcap-protobuf-support; the library has no level, so its compressor is given
    one.
    """
    compression = CompressionType.ZSTD if level else CompressionType.NONE
    levelled = SimpleNamespace(compress=lambda data: zstandard.compress(data, level))
    with (
        patch("mcap.writer.zstandard", levelled),
        path.open("wb") as stream,
        PairWriter(stream, compression=compression) as writer,
    ):
        for time, message in _messages(table):
            writer.write_message(TOPIC, message, time, time)
    return path


def _small_write(table: Table, path: Path, level: int) -> Path:
    import small_mcap

    compression = small_mcap.CompressionType.ZSTD if level else small_mcap.CompressionType.NONE
    with path.open("wb") as stream:
        writer = small_mcap.McapWriter(
            stream,
            compression=compression,
            zstd_level=level or None,
            num_workers=os.cpu_count() or 1,
        )
        writer.start()
        writer.add_schema(1, SCHEMA, "protobuf", descriptor_set(KINDS["imu"].message))
        writer.add_channel(1, TOPIC, "protobuf", 1)
        for time, message in _messages(table):
            writer.add_message(1, time, message.SerializeToString(), time)
        writer.finish()
    return path


def _sdk_write(table: Table, path: Path, level: int) -> Path:
    import foxglove
    from foxglove.mcap import MCAPCompression, MCAPWriteOptions

    context = foxglove.Context()
    compression = MCAPCompression.Zstd if level else None
    options = MCAPWriteOptions(
        compression=compression, compression_level=level, calculate_data_section_crc=False
    )
    schema = foxglove.Schema(
        name=SCHEMA, encoding="protobuf", data=descriptor_set(KINDS["imu"].message)
    )
    with foxglove.open_mcap(
        str(path), allow_overwrite=True, context=context, writer_options=options
    ):
        channel = foxglove.Channel(
            TOPIC, schema=schema, message_encoding="protobuf", context=context
        )
        for time, message in _messages(table):
            channel.log(message.SerializeToString(), log_time=time)
        channel.close()
    return path


def _our_read(path: Path) -> Columns:
    table = read(path)[TOPIC]
    return {"time_ns": table.time_ns, **table}


def _gathered(rows: Iterator[tuple[int, Any]]) -> Columns:
    """Columns of the fields that the messages' type shares with our schema."""
    time, message = next(rows)
    names = [name for name in KINDS["imu"].fields if name in message.DESCRIPTOR.fields_by_name]
    names = [
        name
        for name in names
        if not message.DESCRIPTOR.fields_by_name[name].has_presence or message.HasField(name)
    ]
    times, values = [time], [[getattr(message, name)] for name in names]
    appends = [column.append for column in values]
    for time, message in rows:
        times.append(time)
        for append, name in zip(appends, names, strict=True):
            append(getattr(message, name))
    return {
        "time_ns": np.array(times),
        **{name: np.array(column) for name, column in zip(names, values, strict=True)},
    }


def _pair_read(path: Path, *, in_order: bool) -> Columns:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = reader.iter_decoded_messages([TOPIC], log_time_order=in_order)
        return _gathered((message.log_time, row) for _, _, message, row in decoded)


def _small_read(path: Path) -> Columns:
    import small_mcap

    with path.open("rb") as stream:
        decoded = small_mcap.read_message_decoded(
            stream,
            decoder_factories=[DecoderFactory()],
            validate_crc=True,
            num_workers=os.cpu_count() or 1,
        )
        return _gathered((row.message.log_time, row.decoded_message) for row in decoded)


def _parquet_read(path: Path) -> Columns:
    columns = pq.read_table(path, page_checksum_verification=True)
    return {name: columns[name].to_numpy() for name in columns.column_names}


def _mcap_validate(path: Path) -> None:
    with path.open("rb") as stream:
        for _ in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
            pass


def _same_files(ours: Path, theirs: Path) -> None:
    if read(ours)[TOPIC] != read(theirs)[TOPIC]:
        raise ValueError(f"{theirs.name} holds other rows than ours")


def _same_columns(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> None:
    if ours.keys() != theirs.keys() or not all(
        np.array_equal(ours[name], theirs[name]) for name in ours
    ):
        raise ValueError("a peer reads other columns")
