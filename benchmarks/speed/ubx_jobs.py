"""UBX logs to columns and to MCAP, against pyubx2 and hilspy.

The peers parse every frame to its fields, as their interfaces have it; ours also joins epochs, lays
out the time axis and keeps the ledger. hilspy (on the Rust crate ublox) decodes NAV-PVT, SAT, ATT,
DOP, CLOCK, TIMEGPS, EOE, VELECEF, RXM-RAWX, SFRBX, ESF-INS and STATUS of what is in these logs, and
hands over the bare payload of NAV-SIG, POSECEF and MON-RF. To MCAP the peers write rows of
``gnss/pvt``, ``gnss/signal`` and ``gnss/observation`` alone. They do a part of the log; times are
per byte.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from spoofbench_converters import ubx

from benchmarks.speed.frame import Job
from benchmarks.speed.streams import Columns, Message, columns, file, log_of, pair_file, part_of
from spoofbench.schema.v1.gnss_pb2 import Observation, Pvt, Signal

LOGS = (
    "navsol_F9T_5min_static.ubx",
    "rtkexp_walk_0827.ubx",
    "las_220114_0121_drive.ubx",
    "las_220110_0655_drive.ubx",
)
PYUBX2_BYTES, HILSPY_BYTES = 1_000_000, 8_000_000


def jobs(folder: Path) -> Iterator[Job]:
    """Yield the UBX jobs."""
    log, what = log_of(LOGS, folder, "ubx")
    (small, small_share), (large, large_share) = (
        part_of(log, PYUBX2_BYTES),
        part_of(log, HILSPY_BYTES),
    )
    shares = {"pyubx2": small_share, "hilspy": large_share}
    timed = f"{what}; pyubx2 {100 * small_share:.0f} % of it, hilspy {100 * large_share:.0f} %"
    peers = {"pyubx2": partial(_pyubx2, small), "hilspy": partial(_hilspy, large)}
    yield Job(
        "ubx-to-columns",
        f"{timed}, to columns",
        partial(columns, ubx, log),
        peers,
        check=_same,
        parts=shares,
    )
    ours = partial(file, log, folder / "ours.mcap", "ubx")
    writers = {
        "pyubx2": partial(pair_file, partial(_pyubx2_messages, small), folder / "pyubx2.mcap")
    }
    writers |= {
        "hilspy": partial(pair_file, partial(_hilspy_messages, large), folder / "hilspy.mcap")
    }
    yield Job("ubx-to-mcap", f"{timed}, to a closed file, zstd", ours, writers, parts=shares)


def _pyubx2(log: Path) -> list[Any]:
    from pyubx2 import ERR_IGNORE, UBX_PROTOCOL, UBXReader

    with log.open("rb") as stream:
        return [
            parsed
            for _, parsed in UBXReader(stream, protfilter=UBX_PROTOCOL, quitonerror=ERR_IGNORE)
        ]


def _hilspy(log: Path) -> list[Any]:
    import hilspy

    with hilspy.open(f"file://{log}", "ubx") as channel:
        return [message.fields for message in channel]


def _same(ours: Columns, theirs: list[Any]) -> None:
    """Every NAV-PVT that the peer finds is a row of ours."""
    pvts = [
        one
        for one in theirs
        if getattr(one, "identity", "") == "NAV-PVT"
        or (isinstance(one, dict) and "lat" in one and "num_satellites" in one)
    ]
    rows = ours["/gnss0/gnss/pvt lat_deg"]
    if rows.size < len(pvts) or not pvts:
        raise AssertionError(f"{len(pvts)} NAV-PVT against {rows.size} rows")


def _pyubx2_messages(log: Path) -> Iterator[Message]:
    time_ns = 0
    for one in _pyubx2(log):
        if one.identity == "NAV-PVT":
            time_ns = _unix_ns(one.year, one.month, one.day, one.hour, one.min, one.second)
            yield (
                "/gnss0/gnss/pvt",
                time_ns,
                _pvt(
                    one.lat,
                    one.lon,
                    one.height / 1e3,
                    one.velN / 1e3,
                    one.velE / 1e3,
                    one.velD / 1e3,
                    one.numSV,
                ),
            )
        elif one.identity == "NAV-SAT":
            for n in range(1, one.numSvs + 1):
                svid, cn0, elevation = (
                    getattr(one, f"{name}_{n:02d}") for name in ("svId", "cno", "elev")
                )
                yield (
                    "/gnss0/gnss/signal",
                    time_ns,
                    Signal(svid=svid, cn0_dbhz=cn0, elevation_deg=elevation),
                )
        elif one.identity == "RXM-RAWX":
            for n in range(1, one.numMeas + 1):
                values = (
                    getattr(one, f"{name}_{n:02d}")
                    for name in ("svId", "prMes", "cpMes", "doMes", "cno")
                )
                yield "/gnss0/gnss/observation", time_ns, _observation(*values)


def _hilspy_messages(log: Path) -> Iterator[Message]:
    time_ns = 0
    import hilspy

    with hilspy.open(f"file://{log}", "ubx") as channel:
        for message in channel:
            one = message.fields
            if message.name == "NAV-PVT":
                time_ns = _unix_ns(
                    one["year"], one["month"], one["day"], one["hour"], one["min"], one["sec"]
                )
                velocity = (one["vel_north"], one["vel_east"], one["vel_down"])
                yield (
                    "/gnss0/gnss/pvt",
                    time_ns,
                    _pvt(one["lat"], one["lon"], one["height"], *velocity, one["num_satellites"]),
                )
            elif message.name == "NAV-SAT":
                for sv in one["svs"]:
                    yield (
                        "/gnss0/gnss/signal",
                        time_ns,
                        Signal(svid=sv["sv_id"], cn0_dbhz=sv["cno"], elevation_deg=sv["elev"]),
                    )
            elif message.name == "RXM-RAWX":
                for m in one["measurements"]:
                    yield (
                        "/gnss0/gnss/observation",
                        time_ns,
                        _observation(m["sv_id"], m["pr_mes"], m["cp_mes"], m["do_mes"], m["cno"]),
                    )


def _unix_ns(*utc: int) -> int:
    return int(datetime(*utc, tzinfo=UTC).timestamp()) * 10**9  # type: ignore[misc, arg-type]


def _pvt(
    lat: float, lon: float, height: float, north: float, east: float, down: float, satellites: int
) -> Pvt:
    return Pvt(
        lat_deg=lat,
        lon_deg=lon,
        height_m=height,
        num_sv=satellites,
        vel_n_mps=north,
        vel_e_mps=east,
        vel_d_mps=down,
    )


def _observation(
    svid: int, pseudorange: float, carrier: float, doppler: float, cn0: float
) -> Observation:
    return Observation(
        svid=svid,
        pseudorange_m=pseudorange,
        carrier_cycles=carrier,
        doppler_hz=doppler,
        cn0_dbhz=cn0,
    )
