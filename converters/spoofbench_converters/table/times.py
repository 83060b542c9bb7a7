"""Times as cells of a table: read exact to the nanosecond, whatever they are written in, and
written the same way.
"""

from collections.abc import Mapping
from datetime import timedelta
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools
from spoofbench.gnss_time import DAY_NS, GPS_EPOCH_NS, SECOND_NS, WEEK_NS, gps_to_utc, utc_to_gps
from spoofbench_converters.table.cells import (
    TABLE,
    integers,
    is_text,
    numbers,
    words,
)
from spoofbench_converters.table.fields import TimeSpec
from spoofbench_converters.text.numbers import scaled

LIMIT_NS = 2**62

_DIGITS = {Fraction(10**digits): digits for digits in (0, 3, 6, 9)}
_NO_DATE_NS = -2_208_988_800 * SECOND_NS  # 1900-01-01, the day of a text without a date
_ZONED = r"[0-9](Z|z|[+-][0-9]{2}(:?[0-9]{2})?)$"


class TableClock:
    """Reads the time of rows as they stream by: a number that starts over is continued.

    Args:
        spec: what the mapping says.
        start_ns: Unix time, UTC, at which the count of a clock without date is 0; of a time of day,
            a day's midnight.
    """

    def __init__(self, spec: TimeSpec, start_ns: int = 0) -> None:
        self.spec = spec
        self._start_ns = start_ns
        per_turn = (
            DAY_NS
            if spec.of_day and spec.date is None
            else round(spec.wraps * ns_per(spec))
            if spec.unit
            else 0
        )
        self._turn_ns = per_turn
        self._last_ns: int | None = None
        self._turns = 0

    def read(self, columns: Mapping[str, Any]) -> tuple[NDArray[np.int64], Bools]:
        """Return Unix time in UTC, int64 ``(n,)``, and which rows have none."""
        spec = self.spec
        if spec.unit is None:
            time_ns, bad = _texts(spec, columns)
            if spec.is_relative:
                time_ns = np.where(bad, 0, time_ns - _NO_DATE_NS)
        else:
            time_ns, bad = self._counts(columns[spec.column])
        if spec.unit is not None or spec.is_relative:
            if self._turn_ns:
                time_ns = time_ns + self._turned(time_ns, bad)
            base_ns, base_bad = self._base(columns)
            time_ns, bad = time_ns + base_ns, bad | base_bad
        if spec.scale == "gps":
            time_ns = gps_to_utc(time_ns - GPS_EPOCH_NS, spec.leap_seconds)
        elif spec.unit is not None and (spec.date is not None or spec.of_day):
            time_ns = time_ns - offset_ns(spec)
        bad = bad | (np.abs(time_ns) >= LIMIT_NS)
        return np.where(bad, 0, time_ns), bad

    def _counts(self, cells: Any) -> tuple[NDArray[np.int64], Bools]:
        """Return the numbers as nanoseconds; those that count from very long ago as Unix time."""
        since_ns, ns_per_unit = self.spec.since_ns or 0, ns_per(self.spec)
        if abs(since_ns) < LIMIT_NS:
            return counts(cells, ns_per_unit)
        import pyarrow as pa

        values, bad = numbers(cells)
        time_ns, empty = counts(pa.array(values + float(since_ns / ns_per_unit)), ns_per_unit)
        return time_ns, bad | empty

    def _base(self, columns: Mapping[str, Any]) -> tuple[Any, Any]:
        """Return the Unix time from which the numbers count: one for all, or one for each row."""
        spec = self.spec
        if spec.week is not None:
            weeks, bad = numbers(columns[spec.week])
            bad = bad | np.isnan(weeks) | (weeks < 0) | (weeks > 10_000) | (weeks != np.rint(weeks))
            return np.where(bad, 0, weeks).astype(np.int64) * WEEK_NS + GPS_EPOCH_NS, bad
        if spec.date is not None:
            return _dates(columns[spec.date], spec.date_format)
        since_ns = self._start_ns if spec.since_ns is None else spec.since_ns
        return since_ns if abs(since_ns) < LIMIT_NS else 0, False

    def _turned(self, count_ns: NDArray[np.int64], bad: Bools) -> NDArray[np.int64]:
        """Return what is to be added because the count started over, or went back before that
        again.
        """
        good = np.flatnonzero(~bad)
        added = np.zeros(count_ns.size, np.int64)
        if not good.size:
            return added
        counts_ns = count_ns[good]
        steps = np.diff(counts_ns, prepend=counts_ns[0] if self._last_ns is None else self._last_ns)
        half = self._turn_ns // 2
        turns = self._turns + np.cumsum((steps < -half).astype(np.int64) - (steps > half))
        self._last_ns, self._turns = int(counts_ns[-1]), int(turns[-1])
        added[good] = turns * self._turn_ns
        return added


def _texts(spec: TimeSpec, columns: Mapping[str, Any]) -> tuple[NDArray[np.int64], Bools]:
    """Return texts as Unix time, and which are no time."""
    import pandas as pd
    import pyarrow.compute as pc

    texts = words(columns[spec.column])
    if spec.date is not None:
        texts = pc.binary_join_element_wise(words(columns[spec.date]), texts, " ")
    if spec.format == "iso":
        texts = pc.replace_substring(texts, "/", "-")
    zoned = np.array(
        pc.fill_null(pc.match_substring_regex(texts, _ZONED), False).to_numpy(zero_copy_only=False),
        bool,
    )
    if spec.format == "iso":
        zoned &= np.array(
            pc.fill_null(pc.match_substring(texts, ":"), False).to_numpy(zero_copy_only=False), bool
        )
    elif "%z" not in spec.format:
        zoned[:] = False
    parsed = pd.to_datetime(
        texts.to_pandas(),
        format="ISO8601" if spec.format == "iso" else spec.format,
        utc=True,
        errors="coerce",
    )
    time_ns, bad = _to_ns(parsed)
    return np.where(bad, 0, time_ns - np.where(zoned, 0, offset_ns(spec))), bad


