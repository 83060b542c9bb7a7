"""What each type of sentence says, as columns: NMEA 0183 4.11, u-blox, Garmin, VectorNav and
Unicore interface descriptions.

Of a value that several sentences may give, ``<name>_step`` is the resolution of the text in the
unit of the value, so that the finest one can be chosen; infinite where absent. ``tod_ns`` is time
of day, ``ABSENT_NS`` where the sentence has none. Letters are characters, 0 where absent. Of ``n``
sentences every column is ``(n,)``.
"""

from collections.abc import Callable, Mapping

import numpy as np

from spoofbench.arrays import Bools, Floats, Ints, Octets
from spoofbench.conversion import Columns
from spoofbench.gnss_time import midnight
from spoofbench_converters.nmea import fields
from spoofbench_converters.nmea.fields import FieldCells, SentenceFields, decimals, one_of
from spoofbench_converters.serial.contract import ABSENT_NS

KNOT_MPS = 1852 / 3600
KMH_MPS = 1 / 3.6
GAUSS_UT = 100.0
_NO_DILUTION = 99.99


class Reader:
    """Sentences of one type: each method reads one of their fields and notes in ``readable`` where
    it is not what it should be.
    """

    def __init__(self, fields: SentenceFields) -> None:
        self._fields = fields
        self.count = fields.count
        self.readable: Bools = np.ones(fields.count.size, bool)

    def cells(self, field: int, where: Bools | None = None) -> FieldCells:
        """Return the field as it stands, of ``n`` sentences; absent where not ``where``, bool
        ``(n,)``.
        """
        cells = self._fields.cells(field)
        return (
            cells
            if where is None
            else FieldCells(cells.octets, cells.begin, np.where(where, cells.length, 0))
        )

    def number(self, field: int, where: Bools | None = None) -> Floats:
        """Return values, float64 ``(n,)``, NaN where absent."""
        read = decimals(self.cells(field, where))
        self.readable &= read.readable
        return read.floats()

    def whole(self, field: int, where: Bools | None = None) -> Ints:
        """Return counts and numbers of things, int64 ``(n,)``, -1 where absent."""
        read = decimals(self.cells(field, where))
        self.readable &= (
            read.readable & (read.places == 0) & (read.mantissa >= 0) & (read.mantissa < 10_000)
        )
        return np.where(read.present & self.readable, read.mantissa, -1)

    def dilution(self, field: int) -> Floats:
        """Return a dilution of precision, float64 ``(n,)``, NaN where absent or 99.99, which
        u-blox, MediaTek and others write without a solution.
        """
        values = self.number(field)
        values[values == _NO_DILUTION] = np.nan
        return values

    def graded(self, name: str, field: int, unit: float = 1.0) -> Columns:
        """Values times a unit, and the step that the text resolves."""
        read = decimals(self.cells(field))
        self.readable &= read.readable
        values = read.floats()
        return {
            name: values * unit,
            f"{name}_step": np.where(np.isnan(values), np.inf, unit * 10.0**-read.places),
        }

    def letter(self, field: int, allowed: str) -> Octets:
        """Return a field of one letter of those allowed, uint8 ``(n,)``, 0 where absent."""
        cells = self.cells(field)
        letter = cells.first()
        self.readable &= (cells.length == 0) | ((cells.length == 1) & one_of(letter, allowed))
        return letter

    def time(self, field: int) -> Columns:
        """Time of day, and how many decimals it has."""
        cells = self.cells(field)
        value, readable = fields.time_of_day(cells)
        self.readable &= readable
        return {"tod_ns": value, "tod_places": decimals(cells).places}

    def date(self, field: int) -> Ints:
        """Return midnight of ``ddmmyy``, Unix ns, int64 ``(n,)``."""
        value, readable = fields.date_of(self.cells(field))
        self.readable &= readable
        return value

    def position(self, field: int) -> Columns:
        """Latitude and longitude, NaN where either is absent, from ``ddmm.mmmm,N,dddmm.mmmm,E``;
        its step in minutes.
        """
        latitude, fine = self._angle(field, "NS", 90)
        longitude, finer = self._angle(field + 2, "EW", 180)
        absent = np.isnan(latitude) | np.isnan(longitude)
        step = np.where(absent, np.inf, 10.0 ** -np.minimum(fine, finer))
        return {
            "lat_deg": np.where(absent, np.nan, latitude),
            "lon_deg": np.where(absent, np.nan, longitude),
            "lat_deg_step": step,
        }

    def _angle(self, field: int, sides: str, limit: int) -> tuple[Floats, Ints]:
        read = decimals(self.cells(field))
        side = self.letter(field + 1, sides)
        scale = 10 ** np.minimum(read.places, 12)
        degrees, minutes = read.mantissa // (100 * scale), read.mantissa % (100 * scale)
        value = (degrees * (60 * scale) + minutes) / (60 * scale)
        plausible = (read.mantissa >= 0) & (minutes <= 60 * scale) & (value <= limit) & (side != 0)
        self.readable &= read.readable & (~read.present | plausible)
        return np.where(
            read.present, np.where(side == ord(sides[1]), -value, value), np.nan
        ), read.places


