"""From the Earth-centred, Earth-fixed frame to geodetic coordinates and NED velocity."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def geodetic(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return ``lat_deg lon_deg height_m`` on WGS 84 and ``vel_n_mps vel_e_mps vel_d_mps``, each
    ``(n,)``.

    Args:
        columns: ``ecef_position[0..2]`` in metres, and, if there is a velocity,
            ``ecef_velocity[0..2]`` in m/s.
    """
    import pymap3d

    x, y, z = (columns[f"ecef_position[{place}]"] for place in range(3))
    if not x.size:
        return {}
    lat, lon, height = pymap3d.ecef2geodetic(x, y, z)
    found = {"lat_deg": lat, "lon_deg": lon, "height_m": height}
    if "ecef_velocity[0]" in columns:
        east, north, up = pymap3d.ecef2enuv(
            *(columns[f"ecef_velocity[{place}]"] for place in range(3)), lat, lon
        )
        found |= {"vel_n_mps": north, "vel_e_mps": east, "vel_d_mps": -up}
    absent = np.isnan(x + y + z)
    return {name: np.where(absent, np.nan, values) for name, values in found.items()}


def earth_centred(rows: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return ``ecef_position[0..2]`` and ``ecef_velocity[0..2]`` of rows: the reverse of
    :func:`geodetic`.
    """
    import pymap3d

    lat, lon = rows["lat_deg"], rows["lon_deg"]
    position = pymap3d.geodetic2ecef(lat, lon, rows["height_m"])
    velocity = pymap3d.enu2uvw(rows["vel_e_mps"], rows["vel_n_mps"], -rows["vel_d_mps"], lat, lon)
    triples = (("ecef_position", position), ("ecef_velocity", velocity))
    return {
        f"{name}[{place}]": np.asarray(values)
        for name, triple in triples
        for place, values in enumerate(triple)
    }
