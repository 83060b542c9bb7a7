"""The converter's contract: a raw log in; rows, rejects and metadata out; every unit accounted for.

A converter is a module (or object) behind an entry point of the group ``spoofbench.converters``.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from spoofbench.conversion.sources import Source
from spoofbench.recording import Recording
from spoofbench.table import Table

DETAILED_REJECTS = 10_000


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
    """How many units the source holds, as far as known beforehand: for progress alone."""

    units: int


@dataclass(frozen=True, slots=True)
class SourceMetadata:
    """Metadata from the log: ``primary``, ``source/<name>``, ``recording``; later ones win."""

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


@dataclass(slots=True)
class Ledger:
    """An account of one conversion, filled while it runs.

    Attributes:
        unit: what is counted: bytes, or records of a container.
        used: units that gave rows.
        reasons: units skipped, by reason; complete.
        rejects: the first 10,000 rejects in detail.
        rows: rows written, by topic.
    """

    unit: Literal["bytes", "records"]
    used: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    rejects: list[Reject] = field(default_factory=list)
    rows: Counter[str] = field(default_factory=Counter)

    @property
    def skipped(self) -> int:
        """Units that gave no rows."""
        return self.reasons.total()

    def enter(self, item: Block | Used | Reject | Rejects) -> None:
        """Account for one part of the source."""
        if isinstance(item, Used):
            self.used += item.units
            return
        if isinstance(item, Block):
            self.used += item.used
            if len(item.table):
                self.rows[item.topic] += len(item.table)
            return
        many = (
            item
            if isinstance(item, Rejects)
            else Rejects(np.array([item.offset]), np.array([item.length]), item.reason)
        )
        if many.offsets.size:
            self.reasons[many.reason] += int(many.lengths.sum())
        room = DETAILED_REJECTS - len(self.rejects)
        if room > 0:
            self.rejects += [
                Reject(offset, length, many.reason)
                for offset, length in zip(
                    many.offsets[:room].tolist(), many.lengths[:room].tolist(), strict=True
                )
            ]

    @property
    def skipped_share(self) -> float | None:
        """Share of all units that gave no rows; None where there were none."""
        units = self.used + self.skipped
        return self.skipped / units if units else None

    def as_dict(self) -> dict[str, Any]:
        """Return the ledger for machines."""
        return {
            "unit": self.unit,
            "used": self.used,
            "skipped": self.skipped,
            "reasons": dict(sorted(self.reasons.items())),
            "rows": dict(sorted(self.rows.items())),
            "rejects": [
                {"offset": r.offset, "length": r.length, "reason": r.reason} for r in self.rejects
            ],
        }

    def as_text(self) -> str:
        """Return the ledger for people: units, rows by topic, and what was skipped, the largest
        loss first.
        """
        lines = [f"{self.used:,} {self.unit} used, {self.skipped:,} skipped"]
        lines += [f"{count:>12,} rows     {topic}" for topic, count in sorted(self.rows.items())]
        lines += [
            f"{count:>12,} skipped  {reason}"
            for reason, count in sorted(self.reasons.items(), key=lambda item: (-item[1], item[0]))
        ]
        return "\n".join(lines)

    def as_metadata(self) -> dict[str, str]:
        """Return the ledger as a metadata record, its lists and mappings as JSON text."""
        return {
            name: value if isinstance(value, str) else json.dumps(value)
            for name, value in self.as_dict().items()
        }

    @classmethod
    def of_metadata(cls, record: Mapping[str, str]) -> Self:
        """Return the ledger that :meth:`as_metadata` wrote.

        Raises:
            ValueError, KeyError: the record is not a ledger.
        """
        return cls(
            "bytes" if record["unit"] == "bytes" else "records",
            int(record["used"]),
            Counter(json.loads(record["reasons"])),
            [Reject(**reject) for reject in json.loads(record["rejects"])],
            Counter(json.loads(record["rows"])),
        )
