"""What the checks of attacks work on: recordings to attack, and degraded ones."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache

import numpy as np

from spoofbench.recording import Interval, Recording
from spoofbench.table import Table
from spoofbench.testing.recordings import drive


@cache
def examples() -> Mapping[str, tuple[Recording, tuple[Recording, ...]]]:
    """The recordings that are attacked, each with its donors."""
    long, quick, other = (
        drive(1, 420.0),
        drive(2, 60.0, 10.0, second_sources=True),
        drive(3, 90.0, 10.0),
    )
    return {
        "a drive at 1 Hz": (long, ()),
        "a drive at 1 Hz with a donor": (long, (drive(4, 240.0),)),
        "a drive at 10 Hz with second sources": (quick, ()),
        "a drive at 10 Hz with a donor": (quick, (other,)),
        "a drive without velocity": (_without(long, "vel_n_mps", "vel_e_mps", "vel_d_mps"), ()),
        "a drive without position": (_without(long, "lat_deg", "lon_deg", "height_m"), ()),
        "a drive with speed and course": (_as_nmea(long), ()),
    }


def _each_pvt(recording: Recording, change: Callable[[Table], Table]) -> Recording:
    return recording.replace(
        {topic: change(recording[topic]) for topic in recording.topics("gnss/pvt")}
    )


def _without(recording: Recording, *names: str) -> Recording:
    return _each_pvt(recording, lambda table: table.replace(**dict.fromkeys(names)))


def _as_nmea(recording: Recording) -> Recording:
    """Speed in knots and, above one, course instead of velocity, and both heights, with the
    decimals of NMEA sentences.
    """

    def change(table: Table) -> Table:
        north, east = table["vel_n_mps"], table["vel_e_mps"]
        height = np.round(table["height_m"], 1)
        knots = np.round(np.hypot(north, east) * 3600 / 1852, 2)
        course = np.round(np.degrees(np.arctan2(east, north)) % 360, 2) % 360
        return table.replace(
            speed_mps=knots * (1852 / 3600),
            course_deg=np.where(knots > 1, course, np.nan),
            lat_deg=np.round(table["lat_deg"] * 60, 5) / 60,
            lon_deg=np.round(table["lon_deg"] * 60, 5) / 60,
            height_m=height,
            height_msl_m=np.round(height - 47.3, 1),
            vel_n_mps=None,
            vel_e_mps=None,
            vel_d_mps=None,
        )

    return _each_pvt(recording, change)


def inner(span: Interval) -> Interval:
    """A window in the last third."""
    third = (span.end_ns - span.start_ns) // 3
    return Interval(span.end_ns - third, span.end_ns - third // 2)


def degraded_recordings(
    recording: Recording,
) -> Iterator[tuple[str, Recording, Sequence[Recording]]]:
    """The recording in many poor states, each with a name and donors."""

    def each(change: Callable[[Table], Table]) -> Recording:
        return _each_pvt(recording, change)

    def nothing(table: Table) -> Table:
        return Table(table.kind.name, table.time_ns, {})

    def bare(table: Table) -> Table:
        return table.replace(
            **{name: np.full(len(table), np.nan) for name in table if table[name].dtype.kind == "f"}
        )

    def still(table: Table) -> Table:
        return table.replace(
            **{name: np.zeros(len(table)) for name in table if table[name].dtype.kind == "f"}
        )

    window = inner(recording.span)
    yield (
        "a recording without PVT",
        recording.replace(dict.fromkeys(recording.topics("gnss/pvt"))),
        (),
    )
    yield "a recording with an empty PVT table", each(lambda table: table.take(slice(0, 0))), ()
    yield "a recording of one PVT row", each(lambda table: table.take(slice(0, 1))), ()
    yield "a recording whose PVT rows are empty", each(nothing), ()
    yield "a recording without a fix", each(bare), ()
    yield "a recording of zeros", each(still), ()
    yield (
        "a recording with a gap for a window",
        each(lambda table: table.take(~window.covers(table.time_ns))),
        (),
    )
    yield (
        "a recording with every epoch twice",
        each(lambda table: table.take(np.repeat(np.arange(len(table)), 2))),
        (),
    )
    yield (
        "a donor without PVT",
        recording,
        (recording.replace(dict.fromkeys(recording.topics("gnss/pvt"))),),
    )
    yield "a donor of one row", recording, (each(lambda table: table.take(slice(0, 1))),)
    yield "a donor whose rows are empty", recording, (each(nothing),)
