"""What a receiver's rows say: which of them have a fix, and how fast it moves."""

import numpy as np

from spoofbench.arrays import Bools, Floats
from spoofbench.schema.v1 import gnss_pb2
from spoofbench.table import Table

# a dead-reckoned solution is the inertial sensors' own: compared with them, it agrees with itself
_NO_FIX = (gnss_pb2.FIX_TYPE_NONE, gnss_pb2.FIX_TYPE_DEAD_RECKONING, gnss_pb2.FIX_TYPE_TIME_ONLY)
_LARGEST_COURSE_DEG = 1e9


def lacks_fix(pvt: Table) -> Bools:
    """Return where the fix type says that GNSS gives no position and velocity, ``(n,)``.

    That is no fix, time alone, or dead reckoning. A row without a fix type is taken for a fix.
    """
    return np.asarray(np.isin(pvt["fix_type"], _NO_FIX) & pvt.valid("fix_type"))


def velocity_ned(pvt: Table, course_deg: Floats | None = None) -> Floats:
    """Return the velocity that a receiver reports, NED, m/s, ``(n, 3)``; NaN is unknown.

    North and east are the reported components; in rows that lack either, they are taken from speed
    and course. Down is as reported, and so unknown where only speed and course are.

    Args:
        pvt: rows of kind ``gnss/pvt``.
        course_deg: clockwise from true north, ``(n,)``, in place of the reported course.
    """
    course = pvt["course_deg"] if course_deg is None else course_deg
    course = np.radians(np.where(np.abs(course) < _LARGEST_COURSE_DEG, course, np.nan))
    north, east, down = (pvt[f"vel_{axis}_mps"] for axis in "ned")
    lacking = np.isnan(north) | np.isnan(east)
    return np.column_stack(
        [
            np.where(lacking, pvt["speed_mps"] * np.cos(course), north),
            np.where(lacking, pvt["speed_mps"] * np.sin(course), east),
            down,
        ]
    )
