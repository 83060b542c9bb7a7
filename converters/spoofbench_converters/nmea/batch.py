"""Sentences of a piece of a log, read: what all have in common, and a table per type."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench.arrays import Bools, Ints
from spoofbench.conversion import Columns, Rejects
from spoofbench.conversion.rows import join, take
from spoofbench_converters.nmea import satellites, signals
from spoofbench_converters.nmea.fields import Sentences
from spoofbench_converters.nmea.sentences import READERS, Reader
from spoofbench_converters.nmea.signals import RESIDUAL, USE, VIEW
from spoofbench_converters.serial.contract import ABSENT_NS, Frames

READ = (
    "GGA", "RMC", "GLL", "GNS", "ZDA", "GST", "GBS", "GRS", "VTG", "GSA", "GSV", "DTM", "HDT",
    "THS",
    "PUBX00", "PUBX03", "PUBX04", "PGRME", "PASHR", "VNYMR", "VNIMU", "GYOACC", "IMURAW",
)  # fmt: skip
CODES = {name: code for code, name in enumerate(READ)}
GNSS_TALKERS = frozenset(("GP", "GN", "GL", "GA", "GB", "BD", "GQ", "QZ", "GI", "IM", "PQ"))

_WHOLE = frozenset(("PGRME", "PASHR", "VNYMR", "VNIMU", "GYOACC", "IMURAW"))
_QUALCOMM = {
    "PQGSV": "GSV",
    "PQGSA": "GSA",
}  # of BeiDou and QZSS, as the system id at their end says
_STANDARD = frozenset(name for name in READ if len(name) == 3)
_KEY_BYTES = 8
_MAX_REASONS = 64
_MAX_KNOWN = 65_536


@dataclass(frozen=True, slots=True)
class Address:
    """What an address means: ``code`` of the type, -1 where it is not read, for the ``reason``; and
    the ``talker``.
    """

    code: int
    talker: str
    reason: str


def address_of(text: str) -> Address:
    """Return what an address, cut to eight characters, means."""
    if text in _QUALCOMM:
        return Address(CODES[_QUALCOMM[text]], "PQ", "")
    if text in _WHOLE:
        return Address(CODES[text], text[:2], "")
    if text == "PUBX":
        return Address(CODES["PUBX00"], "PUBX", "")
    if text.startswith("P") and len(text) >= 4:
        return Address(-1, "", f"NMEA {text[:4]}: vendor's own sentence, not read")
    kind = text[2:]
    if len(text) != 5 or not text.isascii() or not text.isalnum() or not text.isupper():
        return Address(-1, "", "NMEA: no sentence of the standard")
    if kind in _STANDARD:
        return Address(CODES[kind], text[:2], "")
    return Address(-1, "", f"NMEA {kind}: nothing in the schema")


class Addresses:
    """The addresses that a log has shown so far."""

    def __init__(self) -> None:
        self.talkers: list[str] = []
        self.reasons: list[str] = []
        self._keys = np.empty(0, np.uint64)
        self._meanings = np.empty((0, 3), np.int64)

    def read(self, sentences: Sentences) -> tuple[Ints, Ints, Ints]:
        """Return for each of ``k`` sentences the code of its type, the index of its talker and that
        of its reason, -1 for none; int64 ``(k,)``.
        """
        keys = _keys(sentences)
        index = np.minimum(np.searchsorted(self._keys, keys), max(self._keys.size - 1, 0))
        unknown = (
            np.flatnonzero(self._keys[index] != keys) if self._keys.size else np.arange(keys.size)
        )
        if unknown.size:
            new, first = np.unique(keys[unknown], return_index=True)
            self._learn(new[np.argsort(first)].tolist())
            index = np.searchsorted(self._keys, keys)
        code, talker, reason = self._meanings[index].T
        return self._with_numbers(sentences, code, reason.copy(), talker)

    def reason(self, text: str) -> int:
        """Return the index of a reason; the 65th and later ones share one."""
        if text not in self.reasons:
            if len(self.reasons) > _MAX_REASONS:
                return _MAX_REASONS
            self.reasons.append(
                "NMEA: sentences of further types, not read"
                if len(self.reasons) == _MAX_REASONS
                else text
            )
        return self.reasons.index(text) if text in self.reasons else _MAX_REASONS

    def _with_numbers(
        self, sentences: Sentences, code: Ints, reason: Ints, talker: Ints
    ) -> tuple[Ints, Ints, Ints]:
        """Tell apart the sentences that u-blox numbers by their first field."""
        rows = np.flatnonzero(code == CODES["PUBX00"])
        if rows.size:
            number = sentences.of(rows).cells(1)
            code = code.copy()
            code[rows] = -1
            for digit in "034":
                named = (
                    (number.length == 2) & (number.at(0) == ord("0")) & (number.at(1) == ord(digit))
                )
                code[rows[named]] = CODES[f"PUBX0{digit}"]
            reason[rows] = self.reason("NMEA PUBX: vendor's own sentence, not read")
        return code, talker, reason

    def _learn(self, new: list[int]) -> None:
        """Take keys not seen before, in the order of appearance; of too many those that are not
        read are forgotten.
        """
        if self._keys.size > _MAX_KNOWN:
            kept = self._meanings[:, 0] >= 0
            self._keys, self._meanings = self._keys[kept], self._meanings[kept]
        meanings = []
        for key in new:
            address = address_of(key.to_bytes(_KEY_BYTES, "big").rstrip(b"\0").decode("latin1"))
            meanings.append(
                (
                    address.code,
                    self._talker(address.talker),
                    self.reason(address.reason) if address.reason else -1,
                )
            )
        keys = np.concatenate([self._keys, np.array(new, np.uint64)])
        order = np.argsort(keys)
        self._keys = keys[order]
        self._meanings = np.concatenate([self._meanings, np.array(meanings, np.int64)])[order]

    def _talker(self, talker: str) -> int:
        if talker not in self.talkers:
            self.talkers.append(talker)
        return self.talkers.index(talker)


def _keys(sentences: Sentences) -> NDArray[np.uint64]:
    """The first eight characters of each address as one number."""
    cells = sentences.addresses()
    keys = np.zeros(cells.begin.size, np.uint64)
    for index in range(_KEY_BYTES):
        keys = keys << np.uint64(8) | cells.at(index).astype(np.uint64)
    return keys


_SKY: Mapping[str, tuple[Callable[[Reader, Ints], tuple[Columns, Columns]], str]] = {
    "GSV": (signals.gsv, VIEW),
    "PUBX03": (signals.pubx03, VIEW),
    "GSA": (signals.gsa, USE),
    "GRS": (signals.grs, RESIDUAL),
}
_BY_TALKER = frozenset(
    CODES[name] for name in READ if len(name) == 3 and name not in ("GSV", "GSA", "GRS", "DTM")
)


@dataclass(frozen=True, slots=True, eq=False)
class SentenceBatch:
    """Sentences in file order.

    Attributes:
        frames: by sentence ``offset used receive_time_ns``, ``code`` of the type, index of the
            ``talker``, ``tod_ns`` and ``tod_places``, ``lat_deg lon_deg`` and the ``message``
            number of a GSV.
        tables: by type of sentence, and of satellites by ``VIEW``, ``USE`` and ``RESIDUAL``: what
            the sentences say; ``frame`` is the index of the sentence in ``frames``, not decreasing.
    """

    frames: Columns
    tables: Mapping[str, Columns]

    @property
    def size(self) -> int:
        """Number of sentences."""
        return int(self.frames["offset"].size)

    def take(self, kept: Bools) -> "SentenceBatch":
        """Return the sentences that a mask ``(n,)`` selects."""
        if kept.all():
            return self
        index = np.cumsum(kept) - 1
        tables = {}
        for name, table in self.tables.items():
            rows = kept[table["frame"]]
            if rows.any():
                left = table if rows.all() else take(table, rows)
                tables[name] = {**left, "frame": index[left["frame"]]}
        return SentenceBatch(take(self.frames, kept), tables)

    def split(self, index: int) -> tuple["SentenceBatch", "SentenceBatch"]:
        """Return the sentences before an index, and the others."""
        head, tail = {}, {}
        for name, table in self.tables.items():
            row = int(np.searchsorted(table["frame"], index))
            if row:
                head[name] = take(table, slice(0, row))
            if row < table["frame"].size:
                tail[name] = take(table, slice(row, None))
                tail[name]["frame"] = tail[name]["frame"] - index
        return SentenceBatch(take(self.frames, slice(0, index)), head), SentenceBatch(
            take(self.frames, slice(index, None)), tail
        )

    def then(self, later: "SentenceBatch") -> "SentenceBatch":
        """Return these sentences and later ones."""
        if not self.size:
            return later
        tables = dict(self.tables)
        for name, table in later.tables.items():
            tables[name] = join(
                tables.get(name, {}), {**table, "frame": table["frame"] + self.size}
            )
        return SentenceBatch(join(self.frames, later.frames), tables)


def read_frames(
    frames: Frames, addresses: Addresses, source: str | None
) -> tuple[SentenceBatch, list[Rejects]]:
    """Read the frames of a piece; sentences not read, not readable, or of another talker than the
    one asked for are rejects.
    """
    sentences = Sentences(frames)
    code, talker, reason = addresses.read(sentences)
    if source is not None and code.size:
        others = np.isin(code, list(_BY_TALKER)) & (np.array(addresses.talkers)[talker] != source)
        code, reason = (
            np.where(others, -1, code),
            np.where(
                others, addresses.reason("NMEA: another talker than the one asked for"), reason
            ),
        )
    named = satellites.of_talkers(addresses.talkers)[talker]
    common = _common(frames, code, talker)
    rejects = [
        _rejects(frames, np.flatnonzero((code < 0) & (reason == index)), addresses.reasons[index])
        for index in np.unique(reason[code < 0])
    ]
    tables: dict[str, Columns] = {}
    kept = code >= 0
    for present in np.unique(code[kept]).tolist():
        rows = np.flatnonzero(code == present)
        reader = Reader(sentences.of(rows))
        for name, table in _tables(READ[present], reader, named[rows]):
            local = table.pop("row")
            if not reader.readable.all():
                whole = np.flatnonzero(reader.readable[local])
                table, local = take(table, whole), local[whole]
            tables[name] = join(tables.get(name, {}), {**table, "frame": rows[local]})
        for name in common.keys() & tables.get(READ[present], {}).keys():
            common[name][tables[READ[present]]["frame"]] = tables[READ[present]][name]
        if not reader.readable.all():
            rejects.append(
                _rejects(
                    frames, rows[~reader.readable], f"NMEA {READ[present]}: field not readable"
                )
            )
            kept[rows[~reader.readable]] = False
    if VIEW in tables:
        tables[VIEW] = take(tables[VIEW], np.argsort(tables[VIEW]["frame"], kind="stable"))
    return SentenceBatch(common, tables).take(kept), rejects


def _common(frames: Frames, code: Ints, talker: Ints) -> Columns:
    """Return what all sentences have in common, times and positions still absent."""
    n = code.size
    return {
        "offset": frames.offsets(),
        "used": frames.used,
        "receive_time_ns": frames.receive_time_ns,
        "code": code,
        "talker": talker,
        "tod_ns": np.full(n, ABSENT_NS),
        "tod_places": np.zeros(n, np.int64),
        "lat_deg": np.full(n, np.nan),
        "lon_deg": np.full(n, np.nan),
        "lat_deg_step": np.full(n, np.inf),
        "message": np.zeros(n, np.int64),
    }


def _tables(name: str, reader: Reader, named: Ints) -> Iterator[tuple[str, Columns]]:
    """Yield the tables that sentences of one type give; ``row`` is the sentence among them."""
    each = np.arange(named.size)
    if name in _SKY:
        read, satellites_of = _SKY[name]
        columns, rows = read(reader, named)
        yield satellites_of, rows
        yield name, {**columns, "row": each}
    else:
        yield name, {**READERS[name](reader), "row": each}


def _rejects(frames: Frames, rows: Ints, reason: str) -> Rejects:
    return Rejects(frames.offsets()[rows], frames.used[rows], reason)
