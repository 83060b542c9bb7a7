"""Tracks for maps: GPX 1.1, a track per receiver (https://www.topografix.com/GPX/1/1/)."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl

import numpy as np
from numpy.typing import NDArray

from spoofbench import __version__
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

SEGMENT_GAP_S = 10.0
"""A longer one ends a segment: the receiver was lost or switched off, and no line may be drawn."""

_FIXES: Mapping[int, str] = {
    gnss_pb2.FIX_TYPE_NONE: "none",
    gnss_pb2.FIX_TYPE_2D: "2d",
    gnss_pb2.FIX_TYPE_3D: "3d",
    gnss_pb2.FIX_TYPE_DIFFERENTIAL: "dgps",
}
_NONE: "AttributesImpl[str]" = AttributesImpl({})
_COLUMNS = ("height_msl_m", "height_m", "num_sv", "hdop", "vdop", "pdop", "diff_age_s")


def write_gpx(tracks: Iterable[tuple[str, Table]], path: Path) -> None:
    """Write the positions of ``gnss/pvt`` tables as tracks, each by its name.

    ``ele`` is the height above mean sea level, absent where the receiver said none; rows without a
    position give no point and end a segment.
    """
    with path.open("w", encoding="utf-8") as file:
        xml = XMLGenerator(file, "utf-8", short_empty_elements=True)
        xml.startDocument()
        xml.startElement(
            "gpx",
            AttributesImpl(
                {
                    "version": "1.1",
                    "creator": f"spoofbench {__version__}",
                    "xmlns": "http://www.topografix.com/GPX/1/1",
                }
            ),
        )
        for name, table in tracks:
            xml.characters("\n")
            xml.startElement("trk", _NONE)
            _text(
                xml,
                "name",
                "".join(
                    letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}"
                    for letter in name
                ),
            )
            for rows in _segments(table):
                xml.characters("\n")
                xml.startElement("trkseg", _NONE)
                for point in _points(table.take(rows)):
                    _point(xml, *point)
                xml.endElement("trkseg")
            xml.endElement("trk")
        xml.endElement("gpx")
        xml.endDocument()


def _segments(table: Table) -> list[NDArray[np.intp]]:
    """Return the rows of each unbroken stretch."""
    lat, lon = table["lat_deg"], table["lon_deg"]
    rows = np.flatnonzero((np.abs(lat) <= 90) & (np.abs(lon) <= 180))
    if not rows.size:
        return []
    breaks = (np.diff(rows) > 1) | (np.diff(table.time_ns[rows]) > SEGMENT_GAP_S * 1e9)
    return np.split(rows, np.flatnonzero(breaks) + 1)


def _points(table: Table) -> Iterator[tuple[str, str, dict[str, str]]]:
    """Yield latitude, longitude and, in the order of the standard, what a point holds; absent is
    left out.
    """
    times = np.datetime_as_string(table.time_ns.astype("datetime64[ns]"))
    columns: dict[str, Any] = {
        name: np.where(table.valid(name), table[name], np.nan) for name in _COLUMNS
    }
    geoid = columns["height_m"] - columns["height_msl_m"]
    fixes = np.where(table.valid("fix_type"), table["fix_type"], gnss_pb2.FIX_TYPE_UNSPECIFIED)
    for i in range(len(table)):
        said: dict[str, Any] = {
            "ele": columns["height_msl_m"][i],
            "time": f"{times[i]}Z",
            "geoidheight": geoid[i],
            "fix": _FIXES.get(int(fixes[i])),
            "sat": columns["num_sv"][i],
            **{name: columns[name][i] for name in ("hdop", "vdop", "pdop")},
            "ageofdgpsdata": columns["diff_age_s"][i],
        }
        yield (
            _decimal(table["lat_deg"][i]),
            # the standard leaves out 180
            _decimal(-180.0 if table["lon_deg"][i] == 180 else table["lon_deg"][i]),
            {
                name: value if isinstance(value, str) else _decimal(value)
                for name, value in said.items()
                if _is_said(value)
            },
        )


def _is_said(value: Any) -> bool:
    return isinstance(value, str) or (value is not None and bool(np.isfinite(value)))


def _decimal(value: float) -> str:
    return np.format_float_positional(value, trim="-")


def _point(xml: XMLGenerator, lat: str, lon: str, said: Mapping[str, str]) -> None:
    xml.characters("\n")
    xml.startElement("trkpt", AttributesImpl({"lat": lat, "lon": lon}))
    for name, text in said.items():
        _text(xml, name, text)
    xml.endElement("trkpt")


def _text(xml: XMLGenerator, name: str, text: str) -> None:
    xml.startElement(name, _NONE)
    xml.characters(text)
    xml.endElement(name)
