"""Fields of messages by their paths, as columns; one that the messages do not have is absent."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.rosbag.definitions import Definitions

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]

_INDEXED = re.compile(r"(.+)\[(\d+)\]")
_MAX_PATHS = 4096


class Fields:
    """Messages of one layout.

    A path has dots (``header.stamp.sec``); the places of an array of numbers stand in brackets
    (``meas[0]``).
    """

    def __init__(self, rows: NDArray[Any], prefix: str = "") -> None:
        self._rows = rows
        self._prefix = prefix
        self._names = frozenset(rows.dtype.names or ())

    def __len__(self) -> int:
        return int(self._rows.size)

    def within(self, path: str) -> "Fields":
        """Return the fields of a message among the fields."""
        return Fields(self._rows, f"{self._prefix}{path}.")

    def floats(self, path: str, scale: float = 1.0) -> Floats:
        """Return a number of each message times a scale, ``(n,)``; of a text, the number that it
        says; NaN where absent.
        """
        indexed = _INDEXED.fullmatch(self._prefix + path)
        name, place = (indexed[1], int(indexed[2])) if indexed else (self._prefix + path, None)
        if name not in self._names:
            return np.full(len(self), np.nan)
        values = self._rows[name]
        if values.dtype.kind == "S":
            return numbers(values) * scale
        if (values.ndim == 2) != (place is not None) or (
            place is not None and place >= values.shape[1]
        ):
            return np.full(len(self), np.nan)
        with np.errstate(over="ignore", invalid="ignore"):  # of damaged messages
            return np.asarray(
                (values if place is None else values[:, place]).astype(np.float64) * scale
            )

    def integers(self, path: str) -> Integers | None:
        """Return a whole number of each message, ``(n,)``, None where they have none."""
        path = self._prefix + path
        if (
            path not in self._names
            or self._rows[path].dtype.kind not in "iu"
            or self._rows[path].ndim != 1
        ):
            return None
        return np.asarray(self._rows[path].astype(np.int64))

    def array(self, path: str, size: int | None = None) -> Floats | None:
        """Return an array of numbers of each message, ``(n, m)``, None where they have none, or one
        of another size.
        """
        path = self._prefix + path
        if (
            path not in self._names
            or self._rows[path].ndim != 2
            or self._rows[path].dtype.kind == "S"
        ):
            return None
        values = self._rows[path]
        return (
            None
            if size is not None and values.shape[1] != size
            else np.asarray(values.astype(np.float64))
        )

    def texts(self, path: str) -> NDArray[np.str_]:
        """Return a text of each message, ``(n,)``, empty where absent."""
        path = self._prefix + path
        if path not in self._names or self._rows[path].dtype.kind != "S":
            return np.full(len(self), "", "U1")
        return np.char.decode(np.char.rstrip(self._rows[path], b"\0"), "utf-8", "replace")

    def stamp_ns(self, path: str = "header.stamp") -> Integers | None:
        """Return a time of each message in nanoseconds, ``(n,)``, None where they have none."""
        seconds, nanoseconds = self.integers(f"{path}.sec"), self.integers(f"{path}.nanosec")
        return (
            None
            if seconds is None or nanoseconds is None
            else seconds * 1_000_000_000 + nanoseconds
        )


def numbers(texts: NDArray[np.bytes_]) -> Floats:
    """Return the numbers in texts, ``(n,)``, NaN where there is none."""
    words, inverse = np.unique(texts, return_inverse=True)
    return np.array([_number(word) for word in words.tolist()], np.float64)[inverse.reshape(-1)]


def _number(word: bytes) -> float:
    try:
        return float(word.rstrip(b"\0"))
    except ValueError:
        return float("nan")


def paths_of(name: str, types: Definitions) -> Mapping[str, str]:
    """Return the base type of each field of a type by its path; of arrays and sequences the
    element's, with ``[]``; a message's own too.
    """
    found: dict[str, str] = {}
    _collect(found, "", name, types, 0)
    return found


def _collect(found: dict[str, str], prefix: str, name: str, types: Definitions, depth: int) -> None:
    from rosbags.interfaces import Nodetype

    if depth > 16 or name not in types:
        return
    for field, (kind, inner) in types[name][1]:
        if len(found) >= _MAX_PATHS:
            return
        if kind == Nodetype.NAME:
            found[f"{prefix}{field}"] = inner
            _collect(found, f"{prefix}{field}.", inner, types, depth + 1)
        else:
            found[f"{prefix}{field}"] = (
                inner[0]
                if kind == Nodetype.BASE
                else f"{inner[0][1][0] if inner[0][0] == Nodetype.BASE else ''}[]"
            )
