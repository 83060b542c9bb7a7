"""Cells of a table as numbers, words and flags.

Cells come as Arrow arrays: texts from a text file, typed values from any other; null is an empty
cell. Each reader returns values and which cells are not what they must be, so that the rows can be
rejected.
"""

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools
from spoofbench_converters.text.numbers import Notation, parsed

NULLS = (
    "",
    "nan",
    "NaN",
    "NAN",
    "-nan",
    "null",
    "NULL",
    "None",
    "none",
    "NA",
    "N/A",
    "n/a",
    "#N/A",
)
"""Texts that stand for an empty cell."""

_WHOLE = r"^[+-]?\d{1,18}$"
_NANS = (sign + "".join(nan) for sign in ("", "+", "-") for nan in product("nN", "aA", "nN"))

TABLE = Notation(
    tuple(dict.fromkeys((*NULLS, *_NANS))),
    trims=True,
    max_bytes=None,
    to_even=True,
)
"""How tables write numbers."""


def is_text(cells: Any) -> bool:
    """Whether the cells are texts."""
    import pyarrow as pa

    return bool(pa.types.is_string(cells.type) or pa.types.is_large_string(cells.type))


def present(cells: Any) -> Bools:
    """Which cells are not empty, bool ``(n,)``."""
    import pyarrow.compute as pc

    return (
        _mask(pc.is_valid(cells)) & ~_mask(pc.fill_null(pc.is_nan(cells), False))
        if _is_float(cells)
        else _mask(pc.is_valid(cells))
    )


def numbers(cells: Any) -> tuple[NDArray[np.float64], Bools]:
    """Return cells as float64 ``(n,)``, NaN where empty, and which of them are no finite number."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if is_text(cells):
        values, bad = parsed(cells, TABLE)
        infinite = np.isinf(values)
        return np.where(infinite, np.nan, values), bad | infinite
    if (
        pa.types.is_integer(cells.type)
        or pa.types.is_floating(cells.type)
        or pa.types.is_boolean(cells.type)
    ):
        typed = pc.cast(cells, pa.float64(), safe=False)
    elif pa.types.is_decimal(cells.type):
        typed = pc.cast(cells, pa.float64())
    else:
        return np.full(len(cells), np.nan), present(cells)
    found = np.asarray(typed.to_numpy(zero_copy_only=False), np.float64)
    infinite = np.isinf(found)
    return np.where(infinite, np.nan, found), infinite


def integers(cells: Any) -> tuple[NDArray[np.int64], Bools, Bools]:
    """Return cells as int64 ``(n,)``, which are there, and which are no whole number."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if pa.types.is_integer(cells.type):
        fits = present(cells) & ~np.asarray(pc.fill_null(pc.greater(cells, 2**63 - 1), False))
        return (
            np.asarray(pc.fill_null(pc.cast(blanked(cells, ~fits), pa.int64()), 0)),
            fits,
            present(cells) & ~fits,
        )
    whole = np.zeros(len(cells), bool)
    values, bad = numbers(cells)
    exact = np.zeros(len(cells), np.int64)
    if is_text(cells):
        trimmed = words(cells)
        whole = matching(trimmed, _WHOLE)
        exact = np.asarray(pc.fill_null(pc.cast(blanked(trimmed, ~whole), pa.int64()), 0))
    there = ~np.isnan(values)
    odd = there & ~whole & ((values != np.rint(values)) | (np.abs(values) > 2**53))
    return (
        np.where(whole, exact, np.where(there & ~odd & ~whole, values, 0.0).astype(np.int64)),
        there & ~odd,
        bad | odd,
    )


def matching(texts: Any, pattern: str) -> Bools:
    """Return which texts match a pattern, bool ``(n,)``; empty cells do not."""
    import pyarrow.compute as pc

    return _mask(pc.fill_null(pc.match_substring_regex(texts, pattern), False))


def blanked(cells: Any, gone: Bools) -> Any:
    """Return cells with those emptied that a mask ``(n,)`` selects."""
    import pyarrow as pa
    import pyarrow.compute as pc

    return pc.if_else(pa.array(gone), pa.scalar(None, cells.type), cells)


def words(cells: Any) -> Any:
    """Return cells as trimmed texts, null where empty."""
    import pyarrow as pa
    import pyarrow.compute as pc

    texts = cells if is_text(cells) else pc.cast(cells, pa.string())
    trimmed = pc.utf8_trim_whitespace(texts)
    return pc.if_else(pc.is_in(trimmed, pa.array(NULLS)), pa.scalar(None, pa.string()), trimmed)


def matches(cells: Any, wanted: tuple[str, ...]) -> Bools:
    """Return which cells are one of these words, or one of these numbers however it is written,
    bool ``(n,)``.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    found = _mask(pc.is_in(words(cells), pa.array(wanted, pa.string())))
    as_numbers = [value for value in map(_number, wanted) if value is not None]
    if as_numbers:
        found |= np.isin(numbers(cells)[0], as_numbers)
    return found


def choices(cells: Any, numbers_of: Mapping[str, int]) -> tuple[NDArray[np.int64], Bools, Bools]:
    """Return the number that each cell names, in any case or by the number itself, which are there,
    and which name none; ``(n,)`` each.
    """
    import pyarrow.compute as pc

    coded = pc.utf8_lower(words(cells)).dictionary_encode()
    known = [
        numbers_of.get(word, numbers_of.get(_whole(word), -1))
        for word in coded.dictionary.to_pylist()
    ]
    values = np.array([*known, -1], np.int64)[
        coded.indices.fill_null(-1).to_numpy(zero_copy_only=False)
    ]
    there = present(cells)
    bad = there & (values < 0)
    return np.where(values < 0, 0, values), there & ~bad, bad


def _whole(word: str) -> str:
    """Return a whole number without its decimals."""
    number = _number(word)
    return (
        str(int(number))
        if number is not None and number == number // 1 and abs(number) < 2**31
        else word
    )


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _is_float(cells: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_floating(cells.type))


def _mask(flags: Any) -> Bools:
    return np.array(flags.to_numpy(zero_copy_only=False), bool)
