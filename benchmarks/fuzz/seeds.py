"""The logs that fuzzing starts from: small ones made here, and the beginnings of real ones where
there are any.
"""

import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.mutate import MOST_BYTES, sentence, ubx
from spoofbench.codec import write
from spoofbench.testing import drive

_START_S = 1_700_000_000


def made(target: str, folder: Path) -> list[bytes]:
    """Return small logs of a target's format."""
    makers = {
        "nmea": _nmea,
        "ubx": _ubx,
        "phone": _phone,
        "table": _table,
        "rosbag": _rosbag,
        "mcap": _mcap,
    }
    return list(makers[target](folder)) if target in makers else [b""]


def real(target: str, data: Path) -> list[bytes]:
    """Return the beginnings of real logs of a target's format in a folder."""
    patterns = {
        "nmea": ("nmea_ubx/*.nmea", "nmea_ubx/gpsd_*.log"),
        "ubx": ("nmea_ubx/*.ubx", "nmea_ubx/gpsd_ublox*.log"),
        "phone": ("phone_bag/gl_*", "phone_bag/sensorl*.csv", "phone_bag/phyphox*"),
        "table": (
            "phone_bag/*.csv",
            "phone_bag/*.pos",
            "phone_bag/fw_*.zip",
            "phone_bag/comma*.zip",
        ),
        "rosbag": ("phone_bag/ros1_*gps*.bag", "phone_bag/*.mcap"),
    }
    paths = [
        path
        for pattern in patterns.get(target, ())
        for path in sorted(data.glob(pattern))
        if path.is_file()
    ]
    return [
        path.read_bytes() if path.suffix == ".zip" else path.read_bytes()[: MOST_BYTES // 4]
        for path in paths
    ]


def _nmea(_: Path) -> Iterator[bytes]:
    lines = nmea_lines(30)
    yield b"\r\n".join(lines) + b"\r\n"
    yield b"".join(
        b"NMEA,%s,%d\n" % (line, 1000 * (_START_S + place)) for place, line in enumerate(lines)
    )


def nmea_lines(seconds: int) -> list[bytes]:
    """Return what a receiver says in NMEA in so many seconds, less than 12 hours, one line each."""
    lines = []
    for second in range(seconds):
        clock = b"%02d%02d%02d.00" % (12 + second // 3600, second // 60 % 60, second % 60)
        place = b"4807.%05d,N,01131.%05d,E" % (3800 + second, 2400 + second)
        lines += [
            b"GPRMC,%s,A,%s,010.5,084.4,190623,,,A" % (clock, place),
            b"GPGGA,%s,%s,1,08,0.9,545.4,M,46.9,M,," % (clock, place),
            b"GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1",
            b"GPGSV,2,1,08,01,40,083,46,02,17,308,41,12,07,344,39,14,22,228,45",
            b"GPGSV,2,2,08,15,40,083,46,16,17,308,41,17,07,344,39,18,22,228,45",
            b"GPVTG,084.4,T,,M,010.5,N,019.4,K,A",
            b"GPGST,%s,1.2,2.3,1.1,45.0,1.5,1.4,3.0" % clock,
            b"GPZDA,%s,19,06,2023,00,00" % clock,
            b"PUBX,00,%s,%s,545.4,G3,2.1,2.0,0.007,77.52,0.007,,0.92,1.19,0.77,9,0,0"
            % (clock, place),
        ]
    return [sentence(line) for line in lines]


def _ubx(_: Path) -> Iterator[bytes]:
    yield ubx_log(20)


def ubx_log(seconds: int) -> bytes:
    """Return what a receiver says in UBX in so many seconds, less than 12 hours."""
    log = []
    rng = np.random.default_rng(0)
    for second in range(seconds):
        itow = 388_800_000 + 1000 * second
        clock = (12 + second // 3600, second // 60 % 60, second % 60)
        head = struct.pack(
            "<IHBBBBBBIiBBBBiiii",
            itow,
            2023,
            6,
            22,
            *clock,
            7,
            20,
            100,
            3,
            1,
            0,
            9,
            115_000_000,
            481_000_000,
            500_000,
            450_000,
        )
        log.append(
            ubx(
                b"\x01\x07",
                head
                + struct.pack("<IIiiiiiII", 900, 1200, 1500, -20, 10, 1500, 0, 50, 100_000).ljust(
                    92 - len(head), b"\0"
                ),
            )
        )
        log.append(ubx(b"\x01\x35", struct.pack("<IBBxx", itow, 1, 2) + rng.bytes(24)))
        log.append(
            ubx(
                b"\x02\x15",
                struct.pack("<dHbBBxxx", 388_800 + second, 2266, 18, 1, 1) + rng.bytes(32),
            )
        )
        log.append(
            ubx(
                b"\x10\x02",
                struct.pack("<IHH", 1000 * second, 3 << 11, 0)
                + struct.pack("<III", 14 << 24, 13 << 24, 5 << 24),
            )
        )
        log.append(ubx(b"\x01\x43", struct.pack("<IBBxx", itow, 0, 1) + rng.bytes(16)))
        log.append(ubx(b"\x0a\x38", struct.pack("<BBxx", 0, 1) + rng.bytes(24)))
        log.append(ubx(b"\x27\x09", bytes([1, 2, 0, 0]) + rng.bytes(8)))
        log.append(ubx(b"\x01\x61", struct.pack("<I", itow)))
    return b"".join(log)


def _phone(_: Path) -> Iterator[bytes]:
    yield phone_log(20)


def phone_log(seconds: int) -> bytes:
    """Return what GnssLogger writes in so many seconds."""
    raw = (
        "utcTimeMillis,TimeNanos,LeapSecond,TimeUncertaintyNanos,FullBiasNanos,BiasNanos,BiasUncertaintyNanos,DriftNanosPerSecond,"
        "DriftUncertaintyNanosPerSecond,"
        "HardwareClockDiscontinuityCount,Svid,TimeOffsetNanos,State,ReceivedSvTimeNanos,"
        "ReceivedSvTimeUncertaintyNanos,"
        "Cn0DbHz,PseudorangeRateMetersPerSecond,PseudorangeRateUncertaintyMetersPerSecond,"
        "AccumulatedDeltaRangeState,"
        "AccumulatedDeltaRangeMeters,"
        "AccumulatedDeltaRangeUncertaintyMeters,CarrierFrequencyHz,CarrierCycles,"
        "CarrierPhase,CarrierPhaseUncertainty,MultipathIndicator,SnrInDb,ConstellationType,AgcDb,BasebandCn0DbHz,FullInterSignalBiasNanos,"
        "FullInterSignalBiasUncertaintyNanos,"
        "SatelliteInterSignalBiasNanos,SatelliteInterSignalBiasUncertaintyNanos,CodeType,"
        "ChipsetElapsedRealtimeNanos,IsFullTracking"
    )
    fix = (
        "Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,BearingDegrees,UnixTimeMillis,"
        "SpeedAccuracyMps,"
        "BearingAccuracyDegrees,elapsedRealtimeNanos,VerticalAccuracyMeters,MockLocation"
    )
    lines = [
        "# Version: v3.0.5.6 Platform: 12 Manufacturer: Google Model: Pixel 6",
        "# ",
        f"# Raw,{raw}",
        f"# Fix,{fix}",
    ]
    lines.append(
        "# UncalAccel,utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,"
        "UncalAccelZMps2,BiasXMps2,BiasYMps2,BiasZMps2"
    )
    for second in range(seconds):
        ms, ns = 1000 * (_START_S + second), 10**9 * (500 + second)
        lines.append(f"Fix,GPS,37.4273,-122.1694,40.5,1.25,3.8,90.0,{ms},0.5,10.0,{ns},2.0,0")
        lines.append(
            f"Raw,{ms},{ns},18,20.0,-1384000000000000000,0.25,10.0,1.5,2.5,3,{second % 32 + 1},"
            f"0.0,16431,320000000000123,20,38.5,-120.5,0.1,1,0.0,3.4e38,1575420030,,,,0,,1,40.2,34.5,0.0,0.0,,,C,{ns},1"
        )
        lines += [
            f"UncalAccel,{ms + 20 * i},{ns + 20_000_000 * i},0.1,0.2,9.8,0.0,0.0,0.0"
            for i in range(10)
        ]
    return ("\n".join(lines) + "\n").encode()


def _table(_: Path) -> Iterator[bytes]:
    yield table_log(20)


def table_log(seconds: int) -> bytes:
    """Return a table of a phone in a car at 5 Hz of so many seconds."""
    names = [
        "timestamp",
        "latitude",
        "longitude",
        "speed",
        *(f"{sensor}{axis}" for sensor in ("accelerometer", "gyro") for axis in "XYZ"),
    ]
    rows = [
        (
            f"{_START_S + i // 5}.{i % 5 * 2},"
            f"40.4{40_000 + i // 5},"
            f"-79.9{40_000 + i // 5},{5 + i % 7:.2f},0.0{i % 9},-0.98,0.02,0.01,0.02,0.03"
        )
        for i in range(5 * seconds)
    ]
    return ("\n".join([",".join(names), *rows]) + "\n").encode()


def _mcap(folder: Path) -> Iterator[bytes]:
    for compression in ("none", "zstd", "lz4"):
        path = folder / f"{compression}.mcap"
        chosen: Any = compression
        write(drive(1, 20.0), path, compression=chosen)
        yield path.read_bytes()
    yield _foreign_mcap(folder / "foreign.mcap")


def _foreign_mcap(path: Path) -> bytes:
    """Return a file without checksums, so that what is changed in it is read."""
    from mcap.writer import CompressionType, Writer

    from spoofbench.schema import KINDS

    message = KINDS["imu"].message
    with path.open("wb") as file:
        writer = Writer(
            file, compression=CompressionType.NONE, enable_crcs=False, enable_data_crcs=False
        )
        writer.start()
        descriptor = _descriptors(message.file)
        schema = writer.register_schema(message.full_name, "protobuf", descriptor)
        channel = writer.register_channel("/imu0/imu", "protobuf", schema)
        for row in range(50):
            payload = b"".join(
                bytes([number << 3 | 1]) + struct.pack("<d", row * 0.1) for number in range(1, 7)
            )
            time_ns = _START_S * 10**9 + row * 10_000_000
            writer.add_message(channel, time_ns, payload, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path.read_bytes()


def _descriptors(file: Any) -> bytes:
    from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

    proto = FileDescriptorProto()
    file.CopyToProto(proto)
    return bytes(FileDescriptorSet(file=[proto]).SerializeToString())


def _rosbag(folder: Path) -> Iterator[bytes]:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    for version, store in (
        (1, get_typestore(Stores.ROS1_NOETIC)),
        (2, get_typestore(Stores.ROS2_HUMBLE)),
        (3, get_typestore(Stores.ROS2_HUMBLE)),
    ):
        path: Path = folder / f"ros{version}"
        writer: Any = (
            Writer1(path)
            if version == 1
            else Writer2(path, version=8, storage_plugin=list(StoragePlugin)[version - 2])
        )
        with writer:
            kinds = ("sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix")
            connections = [
                writer.add_connection(f"/{kind[-3:].lower()}", kind, typestore=store)
                for kind in kinds
            ]
            for row in range(40):
                for connection, kind in zip(connections, kinds, strict=True):
                    data = (store.serialize_ros1 if version == 1 else store.serialize_cdr)(
                        _message(store, kind, row, version), kind
                    )
                    writer.write(connection, _START_S * 10**9 + row * 100_000_000, bytes(data))
        yield (
            path.read_bytes()
            if path.is_file()
            else next(p for p in path.iterdir() if p.suffix != ".yaml").read_bytes()
        )


def _message(store: Any, kind: str, row: int, version: int) -> Any:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](
        sec=_START_S + row // 10, nanosec=row % 10 * 100_000_000
    )
    header = types["std_msgs/msg/Header"](
        **({"seq": row} if version == 1 else {}), stamp=stamp, frame_id="base"
    )
    if kind.endswith("Imu"):
        vector = types["geometry_msgs/msg/Vector3"](x=0.1, y=0.2, z=9.8)
        turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
        nine = np.zeros(9)
        return types[kind](header, turn, nine, vector, nine, vector, nine)
    status = types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
    return types[kind](header, status, 48.0 + row * 1e-5, 11.0, 500.0, np.ones(9), 2)


def seeds(target: str, data: Path) -> list[bytes]:
    """Return all logs that fuzzing of a target starts from."""
    with tempfile.TemporaryDirectory() as folder:
        return [log for log in (*made(target, Path(folder)), *real(target, data)) if log]
