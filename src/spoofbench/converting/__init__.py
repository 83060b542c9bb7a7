"""Converting: a raw log in, a recording and a loss ledger out."""

from spoofbench.converting.contract import (
    Block,
    Converter,
    Exporting,
    Extent,
    Facts,
    Item,
    Options,
    Reject,
    Rejects,
)
from spoofbench.converting.ledger import Ledger
from spoofbench.converting.ordering import Columns, InOrder
from spoofbench.converting.running import NotRecognised, convert, recognise
from spoofbench.converting.sources import Member, Source

__all__ = [
    "Block",
    "Columns",
    "Converter",
    "Exporting",
    "Extent",
    "Facts",
    "InOrder",
    "Item",
    "Ledger",
    "Member",
    "NotRecognised",
    "Options",
    "Reject",
    "Rejects",
    "Source",
    "convert",
    "recognise",
]
