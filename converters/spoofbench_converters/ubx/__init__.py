"""Converter of logs of u-blox receivers: UBX frames, and NMEA sentences among them, with the
options of NMEA logs.
"""

from collections.abc import Iterator
from typing import Literal

from spoofbench.conversion import Item, Source
from spoofbench_converters.nmea import Options
from spoofbench_converters.nmea.decoder import NmeaDecoder
from spoofbench_converters.serial.conversion import SerialConversion
from spoofbench_converters.serial.demux import beginning
from spoofbench_converters.ubx.decoder import UbxDecoder

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "1"
UNIT: Literal["bytes"] = "bytes"


def sniff(source: Source) -> float:
    """Return 0.5 to 0.95, by the share of valid frames, for a source that begins with at least one
    UBX frame; else 0.
    """
    found = beginning(source)
    return found.confidence() if found.ubx else 0.0


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a log holds; see :class:`spoofbench.conversion.Converter`."""
    with source.open() as stream:
        yield from SerialConversion([UbxDecoder(), NmeaDecoder(options)], options).run(
            stream, source.path.name
        )
