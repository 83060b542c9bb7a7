"""The resolution of a column: which numbers the receiver could have written there.

A receiver prints decimals or sends scaled integers; converters turn radians into degrees. Each
leaves a pattern in the last bits. A falsified value must have that pattern, or rounding alone gives
the attack away.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Floats
from spoofbench.table import Table

Writing = Callable[[Floats], Floats]
"""Takes numbers and gives the nearest ones that the receiver could have written; what it wrote
stays as it is.
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
_TELLING = 8
_DUST_ULPS = 8
_DISTINCT_ULPS = 64  # a grid must be this much coarser than the dust to be told from chance


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """How a column's values are written, and the sign that its zeros have.

    Attributes:
        write: None where the values fill the doubles, so that there is nothing to round to.
        dust: values lie on the grid but for some last bits that no known formula explains.
        negative_zero: whether the column has a zero with a minus sign.
    """

    write: Writing | None
    dust: bool
    negative_zero: bool

    def represent(self, values: Floats, genuine: Floats) -> Floats:
        """Return the values as the receiver would have written them, shape ``(n,)``.

        ``genuine`` is what it wrote in these rows: unexplained last bits are taken over from there.
        """
        written = values if self.write is None else self.write(values)
        if self.dust and self.write is not None:
            grid = self.write(genuine)
            ulps = np.nan_to_num((genuine - grid) / np.spacing(np.abs(grid)))
            written = written + np.clip(ulps, -_DUST_ULPS, _DUST_ULPS) * np.spacing(np.abs(written))
        return written if self.negative_zero else written + 0.0


def resolutions(table: Table, names: Iterable[str]) -> dict[str, Resolution]:
    """Return the resolution of each of these float fields of a table, found from all of its
    rows.
    """
    names = set(names)
    found: dict[str, Resolution] = {}
    for group in GROUPS:
        present = [name for name in group if name in table]
        if len(present) > 1 and names & set(present):
            together = resolution(np.concatenate([table[name] for name in present]))
            alike = together.write is not None and not together.dust
            found |= {
                name: together
                for name in present
                if alike or np.unique(table[name]).size < _TELLING
            }
    return {name: found.get(name) or resolution(table[name]) for name in sorted(names)}


def resolution(column: NDArray[np.floating]) -> Resolution:
    """Find how a column's values are written: the first known way, coarse before fine, that gives
    each of them back bit for bit.
    """
    single = column.dtype == np.float32
    values = column[~np.isnan(column)].astype(np.float64)
    negative_zero = bool(np.any(np.signbit(values) & (values == 0)))
    finite = np.unique(values[np.isfinite(values)])
    if finite.size == 0:
        return Resolution(None, False, True)
    probe = finite[np.linspace(0, finite.size - 1, min(_PROBE, finite.size)).astype(int)]
    for write in _writings(single):
        if np.array_equal(write(probe), probe) and np.array_equal(write(finite), finite):
            return Resolution(write, False, negative_zero)
    if not single:
        for write, step in _grids():
            spacing = np.spacing(np.abs(finite).max())
            if step > _DISTINCT_ULPS * spacing and np.all(
                np.abs(write(finite) - finite) <= _DUST_ULPS * spacing
            ):
                return Resolution(write, True, negative_zero)
    return Resolution(None, False, negative_zero)


def _writings(single: bool) -> Iterator[Writing]:
    """Known ways to write, in the order of belief; a decimal grid lies within finer ones of
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


def _grids() -> Iterator[tuple[Writing, float]]:
    return (
        (_scaled(decimals, scale), 10.0**-decimals / scale)
        for scale in _SCALES
        for decimals in _DECIMALS
    )


def _rounded(decimals: int) -> Writing:
    return lambda values: np.round(values, decimals)


def _multiplied(decimals: int) -> Writing:
    return lambda values: np.rint(values * 10.0**decimals) * 10.0**-decimals


def _from_radians(decimals: int) -> Writing:
    return lambda values: np.rad2deg(np.deg2rad(np.round(values, decimals)))


def _scaled(decimals: int, scale: float) -> Writing:
    return lambda values: np.round(values * scale, decimals) / scale


def _as_single(write: Writing) -> Writing:
    return lambda values: write(values).astype(np.float32).astype(np.float64)
