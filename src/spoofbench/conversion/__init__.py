"""Converting: a raw log in, a recording and a loss ledger out."""

from spoofbench.conversion.contract import (
    Block,
    Converter,
    Exporting,
    Item,
    Ledger,
    Options,
    Reject,
    Rejects,
    SizeHint,
    SourceMetadata,
    Used,
)
from spoofbench.conversion.convert import NotRecognised, convert, detect_format
from spoofbench.conversion.rows import Columns, RowBatch, RowBuffer, TimeSorter
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
    "RowBatch",
    "RowBuffer",
    "SizeHint",
    "Source",
    "SourceMetadata",
    "TimeSorter",
    "Used",
    "convert",
    "detect_format",
]
