"""What the sessions gave, as the cells of the reproduction ask for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench_papers.borio.recordings import WINDOWS_S, Session
from spoofbench_papers.borio.statistics import FOUR, THRESHOLD, Row, Series, Values, unrelated

DRIVE = "drive"


@dataclass(frozen=True, slots=True)
class Findings:
    """Sessions by name, the values of each statistic, and the tables that are written."""

    sessions: Mapping[str, Session]
    values: Values
    tables: Mapping[str, Sequence[Row]]

    def row(self, table: str, **wanted: Any) -> Row:
        """Return the one row of a table that has these values."""
        return next(
            row
            for row in self.tables[table]
            if all(row[key] == value for key, value in wanted.items())
        )

    def median(self, name: str, statistic: str) -> float:
        """Genuine median of a statistic that is available."""
        return float(np.median(self.values[name, "genuine", statistic].value))

    @property
    def long(self) -> list[str]:
        """Sessions whose window is the paper's."""
        return [
            name
            for name, session in self.sessions.items()
            if session.inertial and session.window_s == WINDOWS_S[0]
        ]

    @property
    def telling(self) -> list[str]:
        """Those of them whose genuine medians all exceed the paper's threshold: elsewhere a low
        value says nothing of spoofing.
        """
        return [
            name
            for name in self.long
            if min(self.median(name, statistic) for statistic in FOUR) > THRESHOLD
        ]

    def pooled(
        self, pairs: Sequence[tuple[str, str]], statistics: Sequence[str]
    ) -> NDArray[np.float64]:
        """Values of statistics in cases of sessions."""
        return np.concatenate(
            [
                self.values[name, case, statistic].value
                for name, case in pairs
                for statistic in statistics
            ]
        )

    def unrelated(self, names: Sequence[str]) -> list[tuple[str, str]]:
        """Sessions and their cases in which GNSS is of another time or run."""
        return [(name, case) for name in names for case in unrelated(self.values, name)]


def together(a: Series, b: Series) -> tuple[Series, Series]:
    """Both at the times at which both are available."""
    _, i, j = np.intersect1d(a.time_s, b.time_s, return_indices=True)
    return Series(a.time_s[i], a.value[i]), Series(b.time_s[j], b.value[j])
