"""Times as the cells in which a mapping writes them: the reverse of
:mod:`spoofbench_converters.table.times`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.gnss_time import DAY_NS, GPS_EPOCH_NS, SECOND_NS, WEEK_NS, leap_seconds
from spoofbench_converters.table.fields import TimeSpec
from spoofbench_converters.table.times import ns_per, offset_ns


def tell(spec: TimeSpec, utc_ns: NDArray[np.int64]) -> dict[str, Any]:
    """Return the columns of times as Arrow arrays ``(n,)``: exact in seconds, ms, us and ns, else
    the nearest number.
    """
    import pyarrow as pa

    own_ns = utc_ns
    if spec.scale == "gps":
        own_ns = (
            utc_ns
            + (leap_seconds(utc_ns) if spec.leap_seconds is None else spec.leap_seconds) * SECOND_NS
        )
    elif spec.unit is None or spec.of_day or spec.date is not None:
        own_ns = utc_ns + offset_ns(spec)
    if spec.unit is None:
        return _texts(spec, own_ns)
    if spec.week is not None:
        since = own_ns - GPS_EPOCH_NS
        return {spec.week: pa.array(since // WEEK_NS), spec.column: _number(spec, since % WEEK_NS)}
    if spec.of_day:
        day = (
            {spec.date: pa.array(_written(own_ns, spec.date_format, "D"))}
            if spec.date is not None
            else {}
        )
        return {**day, spec.column: _number(spec, own_ns % DAY_NS)}
    since_ns = spec.since_ns or 0
    if abs(since_ns) < 2**62:
        return {spec.column: _number(spec, own_ns - since_ns)}
    return {spec.column: pa.array(own_ns / float(ns_per(spec)) - float(since_ns / ns_per(spec)))}


def _number(spec: TimeSpec, count_ns: NDArray[np.int64]) -> Any:
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


def _texts(spec: TimeSpec, own_ns: NDArray[np.int64]) -> dict[str, Any]:
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
