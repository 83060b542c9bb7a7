"""Numbers of a unit of time as nanoseconds: exact for decimal text and whole numbers, each cell by
itself.
"""

from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.table.cells import (
    Bools,
    blanked,
    integers,
    is_text,
    matching,
    numbers,
    present,
    words,
)

LIMIT_NS = 2**62

_DIGITS = {Fraction(10**digits): digits for digits in (0, 3, 6, 9)}
_PLAIN = r"^[+-]?[0-9]{1,18}(\.[0-9]{0,18})?$"


def counts(cells: Any, ns_per_unit: Fraction) -> tuple[NDArray[np.int64], Bools]:
    """Return numbers of a unit of time as nanoseconds, int64 ``(n,)``, and which cells are none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_timestamp(cells.type):
        cells, ns_per_unit = (
            pc.cast(cells, pa.int64()),
            Fraction({"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}[cells.type.unit]),
        )
    if pa.types.is_decimal(cells.type):
        cells = pc.cast(cells, pa.string())
    if is_text(cells) and ns_per_unit in _DIGITS:
        return _decimals(cells, _DIGITS[ns_per_unit])
    limit = LIMIT_NS / float(ns_per_unit)
    whole, there, odd = integers(cells)
    inexact = ~there | (np.abs(whole.astype(np.float64)) >= limit)
    exact_ns = _scaled(np.where(inexact, 0, whole), np.zeros(len(cells)), ns_per_unit)
    if not odd.any():
        return exact_ns, inexact
    values, bad = numbers(cells)
    bad = bad | np.isnan(values) | (np.abs(values) >= limit)
    values = np.where(bad, 0.0, values)
    floor = np.floor(values)
    nearest_ns = _scaled(floor.astype(np.int64), values - floor, ns_per_unit)
    return np.where(inexact, nearest_ns, exact_ns), inexact & bad


def _scaled(
    whole: NDArray[np.int64], part: NDArray[np.float64], ns_per_unit: Fraction
) -> NDArray[np.int64]:
    up, down = ns_per_unit.numerator, ns_per_unit.denominator
    if down == 1:
        return np.asarray(whole * up + np.rint(part * up).astype(np.int64))
    return np.asarray(
        whole // down * up + np.rint((whole % down + part) * up / down).astype(np.int64)
    )


def _decimals(cells: Any, digits: int) -> tuple[NDArray[np.int64], Bools]:
    """Return decimal text times ``10**digits``, rounded half to even, and which cells are no number
    within the limit.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    try:
        return _unscaled(pc.cast(cells, pa.decimal128(38, digits)))
    except pa.ArrowInvalid:
        trimmed = words(cells)
    plain = matching(trimmed, _PLAIN)
    rounded = pc.round(
        pc.cast(blanked(trimmed, ~plain), pa.decimal128(38, 18)), digits, "half_to_even"
    )
    scaled, bad = _unscaled(pc.cast(rounded, pa.decimal128(38, digits)))
    for place in np.flatnonzero(present(trimmed) & ~plain).tolist():
        value = _decimal(trimmed[place].as_py(), digits)
        bad[place] = value is None
        scaled[place] = value or 0
    return scaled, bad


def _unscaled(exact: Any) -> tuple[NDArray[np.int64], Bools]:
    """Return decimals without their point, and which are empty or beyond the limit."""
    import pyarrow.compute as pc

    empty = ~present(exact)
    filled = pc.fill_null(exact, 0)
    pairs = np.frombuffer(filled.buffers()[1], np.int64)[2 * filled.offset :][
        : 2 * len(filled)
    ].reshape(-1, 2)
    low, high = pairs[:, 0], pairs[:, 1]
    return low.copy(), empty | (high != low >> 63) | (low >= LIMIT_NS) | (low <= -LIMIT_NS)


def _decimal(text: str, digits: int) -> int | None:
    """Return one decimal number times ``10**digits``; None if it is none, or beyond the limit."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    if "_" in text or not value.is_finite() or (value and value.adjusted() + digits > 18):
        return None
    if value.adjusted() + digits < -1:
        return 0
    scaled = int(value.scaleb(digits).to_integral_value(ROUND_HALF_EVEN))
    return scaled if abs(scaled) < LIMIT_NS else None
