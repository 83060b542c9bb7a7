"""What receivers claim of time."""

import numpy as np
from numpy.typing import NDArray

from spoofbench.gnss_time import GPS_EPOCH_NS, ROLLOVER_NS, SECOND_NS, WEEK_NS
from spoofbench.table import Table

ROLLOVER_S = ROLLOVER_NS // SECOND_NS


def claimed_gps_s(table: Table) -> NDArray[np.float64]:
    """Return the GPS time that a ``gnss/pvt`` table claims, in seconds since 1970 as if it were
    UTC; ``(n,)``, NaN where unknown.
    """
    week = np.where(table.valid("gps_week"), table["gps_week"].astype(np.float64), np.nan)
    return np.asarray(GPS_EPOCH_NS / SECOND_NS + week * (WEEK_NS / SECOND_NS) + table["tow_s"])