def gga(read: Reader) -> Columns:
    """Fix data; heights only in metres."""
    read.letter(10, "M")
    read.letter(12, "M")
    return {
        **read.time(1),
        **read.position(2),
        "quality": read.whole(6),
        "num_sv": read.whole(7),
        "hdop": read.dilution(8),
        **read.graded("height_msl_m", 9),
        **read.graded("separation_m", 11),
        "diff_age_s": read.number(13),
    }


def rmc(read: Reader) -> Columns:
    """Position, speed, course and date."""
    return {
        **read.time(1),
        "status": read.letter(2, "AV"),
        **read.position(3),
        **read.graded("speed_mps", 7, KNOT_MPS),
        **read.graded("course_deg", 8),
        "date_ns": read.date(9),
        "mode": read.letter(12, "ADEFMNPRS"),
    }


def gll(read: Reader) -> Columns:
    """Position."""
    return {
        **read.position(1),
        **read.time(5),
        "status": read.letter(6, "AV"),
        "mode": read.letter(7, "ADEFMNPRS"),
    }


def gns(read: Reader) -> Columns:
    """Fix data of several systems: the mode is the best of all systems' modes, in the order of
    ``_BEST``.
    """
    cells = read.cells(6)
    mode = np.zeros(cells.begin.size, np.uint8)
    rank = np.full(cells.begin.size, len(_BEST))
    for index in range(int(min(cells.length.max(initial=0), 8))):
        letter = cells.at(index)
        worth = _RANK[letter]
        read.readable &= (letter == 0) | (worth < len(_BEST))
        mode, rank = np.where(worth < rank, letter, mode).astype(np.uint8), np.minimum(worth, rank)
    return {
        **read.time(1),
        **read.position(2),
        "mode": mode,
        "num_sv": read.whole(7),
        "hdop": read.dilution(8),
        **read.graded("height_msl_m", 9),
        **read.graded("separation_m", 10),
        "diff_age_s": read.number(11),
    }


_BEST = "RFDPASEMN"
_RANK = np.full(256, len(_BEST))
_RANK[np.frombuffer(_BEST.encode(), np.uint8)] = np.arange(len(_BEST))


def zda(read: Reader) -> Columns:
    """Time and date."""
    columns = read.time(1)
    day, month, year = (read.whole(field) for field in (2, 3, 4))
    given = (day > 0) & (month >= 0) & (year >= 0)
    value, exists = midnight(fields.full_year(year), month, day)
    read.readable &= ~given | exists
    return {**columns, "date_ns": np.where(given & exists, value, ABSENT_NS)}


def gst(read: Reader) -> Columns:
    """Standard deviations of latitude, longitude and altitude."""
    return {
        **read.time(1),
        "sigma_n_m": read.number(6),
        "sigma_e_m": read.number(7),
        "sigma_d_m": read.number(8),
    }


def gbs(read: Reader) -> Columns:
    """Expected errors of latitude, longitude and altitude."""
    return {
        **read.time(1),
        "sigma_n_m": read.number(2),
        "sigma_e_m": read.number(3),
        "sigma_d_m": read.number(4),
    }


def vtg(read: Reader) -> Columns:
    """Course and speed; of knots and km/h the finer."""
    read.letter(2, "T")
    knots, kmh = read.graded("speed_mps", 5, KNOT_MPS), read.graded("speed_mps", 7, KMH_MPS)
    finer = kmh["speed_mps_step"] < knots["speed_mps_step"]
    speed = {name: np.where(finer, kmh[name], knots[name]) for name in knots}
    return {**read.graded("course_deg", 1), **speed, "mode": read.letter(9, "ADEFMNPRS")}


def dtm(read: Reader) -> Columns:
    """Local datum: three letters of its code, packed."""
    cells = read.cells(1)
    packed = (
        (cells.at(0).astype(np.int64) << 16) | (cells.at(1).astype(np.int64) << 8) | cells.at(2)
    )
    read.readable &= cells.length <= 3
    return {"datum": packed}


