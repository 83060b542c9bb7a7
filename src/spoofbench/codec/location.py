"""The derived view for maps: a ``foxglove.LocationFix`` beside every row of a PVT topic that has a
position.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.table import Table


def location_fixes(frame_id: str, table: Table) -> tuple[NDArray[np.int64], list[bytes]]:
    """Return the times and the encoded messages of the rows with latitude and longitude.

    Altitude is on the ellipsoid, NaN where absent; the covariance, row-major ENU in m^2, is given
    where all of it is known.
    """
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    rows = np.flatnonzero(table.valid("lat_deg") & table.valid("lon_deg"))
    times = table.time_ns[rows]
    position = np.stack([table[name][rows] for name in ("lat_deg", "lon_deg", "height_m")], axis=1)
    nn, ne, nd, ee, ed, dd = (
        table[f"cov_{pair}_m2"][rows] for pair in ("nn", "ne", "nd", "ee", "ed", "dd")
    )
    covariance = np.stack([ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd], axis=1)
    known = np.isfinite(covariance).all(axis=1)
    messages = []
    for row, time in enumerate(times.tolist()):
        fix: Any = LocationFix(frame_id=frame_id)
        fix.timestamp.seconds, fix.timestamp.nanos = divmod(time, 1_000_000_000)
        fix.latitude, fix.longitude, fix.altitude = position[row].tolist()
        if known[row]:
            fix.position_covariance.extend(covariance[row].tolist())
            fix.position_covariance_type = LocationFix.KNOWN
        messages.append(fix.SerializeToString(deterministic=True))
    return times, messages
