"""The loss ledger: what became of every unit of a source."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np

from spoofbench.conversion.contract import Block, Reject, Rejects, Used

DETAILED_REJECTS = 10_000


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
