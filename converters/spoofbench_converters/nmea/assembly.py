"""Epochs and rows from sentences that are divided among receivers and epochs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spoofbench.arrays import Bools, Ints
from spoofbench.conversion import Columns, Rejects
from spoofbench.conversion.rows import take
from spoofbench.gnss_time import DAY_NS, SECOND_NS, wrap_difference
from spoofbench.schema import KINDS
from spoofbench_converters.nmea import signals
from spoofbench_converters.nmea.batch import SentenceBatch
from spoofbench_converters.nmea.epochs import PreviousTimes, ReceiverTraits, divide
from spoofbench_converters.nmea.signals import VIEW
from spoofbench_converters.nmea.solution import ONE_PER_EPOCH, Solution
from spoofbench_converters.serial.contract import ABSENT_NS, EpochRows, Epochs

_NEAR_NS = 10 * SECOND_NS  # a time of its own further from that of the epoch is not believed
_OF_SOLUTION = (*ONE_PER_EPOCH, "GSA", "GRS")
_WGS84 = int.from_bytes(b"W84", "big")
_MAX_DATUMS = 8
_AGAIN = "the same epoch again"


@dataclass(frozen=True, slots=True, eq=False)
class _Times:
    """Times of ``m`` epochs, int64 ``(m,)``, as in :class:`Epochs`; those claimed are filled in."""

    claimed_ns: Ints
    period_ns: Ints
    receive_time_ns: Ints

    def offsets(self, epoch: Ints, own_ns: Ints, receive_time_ns: Ints) -> Ints:
        """Return how much later than their epochs rows are, int64 ``(n,)``: by their own time of
        day if near, else by their stamps, else not at all.

        Args:
            epoch: int64 ``(n,)``, of each row.
            own_ns: int64 ``(n,)``, time of day that each row's sentence tells.
            receive_time_ns: int64 ``(n,)``, when each row's sentence was received.
        """
        base, received = self.claimed_ns[epoch], self.receive_time_ns[epoch]
        stamped = (received != ABSENT_NS) & (receive_time_ns != ABSENT_NS)
        by_stamp = np.where(stamped, receive_time_ns - np.where(stamped, received, 0), 0)
        timed = (base != ABSENT_NS) & (own_ns != ABSENT_NS)
        by_time = wrap_difference(np.where(timed, own_ns - base, 0), DAY_NS)
        return np.where(timed & (np.abs(by_time) <= _NEAR_NS), by_time, by_stamp)


class Assembly:
    """Puts the epochs of one log together."""

    def __init__(self) -> None:
        self._sensors = SentenceSensors()
        self._talkers: dict[str, list[str]] = {}
        self._datums: dict[str, list[str]] = {}

    def epochs(
        self, batch: SentenceBatch, starts: Bools, receiver: Ints, talkers: Sequence[str]
    ) -> Iterator[Epochs | Rejects]:
        """Yield complete epochs, and sentences that give no rows.

        Args:
            batch: sentences, ``n`` of them.
            starts: bool ``(n,)``, which of them open an epoch.
            receiver: int64 ``(n,)``, the receiver of each, -1 for sensors.
            talkers: names, by number.
        """
        epoch = np.cumsum(starts) - 1
        opening = np.flatnonzero(starts)
        lost: dict[str, list[Ints]] = {}
        rows: list[EpochRows] = []
        times = _Times(
            np.full(opening.size, ABSENT_NS),
            np.zeros(opening.size, np.int64),
            batch.frames["receive_time_ns"][opening],
        )
        for number in range(int(receiver.max(initial=-1)) + 1):
            indices = np.flatnonzero(receiver == number)
            if indices.size:
                opens = (
                    starts[indices]
                    if number == 0
                    else divide(
                        take(batch.frames, indices),
                        epoch[indices],
                        PreviousTimes(),
                        ReceiverTraits(),
                    ).starts
                )
                rows += self._receiver(
                    number, _ReceiverSentences(batch, indices, epoch, opens), times, lost, talkers
                )
                self._note(f"gnss{number}", batch, indices, talkers)
        rows += self._sensor_rows(batch, epoch, times, talkers, lost)
        gone = np.zeros(batch.size, bool)
        for reason, parts in sorted(lost.items()):
            left_out = np.unique(np.concatenate(parts))
            gone[left_out] = True
            yield Rejects(batch.frames["offset"][left_out], batch.frames["used"][left_out], reason)
        used = np.bincount(epoch, np.where(gone, 0, batch.frames["used"]), opening.size).astype(
            np.int64
        )
        yield Epochs(
            batch.frames["offset"][opening],
            times.claimed_ns,
            times.period_ns,
            times.receive_time_ns,
            used,
            rows,
        )

    def about(self) -> Mapping[str, Mapping[str, str]]:
        """Return the sources' metadata."""
        found = dict(self._sensors.about)
        for source, talkers in self._talkers.items():
            found[source] = {
                "topic": f"NMEA {' '.join(talkers)}",
                "solution": "gnss",
                "solution_basis": "no sentence says otherwise",
            }
            if source in self._datums:
                found[source]["datum"] = " ".join(self._datums[source])
        return found

    def _receiver(
        self,
        number: int,
        sentences: "_ReceiverSentences",
        times: _Times,
        lost: dict[str, list[Ints]],
        talkers: Sequence[str],
    ) -> Iterator[EpochRows]:
        """Yield the rows of one receiver; the first one gives the epochs their times."""
        for reason, indices in sentences.drop_repetitions(
            talkers.index("GN") if "GN" in talkers else -1
        ):
            lost.setdefault(reason, []).append(indices)
        solution = Solution(sentences.opening.size, sentences.tables)
        claimed_ns, period_ns = solution.claimed()
        at = sentences.at
        if number == 0:
            times.claimed_ns[at], times.period_ns[at] = claimed_ns, period_ns
        offset = times.offsets(
            at, claimed_ns, sentences.frames["receive_time_ns"][sentences.opening]
        )
        reported = np.zeros(sentences.opening.size, bool)
        for name in _OF_SOLUTION:
            reported[sentences.tables[name]["epoch"] if name in sentences.tables else []] = True
        known = np.flatnonzero(reported)
        source = f"gnss{number}"
        if known.size:
            solved = EpochRows.of(source, "gnss/pvt", at, solution.rows(), offset_ns=offset)
            yield solved if known.size == at.size else solved.take(known)
        if VIEW in sentences.tables:
            view, doubled = signals.without_doubles(sentences.tables[VIEW])
            if doubled.size:
                lost.setdefault(f"NMEA GSV: {_AGAIN}", []).append(doubled)
            if view["epoch"].size:
                yield EpochRows.of(
                    source,
                    "gnss/signal",
                    at[view["epoch"]],
                    signals.signal_rows(view, sentences.tables),
                    offset_ns=offset[view["epoch"]],
                )
        if "PUBX04" in sentences.tables:
            clock = sentences.tables["PUBX04"]
            columns = {name: clock[name] for name in ("bias_s", "drift_sps")}
            at, offset = at[clock["epoch"]], offset[clock["epoch"]]
            yield EpochRows.of(source, "gnss/clock", at, columns, offset_ns=offset)

    def _sensor_rows(
        self,
        batch: SentenceBatch,
        epoch: Ints,
        times: _Times,
        talkers: Sequence[str],
        lost: dict[str, list[Ints]],
    ) -> list[EpochRows]:
        frames = batch.frames
        for name in ("PASHR", "GYOACC", "IMURAW"):
            if name in batch.tables:
                _claim(batch.tables[name], epoch, times)
        rows, useful = [], np.zeros(batch.size, bool)
        for found in self._sensors.rows(batch, talkers):
            useful[found.frame] = True
            at, received = epoch[found.frame], frames["receive_time_ns"][found.frame]
            offset = times.offsets(at, frames["tod_ns"][found.frame], received)
            if found.frame.size:
                rows.append(
                    EpochRows.of(
                        found.source,
                        found.kind,
                        at,
                        found.columns,
                        offset_ns=offset,
                        receive_time_ns=received,
                    )
                )
        for name in SENSORS:
            if name in batch.tables:
                indices = batch.tables[name]["frame"]
                if not useful[indices].all():
                    lost[f"NMEA {name}: no value"] = [indices[~useful[indices]]]
        return rows

    def _note(
        self, source: str, batch: SentenceBatch, indices: Ints, talkers: Sequence[str]
    ) -> None:
        """Note the talkers and the datums of a receiver."""
        known = self._talkers.setdefault(source, [])
        talker = batch.frames["talker"][indices]
        present = np.flatnonzero(np.bincount(talker)).tolist()
        new = [index for index in present if talkers[index] not in known]
        known += [
            talkers[index]
            for index in sorted(new, key=lambda index: int(np.argmax(talker == index)))
        ]
        if "DTM" in batch.tables:
            datum = batch.tables["DTM"]
            for value in np.unique(datum["datum"][np.isin(datum["frame"], indices)]).tolist():
                text = value.to_bytes(3, "big").strip(b"\0").decode("ascii", "replace")
                if value and value != _WGS84:
                    names = self._datums.setdefault(source, [])
                    names += [text] if text not in names and len(names) < _MAX_DATUMS else []


