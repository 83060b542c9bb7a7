"""Converter of the logs of phone apps.

GnssLogger and GPSTest, Sensor Logger, SensorLog, phyphox, and the tables of the Smartphone
Decimeter Challenge.
"""

from collections.abc import Iterator, Sequence
from typing import Literal

from spoofbench.conversion import Item, SizeHint, Source
from spoofbench.errors import ConversionError, SpoofbenchError
from spoofbench_converters.phone import gnsslogger, gsdc, phyphox, sensorlog, sensorlogger
from spoofbench_converters.phone.contract import Options
from spoofbench_converters.phone.files import PhoneFile, laid_out, parts_of, text_parts

__all__ = ["UNIT", "VERSION", "Options", "convert", "sniff"]

VERSION = "1"
UNIT: Literal["bytes", "records"] = "bytes"

_OF_FOLDERS = (gsdc, sensorlogger, phyphox)
_FORMATS = (*_OF_FOLDERS, gnsslogger, sensorlog)


def sniff(source: Source) -> float:
    """Return how sure it is that a log is of one of the apps: a file, a zip archive with a file of
    theirs, or a folder of one recording.

    A folder is one recording where the tables lie in it itself, not below it, and no two say the
    same; others are to be walked.
    """
    try:
        parts = text_parts(parts_of(source))
        if source.path.is_dir():
            return _of_folder([part for part in parts if "/" not in part.name])
        return max(float(form.sniff(parts)) for form in _FORMATS)
    except SpoofbenchError:  # an archive that is damaged
        return 0.0


def _of_folder(parts: Sequence[PhoneFile]) -> float:
    best = max(_OF_FOLDERS, key=lambda form: form.sniff(parts))
    score: float = best.sniff(parts)
    if score:
        best.tables(parts)  # fails where they are of several recordings
    return score


def convert(source: Source, options: Options) -> Iterator[Item]:
    """Yield what a log holds; see :class:`spoofbench.conversion.Converter`."""
    parts = parts_of(source)
    text = text_parts(parts)
    best = max(_FORMATS, key=lambda form: form.sniff(text))
    if not best.sniff(text):
        raise ConversionError(
            f"{source.path.name!r} is of no phone app that is known: GnssLogger, Sensor Logger, "
            "SensorLog, phyphox, GSDC"
        )
    if parts[0].name:
        parts = laid_out(parts)
        yield SizeHint(sum(part.size for part in parts))
    yield from best.convert(parts, options)
