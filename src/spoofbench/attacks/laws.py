"""The laws that every variant keeps, whoever wrote the attack; a broken one is a
:class:`PluginError` that names it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.attacks.motion import Floats
from spoofbench.attacks.resolution import resolutions
from spoofbench.errors import PluginError
from spoofbench.recording import Interval, Recording
from spoofbench.schema import KINDS, split_topic
from spoofbench.table import Column, Table, encode_words

GENUINE = ("receive_time_ns", "gps_week", "tow_s", "time_valid")
"""Fields that stay the victim's own unless the attack's class is ``time``."""

_VELOCITY_TOLERANCE_MPS = 0.01
_HEIGHT_TOLERANCE_M = 0.1

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class AttackedTable:
    """A table that keeps the laws, and the times of its first and last changed or deleted row; None
    where there is none.
    """

    table: Table
    changed_ns: tuple[int, int] | None


def check_only_gnss_changed(clean: Recording, attacked: Recording) -> None:
    """Refuse changed metadata, and a changed, added or removed topic that no spoofer of GNSS
    signals can touch.

    Raises:
        PluginError: a law is broken; says which.
    """
    strange = sorted(set(attacked) - set(clean))
    if strange:
        raise _broken(
            "the topics are the victim's", f"{strange[0]!r} is not in the clean recording"
        )
    for topic in clean:
        if KINDS[split_topic(topic)[1]].is_gnss_derived:
            continue
        if topic not in attacked or not (
            attacked[topic] is clean[topic] or attacked[topic] == clean[topic]
        ):
            raise _broken("what is not GNSS-derived stays", f"{topic!r} has changed")
    if attacked.metadata != clean.metadata:
        raise _broken(
            "the metadata stay", "they have changed; return clean.replace(...), which keeps them"
        )


def falsified(clean: Table, attacked: Table, window: Interval, about_time: bool) -> AttackedTable:
    """Hold a topic's attacked rows to the laws and round their values to the resolution of the
    clean columns.

    Raises:
        PluginError: a law is broken; says which.
    """
    if attacked.kind.name != clean.kind.name:
        raise _broken(
            "a topic keeps its kind", f"{clean.kind.name!r} has become {attacked.kind.name!r}"
        )
    for name in attacked:
        if attacked.has(name) and not clean.has(name):
            raise _broken(
                "the victim reports the fields that it always reports", f"{name!r} is new"
            )
    first, last = (
        int(row) for row in np.searchsorted(clean.time_ns, (window.start_ns, window.end_ns))
    )
    inside = attacked.between(window.start_ns, window.end_ns)
    _outside_is_the_same(clean, attacked, window)
    matched = first + _matched(clean.time_ns[first:last], inside.time_ns)
    genuine = clean.take(matched)
    if not about_time:
        for name in GENUINE:
            if name in clean.kind.fields and differing(genuine, inside, name).any():
                raise _broken(
                    "the victim's claimed times stay",
                    f"{name!r} has changed, but the attack's class is not 'time'",
                )
    columns, changed = _rounded(clean, genuine, inside)
    kept = np.concatenate([np.arange(first), matched, np.arange(last, len(clean))])
    deleted = np.setdiff1d(np.arange(first, last), matched)
    base = clean if kept.size == len(clean) else clean.take(kept)
    table = (
        base.replace(
            **{name: _inserted(base, name, column, first) for name, column in columns.items()}
        )
        if columns
        else base
    )
    touched = np.concatenate([genuine.time_ns[changed], clean.time_ns[deleted]])
    return AttackedTable(table, (int(touched.min()), int(touched.max())) if touched.size else None)


def _outside_is_the_same(clean: Table, attacked: Table, window: Interval) -> None:
    was, now = (table.take(~window.covers(table.time_ns)) for table in (clean, attacked))
    if not np.array_equal(was.time_ns, now.time_ns):
        raise _broken("rows outside the window stay", "rows were added, removed or moved in time")
    for name in {*was, *now}:
        rows_changed = differing(was, now, name)
        if rows_changed.any():
            raise _broken(
                "rows outside the window stay",
                f"{name!r} at {int(was.time_ns[np.argmax(rows_changed)])} ns has changed",
            )


def _matched(genuine_ns: NDArray[np.int64], attacked_ns: NDArray[np.int64]) -> Rows:
    """Row of the clean window that each attacked row stands for: the same time, and of rows at one
    time the same count.
    """
    count = np.arange(attacked_ns.size) - np.searchsorted(attacked_ns, attacked_ns, "left")
    rows = np.searchsorted(genuine_ns, attacked_ns, "left") + count
    known = (
        (rows < genuine_ns.size)
        & (genuine_ns[np.minimum(rows, genuine_ns.size - 1)] == attacked_ns)
        if genuine_ns.size
        else rows < 0
    )
    if not known.all():
        raise _broken(
            "the victim's log times stay",
            f"the clean recording has no such row at {int(attacked_ns[np.argmin(known)])} ns",
        )
    return rows


def differing(a: Table, b: Table, name: str) -> NDArray[np.bool_]:
    """Which rows of two tables of equal length differ in a field, bit by bit; any two absent values
    are equal.
    """
    one, other = a.column(name), b.column(name)
    if one.values is other.values and one.valid is other.valid and one.words == other.words:
        return np.zeros(len(a), bool)
    if one.words is not None:
        return np.array([p != q for p, q in zip(a.words(name), b.words(name), strict=True)], bool)
    valid, still = a.valid(name), b.valid(name)
    width = f"u{one.values.dtype.itemsize}"
    return np.asarray(
        (valid != still) | (valid & (one.values.view(width) != other.values.view(width))), bool
    )


def _rounded(
    clean: Table, genuine: Table, attacked: Table
) -> tuple[dict[str, Column], NDArray[np.bool_]]:
    """The columns that differ from the genuine rows', rounded, and which rows do."""
    columns: dict[str, Column] = {}
    changed = np.zeros(len(genuine), bool)
    different = {
        name: rows
        for name in {*genuine, *attacked}
        if (rows := differing(genuine, attacked, name)).any()
    }
    found = resolutions(
        clean, [name for name in different if clean.kind.fields[name].category == "float"]
    )
    for name, rows in different.items():
        column = attacked.column(name)
        if name in found:
            was, now = genuine[name].astype(np.float64), column.values.astype(np.float64)
            written = np.where(rows, found[name].represent(now, was), was)
            if name == "course_deg":
                written = np.where(rows & (written >= 360), written - 360, written)
            column = Column(written.astype(column.values.dtype))
            rows = differing(genuine, genuine.replace(**{name: column}), name)
        columns[name] = column
        changed |= rows
    return columns, changed


