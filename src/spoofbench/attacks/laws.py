"""The laws that every variant keeps, whoever wrote the attack; a broken one is a
:class:`PluginError` that names it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Floats, Indices, Times
from spoofbench.attacks.resolution import resolutions
from spoofbench.errors import PluginError
from spoofbench.recording import Interval, Recording
from spoofbench.schema import KINDS, split_topic
from spoofbench.table import Column, Table, encode_categories

CLAIMED_TIME_FIELDS = ("receive_time_ns", "gps_week", "tow_s", "time_valid")
"""Fields that stay the victim's own unless the attack's class is ``time``."""

_VELOCITY_TOLERANCE_MPS = 0.01
_HEIGHT_TOLERANCE_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class AttackedTable:
    """A table that keeps the laws.

    Attributes:
        table: rounded to the resolution of the clean columns.
        changed_ns: times of the first and last changed or deleted row; None where there is none.
    """

    table: Table
    changed_ns: tuple[int, int] | None


def attacked_tables(
    clean: Recording,
    attacked: Recording,
    window: Interval,
    models: frozenset[str],
    donors: Sequence[Recording] = (),
    *,
    about_time: bool = False,
) -> dict[str, AttackedTable]:
    """Hold what an attack returned to the laws, and round it; the modelled topics by name.

    Args:
        clean: what was attacked.
        attacked: what the attack returned.
        window: where it may change rows.
        models: kinds that it models.
        donors: recordings that it took rows from: their rows fit as genuine ones do.
        about_time: whether it may change the times that the receiver claims.

    Raises:
        PluginError: a law is broken; says which, where, and what to do.
    """
    check_only_gnss_changed(clean, attacked)
    results = {
        topic: _attacked_table(clean[topic], attacked[topic], window, about_time)
        for topic in attacked
        if split_topic(topic)[1] in models
    }
    for topic in results:
        if clean[topic].kind.name == "gnss/pvt":
            others = [donor[other] for donor in donors for other in donor.topics("gnss/pvt")]
            check_consistency(attacked[topic], window, [clean[topic], *others])
    return results


def check_only_gnss_changed(clean: Recording, attacked: Recording) -> None:
    """Refuse changed metadata, and a changed, added or removed topic that no spoofer of GNSS
    signals can touch.

    Raises:
        PluginError: a law is broken; says which.
    """
    added = sorted(set(attacked) - set(clean))
    if added:
        raise _broken("must not add topics", f"{added[0]!r} is not in the clean recording")
    for topic in clean:
        if KINDS[split_topic(topic)[1]].is_gnss_derived:
            continue
        if topic not in attacked or not (
            attacked[topic] is clean[topic] or attacked[topic] == clean[topic]
        ):
            raise _broken("must change GNSS-derived topics only", f"{topic!r} has changed")
    if attacked.metadata != clean.metadata:
        raise _broken(
            "must keep the metadata", "they have changed; return clean.replace(...), which does"
        )


def _attacked_table(
    clean: Table, attacked: Table, window: Interval, about_time: bool
) -> AttackedTable:
    """Hold a topic's attacked rows to the laws and round their values to the resolution of the
    clean columns.
    """
    if attacked.kind.name != clean.kind.name:
        raise _broken(
            "must keep the kind of a topic",
            f"{clean.kind.name!r} has become {attacked.kind.name!r}",
        )
    for name in attacked:
        if attacked.has(name) and not clean.has(name):
            raise _broken("must not fill fields that the victim never reports", f"{name!r} is new")
    first, last = (
        int(row) for row in np.searchsorted(clean.time_ns, (window.start_ns, window.end_ns))
    )
    inside = attacked.between(window.start_ns, window.end_ns)
    _check_rows_outside(clean, attacked, window)
    matched = first + _matched(clean.time_ns[first:last], inside.time_ns)
    genuine = clean.take(matched)
    if not about_time:
        for name in CLAIMED_TIME_FIELDS:
            if name in clean.kind.fields and differing(genuine, inside, name).any():
                raise _broken(
                    "must keep the times that the victim claims",
                    f"{name!r} has changed, which only an attack of the class 'time' may do",
                )
    columns, changed = _rounded(clean, genuine, inside)
    kept = np.concatenate([np.arange(first), matched, np.arange(last, len(clean))])
    deleted = np.setdiff1d(np.arange(first, last), matched)
    table = clean if kept.size == len(clean) else clean.take(kept)
    if columns:
        table = table.replace(
            **{name: _inserted(table, name, column, first) for name, column in columns.items()}
        )
    touched = np.concatenate([genuine.time_ns[changed], clean.time_ns[deleted]])
    return AttackedTable(table, (int(touched.min()), int(touched.max())) if touched.size else None)


def _check_rows_outside(clean: Table, attacked: Table, window: Interval) -> None:
    was, now = (table.take(~window.covers(table.time_ns)) for table in (clean, attacked))
    if not np.array_equal(was.time_ns, now.time_ns):
        raise _broken(
            "must keep the rows outside the window", "rows were added, removed or moved in time"
        )
    for name in {*was, *now}:
        rows_changed = differing(was, now, name)
        if rows_changed.any():
            raise _broken(
                "must keep the rows outside the window",
                f"{name!r} at {int(was.time_ns[np.argmax(rows_changed)])} ns has changed",
            )


def _matched(genuine_ns: Times, attacked_ns: Times) -> Indices:
    """Return the row of the clean window that each attacked row stands for: that of the same time,
    and of several at one time, the one of the same number; ``(n,)``.
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
            "must keep the victim's log times",
            f"the clean recording has no such row at {int(attacked_ns[np.argmin(known)])} ns",
        )
    return rows


def differing(a: Table, b: Table, name: str) -> Bools:
    """Return which rows of two tables of equal length differ in a field, bit by bit; any two absent
    values are equal; ``(n,)``.
    """
    one, other = a.column(name), b.column(name)
    if (
        one.values is other.values
        and one.valid is other.valid
        and one.categories == other.categories
    ):
        return np.zeros(len(a), bool)
    if one.categories is not None:
        return np.array([p != q for p, q in zip(a.texts(name), b.texts(name), strict=True)], bool)
    valid, still = a.valid(name), b.valid(name)
    width = f"u{one.values.dtype.itemsize}"
    return np.asarray(
        (valid != still) | (valid & (one.values.view(width) != other.values.view(width))), bool
    )


def _rounded(clean: Table, genuine: Table, attacked: Table) -> tuple[dict[str, Column], Bools]:
    """Return the columns that differ from the genuine rows', rounded, and which rows do."""
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
    if column.categories is not None:
        words = base.texts(name)
        words[rows] = [
            None if code < 0 else column.categories[code] for code in column.values.tolist()
        ]
        return encode_categories(words)
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
        ("must let speed and course agree with velocity", _stray_mps, _VELOCITY_TOLERANCE_MPS),
        ("must move both heights alike", _separation_m, _HEIGHT_TOLERANCE_M),
    )
    for rule, measure, tolerance in checks:
        strays = measure(rows)
        if np.isnan(strays).all():
            continue
        usual = np.concatenate([measure(table) for table in genuine])
        low = np.nanmin(usual, initial=np.inf) - tolerance
        high = np.nanmax(usual, initial=-np.inf) + tolerance
        outside = (strays < low) | (strays > high)
        if outside.any():
            raise _broken(
                rule,
                f"those at {int(rows.time_ns[np.argmax(outside)])} ns do not fit; "
                "spoofbench.attacks.pvt.with_motion keeps them together",
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


def _broken(rule: str, finding: str) -> PluginError:
    return PluginError(f"an attack {rule}: {finding}")
