"""GPS time and UTC (IS-GPS-200, section 3.3.4; leap seconds of IERS Bulletin C)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

SECOND_NS = 1_000_000_000
DAY_NS = 86_400 * SECOND_NS
WEEK_NS = 7 * DAY_NS
ROLLOVER_NS = 1024 * WEEK_NS
"""The legacy navigation message counts weeks in ten bits."""
GPS_EPOCH_NS = 315_964_800 * SECOND_NS
"""1980-01-06 UTC, Unix nanoseconds."""

_STEPS_NS = np.array(  # days before which a second was inserted
    [
        "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01",
        "1991-01-01", "1992-07-01", "1993-07-01",
        "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01",
        "2012-07-01", "2015-07-01", "2017-01-01",
    ],
    "datetime64[ns]",
).astype(np.int64)  # fmt: skip
LEAP_SECONDS = int(_STEPS_NS.size)
"""GPS time minus UTC since the last announced leap second."""


def leap_seconds(utc_ns: ArrayLike) -> NDArray[np.int64]:
    """Return announced GPS time minus UTC, in s, at Unix times in ns."""
    return np.asarray(np.searchsorted(_STEPS_NS, np.asarray(utc_ns, np.int64), "right"), np.int64)


def leap_seconds_at_gps(gps_ns: ArrayLike) -> NDArray[np.int64]:
    """Return announced GPS time minus UTC, in s, at GPS times in ns since 1980-01-06."""
    steps = _STEPS_NS - GPS_EPOCH_NS + np.arange(1, _STEPS_NS.size + 1) * SECOND_NS
    return np.asarray(np.searchsorted(steps, np.asarray(gps_ns, np.int64), "right"), np.int64)