def _inserted(base: Table, name: str, column: Column, first: int) -> Column:
    rows = slice(first, first + column.values.size)
    if column.words is not None:
        words = base.words(name)
        words[rows] = [None if code < 0 else column.words[code] for code in column.values.tolist()]
        return encode_words(words)
    values, valid = base[name].copy(), base.valid(name).copy()
    values[rows] = column.values
    valid[rows] = True if column.valid is None else column.valid
    return Column(values, None if values.dtype.kind == "f" else valid)


def check_consistency(attacked: Table, window: Interval, genuine: Sequence[Table]) -> None:
    """Refuse PVT rows whose speed, course or heights fit one another worse than those of any
    genuine row.

    Raises:
        PluginError: a law is broken; says which.
    """
    rows = attacked.between(window.start_ns, window.end_ns)
    checks = (
        ("speed and course belong to velocity", _stray_mps, _VELOCITY_TOLERANCE_MPS),
        ("both heights belong together", _separation_m, _HEIGHT_TOLERANCE_M),
    )
    for law, measure, tolerance in checks:
        strays = measure(rows)
        if np.isnan(strays).all():
            continue
        usual = np.concatenate([measure(table) for table in genuine])
        low, high = (
            np.nanmin(usual, initial=np.inf) - tolerance,
            np.nanmax(usual, initial=-np.inf) + tolerance,
        )
        if np.any((strays < low) | (strays > high)):
            row = int(np.argmax((strays < low) | (strays > high)))
            raise _broken(
                law,
                (
                    f"those at {int(rows.time_ns[row])} ns do not; "
                    "spoofbench.attacks.motion.with_motion keeps them together"
                ),
            )


def _stray_mps(pvt: Table) -> Floats:
    """Distance of speed and course (or speed alone) from the level velocity, ``(n,)``."""
    north, east, speed = pvt["vel_n_mps"], pvt["vel_e_mps"], pvt["speed_mps"]
    course = np.radians(
        np.where(pvt.valid("course_deg"), pvt["course_deg"], np.degrees(np.arctan2(east, north)))
    )
    return np.asarray(
        np.hypot(speed * np.cos(course) - north, speed * np.sin(course) - east), np.float64
    )


def _separation_m(pvt: Table) -> Floats:
    """Height of the geoid by the two heights, ``(n,)``."""
    return np.asarray(pvt["height_m"] - pvt["height_msl_m"], np.float64)


def _broken(law: str, how: str) -> PluginError:
    return PluginError(f"the law {law!r} is broken: {how}")
