"""Rows of one topic that come from different messages, into one table in the order of epochs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints
from spoofbench.schema import KINDS
from spoofbench.table import Column
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows


def merged(rows: Sequence[EpochRows]) -> list[EpochRows]:
    """Return one :class:`EpochRows` per source and kind that has any, in the order of epochs; those of
    one epoch stay in the order given.
    """
    topics: dict[tuple[str, str], list[EpochRows]] = {}
    for one in rows:
        if not one.epoch.size:
            continue
        topics.setdefault((one.source, one.kind), []).append(one)
    return [
        parts[0] if len(parts) == 1 and _in_order(parts[0].epoch) else _merge(parts)
        for parts in topics.values()
    ]


def _in_order(epoch: Ints) -> bool:
    return bool(np.all(epoch[1:] >= epoch[:-1]))


def _merge(parts: Sequence[EpochRows]) -> EpochRows:
    epoch = np.concatenate([part.epoch for part in parts])
    order = np.argsort(epoch, kind="stable")
    kind = parts[0].kind
    names = [name for name in KINDS[kind].fields if any(name in part.columns for part in parts)]
    return EpochRows(
        parts[0].source,
        kind,
        epoch[order],
        {name: _column(kind, name, parts, order) for name in names},
        _times([(part.offset_ns, part.epoch.size) for part in parts], 0, order),
        _times([(part.tick_ns, part.epoch.size) for part in parts], 0, order),
        _times([(part.receive_time_ns, part.epoch.size) for part in parts], ABSENT_NS, order),
    )


def _times(parts: Sequence[tuple[Ints | None, int]], absent: int, order: Ints) -> Ints | None:
    if all(times is None for times, _ in parts):
        return None
    return np.concatenate(
        [np.full(size, absent) if times is None else times for times, size in parts]
    )[order]


def _column(kind: str, name: str, parts: Sequence[EpochRows], order: Ints) -> Any:
    field = KINDS[kind].fields[name]
    values: list[NDArray[Any]] = []
    valid: list[Bools] = []
    words: dict[Any, int] = {}
    for part in parts:
        cells, size = part.columns.get(name), part.epoch.size
        if cells is None:
            blank = (
                np.nan
                if field.category == "float"
                else -1
                if field.category in ("text", "bytes")
                else 0
            )
            values.append(np.full(size, blank))
            valid.append(np.zeros(size, bool))
        elif isinstance(cells, Column):
            values.append(
                cells.values if cells.words is None else _recoded(cells.values, cells.words, words)
            )
            valid.append(np.ones(size, bool) if cells.valid is None else cells.valid)
        else:
            values.append(cells)
            valid.append(np.ones(size, bool))
    joined = np.concatenate(values)[order]
    if field.category == "float":
        return joined
    if field.category in ("text", "bytes"):
        return Column(joined.astype(np.int32), None, tuple(words))
    return Column(joined, np.concatenate(valid)[order])


def _recoded(codes: NDArray[Any], own: Sequence[Any], words: dict[Any, int]) -> NDArray[Any]:
    """Return codes into ``words``, which takes up what it lacks."""
    shared = np.array([*(words.setdefault(word, len(words)) for word in own), -1])
    return np.asarray(shared[codes])
