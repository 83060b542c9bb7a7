"""Sentences of a piece of a log, read: what all have in common, and a table per type."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from spoofbench.conversion import Columns, Rejects
from spoofbench.conversion.rows import join, take
from spoofbench_converters.nmea import satellites, sky
from spoofbench_converters.nmea.addresses import CODES, READ, Addresses
from spoofbench_converters.nmea.fields import Bools, Ints, Sentences
from spoofbench_converters.nmea.sentences import READERS, Reader
from spoofbench_converters.serial.contract import ABSENT_NS, Frames

VIEW, USE, RESIDUAL = "satellites in view", "satellites in use", "residuals"

_SKY: Mapping[str, tuple[Callable[[Reader, Ints], tuple[Columns, Columns]], str]] = {
    "GSV": (sky.gsv, VIEW),
    "PUBX03": (sky.pubx03, VIEW),
    "GSA": (sky.gsa, USE),
    "GRS": (sky.grs, RESIDUAL),
}
_BY_TALKER = frozenset(
    CODES[name] for name in READ if len(name) == 3 and name not in ("GSV", "GSA", "GRS", "DTM")
)


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Sentences in file order.

    Attributes:
        frames: by sentence ``offset used receive_time_ns``, ``code`` of the type, place of the
            ``talker``, ``tod_ns`` and ``tod_places``, ``lat_deg lon_deg`` and the ``message``
            number of a GSV.
        tables: by type of sentence, and of satellites by ``VIEW``, ``USE`` and ``RESIDUAL``: what
            the sentences say; ``frame`` is the place of the sentence in ``frames``, not decreasing.
    """

    frames: Columns
    tables: Mapping[str, Columns]

    @property
    def size(self) -> int:
        """Number of sentences."""
        return int(self.frames["offset"].size)

    def take(self, kept: Bools) -> "Batch":
        """Return the sentences that a mask selects."""
        if kept.all():
            return self
        place = np.cumsum(kept) - 1
        tables = {}
        for name, table in self.tables.items():
            rows = kept[table["frame"]]
            if rows.any():
                left = table if rows.all() else take(table, rows)
                tables[name] = {**left, "frame": place[left["frame"]]}
        return Batch(take(self.frames, kept), tables)

    def split(self, place: int) -> tuple["Batch", "Batch"]:
        """Return the sentences before a place, and the others."""
        head, tail = {}, {}
        for name, table in self.tables.items():
            row = int(np.searchsorted(table["frame"], place))
            if row:
                head[name] = take(table, slice(0, row))
            if row < table["frame"].size:
                tail[name] = take(table, slice(row, None))
                tail[name]["frame"] = tail[name]["frame"] - place
        return Batch(take(self.frames, slice(0, place)), head), Batch(
            take(self.frames, slice(place, None)), tail
        )

    def then(self, later: "Batch") -> "Batch":
        """Return these sentences and later ones."""
        if not self.size:
            return later
        tables = dict(self.tables)
        for name, table in later.tables.items():
            tables[name] = join(
                tables.get(name, {}), {**table, "frame": table["frame"] + self.size}
            )
        return Batch(join(self.frames, later.frames), tables)


def read_frames(
    frames: Frames, addresses: Addresses, source: str | None
) -> tuple[Batch, list[Rejects]]:
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
        _rejects(frames, np.flatnonzero((code < 0) & (reason == place)), addresses.reasons[place])
        for place in np.unique(reason[code < 0])
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
    return Batch(common, tables).take(kept), rejects


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