class _ReceiverSentences:
    """The sentences of one receiver.

    Attributes:
        indices: int64 ``(k,)``, of its sentences in the batch.
        frames: their columns.
        opening: int64 ``(m,)``, which of them open its epochs.
        at: int64 ``(m,)``, the epochs of the batch that its own fall in.
        tables: by type, what they say, with the receiver's ``epoch`` of each row.
    """

    def __init__(self, batch: SentenceBatch, indices: Ints, epoch: Ints, opens: Bools) -> None:
        self.indices = indices
        self._talker_of_frame = batch.frames["talker"]
        self.frames = batch.frames if indices.size == batch.size else take(batch.frames, indices)
        selected = np.zeros(batch.size, bool)
        selected[indices] = True
        opens = opens | (np.arange(indices.size) == 0)
        self.opening = np.flatnonzero(opens)
        self.at = epoch[indices[self.opening]]
        of_frame = np.zeros(batch.size, np.int64)
        of_frame[indices] = np.cumsum(opens) - 1
        self.tables: dict[str, Columns] = {}
        for name, table in batch.tables.items():
            rows = selected[table["frame"]]
            if rows.any():
                kept = table if rows.all() else take(table, rows)
                self.tables[name] = {**kept, "epoch": of_frame[kept["frame"]]}

    def drop_repetitions(self, combined: int) -> Iterator[tuple[str, Ints]]:
        """Leave one sentence of a type per epoch, that of the ``combined`` talker or else the
        first; yield the indices of the others, with the reason.
        """
        for name in ONE_PER_EPOCH:
            table = self.tables.get(name)
            if table is not None and np.any(table["epoch"][1:] == table["epoch"][:-1]):
                others = self._talker_of_frame[table["frame"]] != combined
                order = np.lexsort((others, table["epoch"]))
                epoch = table["epoch"][order]
                first = np.zeros(epoch.size, bool)
                first[order[np.append(True, epoch[1:] != epoch[:-1])]] = True
                yield f"NMEA {name}: {_AGAIN}", table["frame"][~first]
                self.tables[name] = take(table, first)


