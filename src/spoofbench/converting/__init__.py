"""Converting: a raw log in, a recording and a loss ledger out."""

from spoofbench.converting.contract import Block, Converter, Extent, Facts, Item, Options, Reject, Source
from spoofbench.converting.ledger import Ledger
from spoofbench.converting.ordering import Columns, InOrder
from spoofbench.converting.running import convert, recognise

__all__ = [
    "Block",
    "Columns",
    "Converter",
    "Extent",
    "Facts",
    "InOrder",
    "Item",
    "Ledger",
    "Options",
    "Reject",
    "Source",
    "convert",
    "recognise",
]
