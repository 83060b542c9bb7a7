"""The converter's contract: a raw log in; rows, rejects and facts out; every byte or record
accounted for.

A converter is a module (or object) behind an entry point of the group ``spoofbench.converters``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion.sources import Source
from spoofbench.recording import Recording
from spoofbench.table import Table


@dataclass(frozen=True, slots=True)
class Block:
    """Rows of one topic, in the order of time, and how much of the source they came from (bytes or
    records).
    """

    topic: str
    table: Table
    used: int


@dataclass(frozen=True, slots=True)
class Reject:
    """A part of the source that gave no rows: where, how much, and why.

    ``offset`` and ``length`` count the converter's unit (bytes, or records of a container).
    """

    offset: int
    length: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Rejects:
    """Many rejects of one reason: ``offsets`` and ``lengths``, int64 ``(n,)``."""

    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]
    reason: str


@dataclass(frozen=True, slots=True)
class Used:
    """Units of the source that told something, but belong to no block: headers, clocks, names."""

    units: int


@dataclass(frozen=True, slots=True)
class SizeHint:
    """How many units the source holds, as far as the converter knows beforehand: for progress
    alone.
    """

    units: int


@dataclass(frozen=True, slots=True)
class SourceMetadata:
    """Metadata that the converter learned: ``primary``, ``source/<name>``, ``recording``; later
    facts win.
    """

    metadata: Mapping[str, Mapping[str, str]]


Item = Block | Used | Reject | Rejects | SourceMetadata | SizeHint


class Options(Protocol):
    """A frozen dataclass of a converter's options, each with a default."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


class Converter(Protocol):
    """Reads one family of raw logs.

    Attributes:
        VERSION: changes whenever the same log would give other rows.
        UNIT: what the ledger counts.
        Options: dataclass of the options.
    """

    VERSION: str
    UNIT: Literal["bytes", "records"]
    Options: type[Any]

    def sniff(self, source: Source) -> float:
        """Return 0 (not mine) to 1 (certain), judged by content, never by name alone."""
        ...

    def convert(self, source: Source, options: Any) -> Iterator["Item"]:
        """Yield what the log holds, in file order, in bounded memory.

        Raises:
            ConversionError: the log as a whole cannot be converted.
        """
        ...


@runtime_checkable
class Exporting(Protocol):
    """What a converter can do besides: write a recording the way that a mapping describes its
    tables.
    """

    def export(self, recording: Recording, mapping: str, out: Path) -> tuple[Path, ...]:
        """Write the table, or the folder of tables, from which the mapping would give these rows;
        return the files.

        Args:
            recording: what to write.
            mapping: path of a mapping, or the name of a ready one.
            out: what to write to.

        Raises:
            ConversionError: there is no such mapping, or the recording has not what it names.
        """
        ...
