"""Converting: a raw log in, a recording and a loss ledger out."""

from spoofbench.conversion.contract import (
    Block,
    Converter,
    Exporting,
    Item,
    Options,
    Reject,
    Rejects,
    SizeHint,
    SourceMetadata,
)
from spoofbench.conversion.convert import NotRecognised, convert, detect_format
from spoofbench.conversion.ledger import Ledger
from spoofbench.conversion.rows import Columns, TimeSorter
from spoofbench.conversion.sources import Member, Source

__all__ = [
    "Block",
    "Columns",
    "Converter",
    "Exporting",
    "Item",
    "Ledger",
    "Member",
    "NotRecognised",
    "Options",
    "Reject",
    "Rejects",
    "SizeHint",
    "Source",
    "SourceMetadata",
    "TimeSorter",
    "convert",
    "detect_format",
]