def hdt(read: Reader) -> Columns:
    """True heading; the second field of THS is its mode, V of no value."""
    letter = read.letter(2, "TAEMSV")
    return {"yaw_deg": np.where(letter == ord("V"), np.nan, read.number(1))}


def pubx00(read: Reader) -> Columns:
    """u-blox position: height on the ellipsoid, speed in km/h, vertical velocity downwards."""
    status = read.cells(8)
    return {
        **read.time(2),
        **read.position(3),
        **read.graded("height_m", 7),
        "nav_status": (status.at(0).astype(np.int64) << 8) | status.at(1),
        "h_acc_m": read.number(9),
        "v_acc_m": read.number(10),
        **read.graded("speed_mps", 11, KMH_MPS),
        **read.graded("course_deg", 12),
        "vel_d_mps": read.number(13),
        "diff_age_s": read.number(14),
        "hdop": read.dilution(15),
        "vdop": read.dilution(16),
        "num_sv": read.whole(18),
    }


def pubx04(read: Reader) -> Columns:
    """u-blox time: the date counts unless the leap seconds are the firmware's default, marked D;
    clock bias in ns, drift in ns/s.
    """
    leap = read.cells(6)
    default = np.zeros(leap.begin.size, bool)
    for index in range(1, 4):
        default |= leap.at(index) == ord("D")
    date_ns = read.date(3)
    columns = {**read.time(2), "date_ns": np.where(default, ABSENT_NS, date_ns)}
    return {**columns, "bias_s": read.number(7) / 1e9, "drift_sps": read.number(8) / 1e9}


def pgrme(read: Reader) -> Columns:
    """Garmin's estimated errors, in metres."""
    read.letter(2, "M")
    read.letter(4, "M")
    return {"h_acc_m": read.number(1), "v_acc_m": read.number(3)}


def pashr(read: Reader) -> Columns:
    """Attitude and its standard deviations; the largest of them counts."""
    read.letter(3, "T")
    deviations = np.stack([read.number(field) for field in (7, 8, 9)])
    angles = {"yaw_deg": read.number(2), "roll_deg": read.number(4), "pitch_deg": read.number(5)}
    return {**read.time(1), **angles, "attitude_acc_deg": np.fmax.reduce(deviations)}


def vnymr(read: Reader) -> Columns:
    """VectorNav attitude, magnetic field in gauss, specific force and angular rate,
    forward-right-down.
    """
    angles = {
        name: read.number(field)
        for field, name in enumerate(("yaw_deg", "pitch_deg", "roll_deg"), 1)
    }
    return {
        **angles,
        **_axes(read, "field_{}_ut", 4, GAUSS_UT),
        **_axes(read, "accel_{}_mps2", 7),
        **_axes(read, "gyro_{}_radps", 10),
    }


def vnimu(read: Reader) -> Columns:
    """VectorNav uncompensated magnetic field in gauss, specific force, angular rate, temperature,
    and pressure in kPa.
    """
    return {
        **_axes(read, "field_{}_ut", 1, GAUSS_UT),
        **_axes(read, "accel_{}_mps2", 4),
        **_axes(read, "gyro_{}_radps", 7),
        "temperature_degc": read.number(10),
        "pressure_pa": read.number(11) * 1_000,
    }


def gyoacc(read: Reader) -> Columns:
    """Unicore inertial data with date and time; temperature and odometer are left out, for they may
    mean nothing without saying so.
    """
    columns = {**read.time(2), "date_ns": read.date(1)}
    return {**columns, **_axes(read, "gyro_{}_radps", 3), **_axes(read, "accel_{}_mps2", 7)}


def imuraw(read: Reader) -> Columns:
    """Unicore raw inertial data with date and time."""
    columns = {**read.time(2), "date_ns": read.date(1)}
    return {**columns, **_axes(read, "gyro_{}_radps", 3), **_axes(read, "accel_{}_mps2", 6)}


def _axes(read: Reader, name: str, field: int, unit: float = 1.0) -> Columns:
    return {
        name.format(axis): read.number(field + index) * unit for index, axis in enumerate("xyz")
    }


READERS: Mapping[str, Callable[[Reader], Columns]] = {
    "GGA": gga, "RMC": rmc, "GLL": gll, "GNS": gns, "ZDA": zda, "GST": gst, "GBS": gbs, "VTG": vtg,
    "DTM": dtm, "HDT": hdt, "THS": hdt,
    "PUBX00": pubx00, "PUBX04": pubx04, "PGRME": pgrme, "PASHR": pashr, "VNYMR": vnymr,
    "VNIMU": vnimu, "GYOACC": gyoacc, "IMURAW": imuraw,
}  # fmt: skip
