"""Converter of logs of NMEA 0183 sentences, alone or with other data between them; UBX frames are
left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from spoofbench.conversion import Item, Source
from spoofbench_converters.nmea.decoder import DecoderOptions, NmeaDecoder
from spoofbench_converters.serial.contract import SerialOptions
from spoofbench_converters.serial.conversion import SerialConversion
from spoofbench_converters.serial.demux import beginning

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "1"
UNIT: Literal["bytes"] = "bytes"


@dataclass(frozen=True, kw_only=True)
class Options(DecoderOptions, SerialOptions):
    """How a log of sentences is converted; see the two classes that it joins."""

    def __post_init__(self) -> None:
        DecoderOptions.__post_init__(self)
        SerialOptions.__post_init__(self)


def sniff(source: Source) -> float:
    """Return 0.5 to 0.95, by the share of valid sentences, for a source that begins with some and
    with no UBX frame; else 0.
    """
    found = beginning(source)
    return found.confidence() if found.nmea and not found.ubx else 0.0


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a log holds; see :class:`spoofbench.conversion.Converter`."""
    with source.open() as stream:
        yield from SerialConversion([NmeaDecoder(options)], options).run(stream, source.path.name)
