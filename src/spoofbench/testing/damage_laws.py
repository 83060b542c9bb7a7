"""What every converter must keep of a damaged or a long log."""

import numpy as np

from spoofbench.table import Table
from spoofbench.testing.checking import require
from spoofbench.testing.converter_alone import convert_alone
from spoofbench.testing.converter_subject import Outcome, Subject
from spoofbench.testing.damage import (
    GARBAGE,
    STRANGERS,
    cuts,
    damaged_logs,
    damages,
    long_logs,
    scratch,
)

HELD_S = 10.0
"""How long a converter may hold rows: so much before damage or a log's end may differ."""
SHARE = 0.5
"""Least share of the rows to be expected by bytes that a cut log must give."""
AFTER_SHARE = 0.9
"""Least share of the rows beyond damage that must be there."""
MEMORY_SHARE = 0.5
"""Most of what a log is longer than another that memory may grow by."""


def keeps_what_stands_before_a_cut(subject: Subject) -> None:
    """A log cut at any byte gives the rows of the whole, but for the last :data:`HELD_S`, and its
    share of them.

    The share is :data:`SHARE` of what the bytes that are left make one expect. A log cut within its
    first third may be refused.
    """
    for path, log, whole in subject.streams() if subject.streamed else ():
        for at in cuts(len(log)):
            cut = subject.convert_bytes(path.name, log[:at])
            what = f"{path.name!r} cut to {at:,} of {len(log):,} bytes"
            require(cut.error is None or 3 * at < len(log), f"{what} is refused: {cut.error}")
            if cut.error is None:
                _require_before(whole, cut, cut.latest_ns, what)
                least = SHARE * whole.rows * (at / len(log) - 1 / 3)
                require(cut.rows >= least, f"{what} gives {cut.rows} rows of {whole.rows}")


def _require_before(whole: Outcome, damaged: Outcome, latest_ns: int | None, what: str) -> None:
    if latest_ns is None:
        return
    sure_ns = latest_ns - int(HELD_S * 1e9)
    for topic in sorted({*whole.tables, *damaged.tables}):
        rows, given = (found.tables.get(topic) for found in (whole, damaged))
        before = None if rows is None else rows.until(sure_ns)
        kept = None if given is None else given.until(sure_ns)
        count = [0 if table is None else len(table) for table in (before, kept)]
        require(
            count[0] == count[1],
            f"{what} gives {count[1]} rows of {topic} up to {sure_ns}, the whole log {count[0]}",
        )
        if before is not None and kept is not None and count[0]:
            require(
                before == kept,
                f"{what} gives other rows of {topic} up to {sure_ns}: {_difference(before, kept)}",
            )


def _difference(one: Table, other: Table) -> str:
    if not np.array_equal(one.time_ns, other.time_ns):
        row = int(np.argmax(one.time_ns != other.time_ns))
        return f"row {row} is of time {int(other.time_ns[row])}, not {int(one.time_ns[row])}"
    names = [
        name
        for name in one.kind.fields
        if Table(one.kind.name, one.time_ns, {name: one.column(name)})
        != other.replace(**dict.fromkeys(set(other) - {name}))
    ]
    return f"{names} differ"


def keeps_what_stands_around_damage(subject: Subject) -> None:
    """Flipped, inserted or removed bytes leave the rows of the whole before them, and
    :data:`AFTER_SHARE` of those after.
    """
    for path, log, whole in subject.streams() if subject.streamed else ():
        for what, at, damaged in damages(log):
            found = subject.convert_bytes(path.name, damaged)
            what = f"{path.name!r} with {what} at {at:,}"
            require(found.error is None, f"{what} is refused: {found.error}")
            latest = subject.convert_bytes(path.name, log[:at]).latest_ns
            _require_before(whole, found, latest, what)
            if latest is not None:
                after_ns = latest + int(HELD_S * 1e9)
                expected, given = (
                    sum(int((t.time_ns > after_ns).sum()) for t in o.tables.values())
                    for o in (whole, found)
                )
                require(
                    given >= AFTER_SHARE * expected,
                    f"{what} gives {given} of {expected} rows after it",
                )


def survives_garbage(subject: Subject) -> None:
    """Garbage behind a log costs no row; before it, none where the log is still recognised."""
    for path, log, whole in subject.streams() if subject.streamed else ():
        behind = subject.convert_bytes(path.name, log + GARBAGE)
        require(
            behind.error is None, f"{path.name!r} with garbage behind it is refused: {behind.error}"
        )
        require(
            behind.rows >= whole.rows,
            f"{path.name!r} with garbage behind it gives {behind.rows} rows of {whole.rows}",
        )
        with scratch() as folder:
            before = folder / path.name
            before.write_bytes(GARBAGE + log)
            if subject.sniff(before) > 0:
                found = subject.convert(before)
                require(
                    found.error is None,
                    (
                        f"{path.name!r} with garbage before it is recognised, but refused: "
                        f"{found.error}"
                    ),
                )
                require(
                    found.rows >= whole.rows,
                    f"{path.name!r} with garbage before it gives {found.rows} rows of {whole.rows}",
                )


def raises_only_its_errors(subject: Subject) -> None:
    """Whatever it is given, it yields items or raises one :class:`SpoofbenchError`."""
    for path in subject.samples:
        for what, log in damaged_logs(path) if path.is_file() else ():
            found = subject.convert_bytes(path.name, log)
            require(
                found.error is None or bool(found.error.strip()),
                f"{path.name!r} with {what} is refused without a reason",
            )
        for stranger in (b"", *STRANGERS):
            subject.convert_bytes(path.name, stranger)


def keeps_memory_bounded(subject: Subject) -> None:
    """Memory does not grow with the log: a longer log takes at most :data:`MEMORY_SHARE` of the
    difference more.
    """
    for path, log, _ in subject.streams() if subject.streamed else ():
        with scratch() as folder:
            for what, short, long in long_logs(log, folder):
                first, second = (
                    alone.peak_bytes
                    for alone in convert_alone(
                        subject.given, [short, long], subject.options, keep=False
                    )
                )
                most = MEMORY_SHARE * (long.stat().st_size - short.stat().st_size)
                require(
                    second - first <= most,
                    f"{path.name!r} {what} takes {first / 2**20:.0f} MiB at "
                    f"{short.stat().st_size / 2**20:.0f} MiB "
                    f"and {second / 2**20:.0f} MiB at {long.stat().st_size / 2**20:.0f} MiB",
                )
