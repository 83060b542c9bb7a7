"""Converter of logs of u-blox receivers: UBX frames, and NMEA sentences among them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from spoofbench.converting import Item, Source
from spoofbench_converters.nmea.decoder import NmeaDecoder
from spoofbench_converters.nmea.options import DecoderOptions
from spoofbench_converters.stream.conversion import Conversion
from spoofbench_converters.stream.options import StreamOptions
from spoofbench_converters.stream.sniffing import beginning
from spoofbench_converters.ubx.decoder import UbxDecoder

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "1"
UNIT: Literal["bytes"] = "bytes"


@dataclass(frozen=True, kw_only=True)
class Options(DecoderOptions, StreamOptions):
    """How a log is converted; see the two classes that it joins. ``source`` is of the sentences."""

    def __post_init__(self) -> None:
        DecoderOptions.__post_init__(self)
        StreamOptions.__post_init__(self)


def sniff(source: Source) -> float:
    """Return 0.5 to 0.95, by the share of valid frames, for a source that begins with at least one UBX frame; else 0."""
    found = beginning(source)
    return found.score() if found.ubx else 0.0


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a log holds; see :class:`spoofbench.converting.Converter`."""
    with source.open() as stream:
        yield from Conversion([UbxDecoder(), NmeaDecoder(options)], options).run(stream, source.path.name)