def _claim(table: Columns, epoch: Ints, times: _Times) -> None:
    """Let epochs without a time have that of a sensor's sentence."""
    at = epoch[table["frame"]]
    rows = np.flatnonzero((times.claimed_ns[at] == ABSENT_NS) & (table["tod_ns"] != ABSENT_NS))[
        ::-1
    ]
    date_ns = table.get("date_ns", np.full(at.size, ABSENT_NS))[rows]
    dated = date_ns != ABSENT_NS
    times.claimed_ns[at[rows]] = np.where(dated, date_ns, 0) + table["tod_ns"][rows]
    times.period_ns[at[rows]] = np.where(dated, 0, DAY_NS)


_HEADING = {"HDT": ("ins/pva",), "THS": ("ins/pva",), "PASHR": ("ins/pva",)}
_INERTIAL = {
    "VNYMR": ("imu", "mag", "ins/pva"),
    "VNIMU": ("imu", "mag", "baro"),
    "GYOACC": ("imu",),
    "IMURAW": ("imu",),
}
SENSORS: Mapping[str, tuple[str, ...]] = _HEADING | _INERTIAL

_PREFIX = {"ins/pva": "ins", "imu": "imu", "mag": "mag", "baro": "baro"}
_VECTORNAV = {"device": "VectorNav", "axes": "frd"}
_UNICORE = {"device": "Unicore", "axes": "of the module"}
_ABOUT = {
    "VNYMR": _VECTORNAV
    | {"yaw_basis": "the device's: towards magnetic north where it has no magnetic model"},
    "VNIMU": _VECTORNAV,
    "GYOACC": _UNICORE,
    "IMURAW": _UNICORE,
}


@dataclass(frozen=True, slots=True, eq=False)
class SensorRows:
    """Rows of one kind of one source; ``frame`` is the sentence of each, int64 ``(n,)``."""

    source: str
    kind: str
    frame: Ints
    columns: Columns


class SentenceSensors:
    """The sensors of one log: each inertial sentence type is one, and each talker of a heading."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, str], str] = {}
        self.about: dict[str, dict[str, str]] = {}

    def rows(self, batch: SentenceBatch, talkers: Sequence[str]) -> Iterator[SensorRows]:
        """Yield the rows of a batch; those without any value are left out."""
        found = [
            (int(table["frame"][0]), name)
            for name, table in batch.tables.items()
            if name in SENSORS and table["frame"].size
        ]
        for _, name in sorted(found):
            table = batch.tables[name]
            talker = batch.frames["talker"][table["frame"]]
            present, first = np.unique(talker, return_index=True)
            for index in present[np.argsort(first)].tolist():
                rows = np.flatnonzero(talker == index)
                for kind in SENSORS[name]:
                    columns = {
                        field: table[field][rows] for field in KINDS[kind].fields if field in table
                    }
                    given = ~np.all([np.isnan(values) for values in columns.values()], axis=0)
                    kept = {field: values[given] for field, values in columns.items()}
                    yield SensorRows(
                        self._source(kind, name, talkers[index]),
                        kind,
                        table["frame"][rows[given]],
                        kept,
                    )

    def _source(self, kind: str, name: str, talker: str) -> str:
        """The name of a source, numbered in the order of appearance."""
        sensor = name if name in _INERTIAL else talker
        prefix = _PREFIX[kind]
        key = (prefix, sensor)
        if key not in self._names:
            self._names[key] = f"{prefix}{sum(known == prefix for known, _ in self._names)}"
            topic = (
                f"NMEA {name}"
                if name in _INERTIAL or name == "PASHR"
                else f"NMEA {talker} HDT or THS"
            )
            self.about[self._names[key]] = {"topic": topic, **_ABOUT.get(name, {})}
        return self._names[key]
