"""Converter of the logs of phone apps.

GnssLogger and GPSTest, Sensor Logger, SensorLog, phyphox, and the tables of the Smartphone Decimeter Challenge.
"""

from collections.abc import Iterator
from typing import Literal

from spoofbench.converting import Extent, Item, Source
from spoofbench.errors import ConversionError
from spoofbench_converters.phone import gnsslogger, gsdc, phyphox, sensorlog, sensorlogger
from spoofbench_converters.phone.options import Options
from spoofbench_converters.phone.parts import parts_of, text_parts

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "1"
UNIT: Literal["bytes", "records"] = "bytes"

_FORMATS = (gnsslogger, sensorlogger, sensorlog, phyphox, gsdc)


def sniff(source: Source) -> float:
    """Return how sure it is that a log is of one of the apps: a file, or a folder or zip archive with a file of theirs."""
    parts = text_parts(parts_of(source))
    return max((form.sniff(parts) for form in _FORMATS), default=0.0)


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a log holds; see :class:`spoofbench.converting.Converter`."""
    parts = parts_of(source)
    text = text_parts(parts)
    scores = {form: form.sniff(text) for form in _FORMATS}
    best = max(scores, key=lambda form: scores[form])
    if not scores[best]:
        raise ConversionError(f"{source.path.name!r} is of no phone app that is known: GnssLogger, Sensor Logger, SensorLog, phyphox, GSDC")
    if any(part.size for part in parts):
        yield Extent(sum(part.size for part in parts))
    yield from best.convert(parts, options)
