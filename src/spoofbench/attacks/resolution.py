"""The resolution of a column: which numbers the receiver could have written there.

A receiver prints decimals or sends scaled integers; converters turn radians into degrees. Each
leaves a pattern in the last bits. An attacked value must have that pattern, or rounding alone gives
the attack away.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Floats
from spoofbench.table import Table

Rounding = Callable[[Floats], Floats]
"""Takes numbers, ``(n,)``, and gives the nearest ones that the receiver could have written; what it
wrote stays as it is.
"""

GROUPS = (
    ("lat_deg", "lon_deg"),
    ("height_m", "height_msl_m"),
    ("vel_n_mps", "vel_e_mps", "vel_d_mps"),
)
"""Fields that a receiver writes alike: what one of them does not show, another may."""

_DECIMALS = range(13)
_SCALES = (1.0, 60.0, 3600 / 1852, 3.6)  # the unit itself; arc minutes, knots, km/h
_PROBE = 32
# fewer distinct values do not show how a field is written: a still receiver's are whole by chance
_ENOUGH_VALUES = 8
_NOISE_ULPS = 8
_DISTINCT_ULPS = 64  # a grid must be this much coarser than the last bits to be no chance


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """How a column's values are written, and the sign that its zeros have.

    Attributes:
        rounding: None where the values fill the doubles, so that there is nothing to round to.
        has_ulp_noise: values lie on the grid but for some last bits that no known formula explains.
        negative_zero: whether the column has a zero with a minus sign.
    """

    rounding: Rounding | None
    has_ulp_noise: bool
    negative_zero: bool

    def represent(self, values: Floats, genuine: Floats) -> Floats:
        """Return the values as the receiver would have written them, shape ``(n,)``.

        ``genuine`` is what it wrote in these rows: unexplained last bits are taken over from there.
        """
        written = values if self.rounding is None else self.rounding(values)
        if self.has_ulp_noise and self.rounding is not None:
            grid = self.rounding(genuine)
            ulps = np.nan_to_num((genuine - grid) / np.spacing(np.abs(grid)))
            written = written + np.clip(ulps, -_NOISE_ULPS, _NOISE_ULPS) * np.spacing(
                np.abs(written)
            )
        return written if self.negative_zero else written + 0.0


def resolutions(table: Table, names: Iterable[str]) -> dict[str, Resolution]:
    """Return the resolution of these float fields of a table, found from all of its rows."""
    names = set(names)
    found: dict[str, Resolution] = {}
    for group in GROUPS:
        present = [name for name in group if name in table]
        if len(present) > 1 and names & set(present):
            together = resolution(np.concatenate([table[name] for name in present]))
            alike = together.rounding is not None and not together.has_ulp_noise
            found |= {
                name: together
                for name in present
                if alike or np.unique(table[name]).size < _ENOUGH_VALUES
            }
    return {name: found.get(name) or resolution(table[name]) for name in sorted(names)}


def resolution(column: NDArray[np.floating]) -> Resolution:
    """Find how a column's values, ``(n,)``, are written: the first known way, coarse before fine,
    that gives each of them back bit for bit.
    """
    single = column.dtype == np.float32
    values = column[~np.isnan(column)].astype(np.float64)
    negative_zero = bool(np.any(np.signbit(values) & (values == 0)))
    finite = np.unique(values[np.isfinite(values)])
    if finite.size == 0:
        return Resolution(None, False, True)
    probe = finite[np.linspace(0, finite.size - 1, min(_PROBE, finite.size)).astype(int)]
    for rounding in _roundings(single):
        if np.array_equal(rounding(probe), probe) and np.array_equal(rounding(finite), finite):
            return Resolution(rounding, False, negative_zero)
    if not single:
        for rounding, step in _grids():
            spacing = np.spacing(np.abs(finite).max())
            if step > _DISTINCT_ULPS * spacing and np.all(
                np.abs(rounding(finite) - finite) <= _NOISE_ULPS * spacing
            ):
                return Resolution(rounding, True, negative_zero)
    return Resolution(None, False, negative_zero)


def _roundings(single: bool) -> Iterator[Rounding]:
    """Yield known ways to write, likely ones first; a decimal grid lies within finer ones of
    minutes, so decimals come first.
    """
    if single:
        yield from (_as_single(_rounded(decimals)) for decimals in _DECIMALS)
        return
    yield from (_rounded(decimals) for decimals in _DECIMALS)
    yield from (_multiplied(decimals) for decimals in _DECIMALS)
    yield from (_from_radians(decimals) for decimals in _DECIMALS)
    yield from (_as_single(_rounded(decimals)) for decimals in _DECIMALS)
    yield _as_single(lambda values: values)
    yield from (_scaled(decimals, scale) for scale in _SCALES[1:] for decimals in _DECIMALS)


def _grids() -> Iterator[tuple[Rounding, float]]:
    return (
        (_scaled(decimals, scale), 10.0**-decimals / scale)
        for scale in _SCALES
        for decimals in _DECIMALS
    )


def _rounded(decimals: int) -> Rounding:
    return lambda values: np.round(values, decimals)


def _multiplied(decimals: int) -> Rounding:
    return lambda values: np.rint(values * 10.0**decimals) * 10.0**-decimals


def _from_radians(decimals: int) -> Rounding:
    return lambda values: np.rad2deg(np.deg2rad(np.round(values, decimals)))


def _scaled(decimals: int, scale: float) -> Rounding:
    return lambda values: np.round(values * scale, decimals) / scale


def _as_single(rounding: Rounding) -> Rounding:
    return lambda values: rounding(values).astype(np.float32).astype(np.float64)
