"""NMEA logs to columns and to MCAP, against pynmeagps and pynmea2.

The peers parse every sentence to its fields; ours also joins epochs, lays out the time axis and
keeps the ledger. To MCAP the peers write rows of ``gnss/pvt`` from GGA and RMC and of
``gnss/signal`` from GSV. They do a part of the log; times are per byte. pynmea2 gets the log line
by line, pynmeagps as a stream.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from spoofbench_converters import nmea

from benchmarks.speed.frame import Job
from benchmarks.speed.streams import Columns, Message, columns, file, log_of, pair_file, part_of
from spoofbench.schema.v1.gnss_pb2 import Pvt, Signal

LOGS = ("dotmorten_garmin_road.nmea", "qt_nmealog.nmea", "signalk_gps_walk.nmea")
PYNMEAGPS_BYTES, PYNMEA2_BYTES = 1_000_000, 5_000_000
_STEP_NS = 1_000_000


def jobs(folder: Path) -> Iterator[Job]:
    """Yield the NMEA jobs."""
    log, what = log_of(LOGS, folder, "nmea")
    (small, small_share), (large, large_share) = (
        part_of(log, PYNMEAGPS_BYTES),
        part_of(log, PYNMEA2_BYTES),
    )
    shares = {"pynmeagps": small_share, "pynmea2": large_share}
    timed = f"{what}; pynmeagps {100 * small_share:.0f} % of it, pynmea2 {100 * large_share:.0f} %"
    readers: dict[str, Callable[[], list[Any]]] = {
        "pynmeagps": partial(_pynmeagps, small),
        "pynmea2": partial(_pynmea2, large),
    }
    yield Job(
        "nmea-to-columns",
        f"{timed}, to columns",
        partial(columns, nmea, log),
        readers,
        check=_same,
        parts=shares,
    )
    writers = {
        name: partial(
            pair_file, partial(_messages, reader, name == "pynmea2"), folder / f"{name}.mcap"
        )
        for name, reader in readers.items()
    }
    ours = partial(file, log, folder / "ours.mcap", "nmea")
    yield Job("nmea-to-mcap", f"{timed}, to a closed file, zstd", ours, writers, parts=shares)


def _pynmeagps(log: Path) -> list[Any]:
    from pynmeagps import ERR_IGNORE, NMEAReader

    with log.open("rb") as stream:
        return [
            parsed for _, parsed in NMEAReader(stream, quitonerror=ERR_IGNORE) if parsed is not None
        ]


def _pynmea2(log: Path) -> list[Any]:
    import pynmea2 as peer

    parsed = []
    with log.open(encoding="ascii", errors="replace", newline="\n") as stream:
        for line in stream:
            with suppress(peer.ParseError, ValueError):
                parsed.append(peer.parse(line, check=True))
    return parsed


def _same(ours: Columns, theirs: list[Any]) -> None:
    """There is a row of ours for every GGA that the peer finds."""
    found = sum(getattr(one, "msgID", getattr(one, "sentence_type", "")) == "GGA" for one in theirs)
    rows = ours["/gnss0/gnss/pvt lat_deg"]
    if rows.size < found or not found:
        raise AssertionError(f"{found} GGA against {rows.size} rows")


def _messages(read: Callable[[], list[Any]], by_pynmea2: bool) -> Iterator[Message]:
    """Yield rows as a peer has them; a millisecond apart, as its sentences have no time of their
    own.
    """
    for place, one in enumerate(read()):
        time_ns = place * _STEP_NS
        kind = one.sentence_type if by_pynmea2 else one.msgID
        if kind in ("GGA", "RMC"):
            lat, lon = (one.latitude, one.longitude) if by_pynmea2 else (one.lat, one.lon)
            yield "/gnss0/gnss/pvt", time_ns, Pvt(lat_deg=float(lat or 0), lon_deg=float(lon or 0))
        elif kind == "GSV":
            names = (
                ("sv_prn_num_{}", "snr_{}", "elevation_deg_{}")
                if by_pynmea2
                else ("svid_{:02d}", "cno_{:02d}", "elv_{:02d}")
            )
            for n in range(1, 5):
                svid, cn0, elevation = (getattr(one, name.format(n), None) or 0 for name in names)
                if svid:
                    yield (
                        "/gnss0/gnss/signal",
                        time_ns,
                        Signal(svid=int(svid), cn0_dbhz=float(cn0), elevation_deg=float(elevation)),
                    )