def _dates(cells: Any, pattern: str) -> tuple[NDArray[np.int64], Bools]:
    """Return midnights of a column of dates, and which cells are no date."""
    import pandas as pd

    written = "ISO8601" if pattern == "iso" else pattern
    return _to_ns(
        pd.to_datetime(
            words(cells).to_pandas(), format=written, utc=True, errors="coerce"
        ).dt.floor("D")
    )


def _to_ns(moments: Any) -> tuple[NDArray[np.int64], Bools]:
    """Return a pandas series of times as Unix time, and which are none, or beyond what nanoseconds
    can count.
    """
    import pandas as pd

    within = moments.between(
        pd.Timestamp("1823-01-01", tz="UTC"), pd.Timestamp("2116-01-01", tz="UTC")
    )
    bounded = moments.where(within, pd.Timestamp(0, tz="UTC"))
    return bounded.dt.as_unit("ns").dt.tz_localize(None).to_numpy(dtype="datetime64[ns]").astype(
        np.int64
    ), ~np.asarray(within)


def ns_per(spec: TimeSpec) -> Fraction:
    """Return how many nanoseconds the unit of a time has."""
    assert spec.unit is not None
    return spec.unit.factor * SECOND_NS


def offset_ns(spec: TimeSpec) -> int:
    """Return how far the zone of a time is ahead of UTC."""
    return spec.zone.utcoffset(None) // timedelta(microseconds=1) * 1000


def write_times(spec: TimeSpec, utc_ns: NDArray[np.int64]) -> dict[str, Any]:
    """Return the columns of times as Arrow arrays ``(n,)``: exact in seconds, ms, us and ns, else
    the nearest number.
    """
    import pyarrow as pa

    own_ns = utc_ns
    if spec.scale == "gps":
        own_ns = utc_to_gps(utc_ns, spec.leap_seconds) + GPS_EPOCH_NS
    elif spec.unit is None or spec.of_day or spec.date is not None:
        own_ns = utc_ns + offset_ns(spec)
    if spec.unit is None:
        return _written_texts(spec, own_ns)
    if spec.week is not None:
        since = own_ns - GPS_EPOCH_NS
        return {
            spec.week: pa.array(since // WEEK_NS),
            spec.column: _written_numbers(spec, since % WEEK_NS),
        }
    if spec.of_day:
        day = (
            {spec.date: pa.array(_written(own_ns, spec.date_format, "D"))}
            if spec.date is not None
            else {}
        )
        return {**day, spec.column: _written_numbers(spec, own_ns % DAY_NS)}
    since_ns = spec.since_ns or 0
    if abs(since_ns) < 2**62:
        return {spec.column: _written_numbers(spec, own_ns - since_ns)}
    return {spec.column: pa.array(own_ns / float(ns_per(spec)) - float(since_ns / ns_per(spec)))}


def _written_numbers(spec: TimeSpec, count_ns: NDArray[np.int64]) -> Any:
    import pyarrow as pa

    digits = {10**9: 9, 10**6: 6, 10**3: 3, 1: 0}.get(
        ns_per(spec).numerator if ns_per(spec).denominator == 1 else 0
    )
    if digits is None:
        return pa.array(count_ns / float(ns_per(spec)))
    if digits == 0:
        return pa.array(count_ns)
    pairs = np.stack([count_ns, count_ns >> 63], axis=1).astype(np.int64)
    return pa.Array.from_buffers(
        pa.decimal128(38, digits), count_ns.size, [None, pa.py_buffer(pairs.tobytes())]
    )


def _written_texts(spec: TimeSpec, own_ns: NDArray[np.int64]) -> dict[str, Any]:
    import pyarrow as pa

    if spec.date is None:
        return {spec.column: pa.array(_written(own_ns, spec.format, "ns"))}
    if spec.format == "iso":
        whole = np.char.partition(_written(own_ns, "iso", "ns"), " ")
        return {spec.date: pa.array(whole[:, 0]), spec.column: pa.array(whole[:, 2])}
    date, _, time = spec.format.partition(" ")
    return {
        spec.date: pa.array(_written(own_ns, date, "D")),
        spec.column: pa.array(_written(own_ns, time, "ns")),
    }


def _written(own_ns: NDArray[np.int64], pattern: str, unit: str) -> NDArray[Any]:
    """Return times as text, by a pattern or in ISO 8601 with a blank."""
    if pattern == "iso":
        moments = own_ns.astype("datetime64[ns]")
        texts = np.datetime_as_string(moments, unit=unit)  # type: ignore[call-overload]
        return np.char.replace(texts, "T", " ")
    import pandas as pd

    return np.asarray(pd.DatetimeIndex(own_ns.astype("datetime64[ns]")).strftime(pattern), str)


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
        found = scaled(cells, _DIGITS[ns_per_unit], notation=TABLE)
        return found.values, ~found.present | (np.abs(found.values) >= LIMIT_NS)
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
