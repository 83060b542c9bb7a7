"""Heading, attitude and inertial sentences as rows of sources of their own."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spoofbench.conversion import Columns
from spoofbench.schema import KINDS
from spoofbench_converters.nmea.batch import Batch
from spoofbench_converters.nmea.fields import Ints

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
    """Rows of one kind of one source; ``frame`` is the sentence of each."""

    source: str
    kind: str
    frame: Ints
    columns: Columns


class Sensors:
    """The sensors of one log: each inertial sentence type is one, and each talker of a heading."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, str], str] = {}
        self.about: dict[str, dict[str, str]] = {}

    def rows(self, batch: Batch, talkers: Sequence[str]) -> Iterator[SensorRows]:
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
            for place in present[np.argsort(first)].tolist():
                rows = np.flatnonzero(talker == place)
                for kind in SENSORS[name]:
                    columns = {
                        field: table[field][rows] for field in KINDS[kind].fields if field in table
                    }
                    given = ~np.all([np.isnan(values) for values in columns.values()], axis=0)
                    kept = {field: values[given] for field, values in columns.items()}
                    yield SensorRows(
                        self._source(kind, name, talkers[place]),
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
