"""One flight out of a table of many: a recording holds what one receiver says."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from spoofbench.arrays import Bools
from spoofbench.conversion import Rejects
from spoofbench.errors import ConversionError
from spoofbench_converters.table import cells
from spoofbench_converters.table.text import CellBatch

MAX_STRAY_ROWS = 2
"""So many rows of one other flight are taken for damage; more are another flight."""

_OTHER = "of another flight"


class FlightChoice:
    """Keeps the rows of one flight.

    Args:
        columns: names of those that tell flights apart; a table may lack some, and cells may be
            empty.
        flight: words that each stand in one of them; None: all rows must be of one flight, that of
            most of the first rows.

    Attributes:
        told: by column, the words that stood there in the rows that were kept.
    """

    def __init__(self, columns: tuple[str, ...], flight: str | None) -> None:
        self._columns = columns
        self._words = tuple(flight.split()) if flight is not None else ()
        self._strays: dict[str, Counter[str]] = {name: Counter() for name in columns}
        self.told: dict[str, tuple[str, ...]] = {}

    def keep(self, batch: CellBatch) -> Iterator[CellBatch | Rejects]:
        """Yield the flight's rows, and the others as rejects.

        Raises:
            ConversionError: the rows are of several flights, and none was chosen.
        """
        import pyarrow as pa
        import pyarrow.compute as pc

        there = {
            name: cells.words(batch.columns[name])
            for name in self._columns
            if name in batch.columns
        }
        kept = self._chosen(there, batch.offsets.size) if self._words else self._only(there)
        kept = kept if there else np.ones(batch.offsets.size, bool)
        mask = pa.array(kept)
        for name, words in there.items():
            found = pc.unique(pc.drop_null(pc.filter(words, mask))).to_pylist()
            self.told[name] = tuple(dict.fromkeys([*self.told.get(name, ()), *found]))
        if kept.all():
            yield batch
            return
        columns = {name: pc.filter(column, mask) for name, column in batch.columns.items()}
        yield Rejects(batch.offsets[~kept], batch.lengths[~kept], _OTHER)
        yield CellBatch(columns, batch.offsets[kept], batch.lengths[kept], batch.besides)

    def _chosen(self, there: Mapping[str, Any], count: int) -> Bools:
        """Which rows have all of the words, each in one column or another."""
        kept = np.ones(count, bool)
        for word in self._words:
            is_told = np.zeros(count, bool)
            for words in there.values():
                is_told |= cells.matches(words, (word,))
            kept &= is_told
        return kept

    def _only(self, there: Mapping[str, Any]) -> Bools:
        """Which rows are of the flight that the first rows are of.

        Raises:
            ConversionError: too many are not.
        """
        import pyarrow.compute as pc

        kept: Any = True
        for name, words in there.items():
            counts = Counter(words.drop_null().to_pylist())
            if not counts:
                continue
            known = self.told.get(name) or (counts.most_common(1)[0][0],)
            kept = kept & np.asarray(
                pc.fill_null(pc.equal(words, known[0]), True).to_numpy(zero_copy_only=False), bool
            )
            self._strays[name] += Counter({w: n for w, n in counts.items() if w != known[0]})
            if any(rows > MAX_STRAY_ROWS for rows in self._strays[name].values()):
                raise ConversionError(self._several(name, known[0]))
        first = next(iter(there.values()), None)
        return np.asarray(np.ones(0 if first is None else len(first), bool) & kept)

    def _several(self, name: str, known: str) -> str:
        words = [known, *(word for word, _ in self._strays[name].most_common())]
        return (
            f"the table holds several flights: {name!r} is {', '.join(map(repr, words[:3]))}"
            f"{', ...' if len(words) > 3 else ''}; choose one with -p flight={known}"
        )
