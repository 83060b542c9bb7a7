"""Units that a mapping may name, and how their values become values of a schema field.

Each dimension has one unit in the schema, the one that field names end in; every other unit of that
dimension stands here with its factor. Factors are exact: SI Brochure, 9th ed. (2019), and NIST SP
811 (2008), appendix B.
"""

import difflib
import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from spoofbench.errors import ConversionError

_PI_180 = Fraction(1, 180)  # times pi

# By dimension: the ending of the schema's fields, then units with what one of them is in the
# schema's unit. A pair (factor, power of pi); a third member is the unit's zero point in its own
# unit.
_TABLE: dict[
    str, tuple[str, dict[str, tuple[Fraction | int, int] | tuple[Fraction | int, int, Fraction]]]
] = {
    "acceleration": (
        "_mps2",
        {
            "m/s2": (1, 0),
            "cm/s2": (Fraction(1, 100), 0),
            "mm/s2": (Fraction(1, 1000), 0),
            "g": (Fraction("9.80665"), 0),
            "mg": (Fraction("0.00980665"), 0),
            "Gal": (Fraction(1, 100), 0),
            "ft/s2": (Fraction("0.3048"), 0),
        },
    ),
    "angular rate": (
        "_radps",
        {
            "rad/s": (1, 0),
            "mrad/s": (Fraction(1, 1000), 0),
            "deg/s": (_PI_180, 1),
            "mdeg/s": (_PI_180 / 1000, 1),
            "deg/h": (_PI_180 / 3600, 1),
            "rpm": (Fraction(1, 30), 1),
        },
    ),
    "magnetic flux density": (
        "_ut",
        {
            "uT": (1, 0),
            "nT": (Fraction(1, 1000), 0),
            "mT": (1000, 0),
            "T": (10**6, 0),
            "G": (100, 0),
            "mG": (Fraction(1, 10), 0),
        },
    ),
    "angle": (
        "_deg",
        {
            "deg": (1, 0),
            "arcmin": (Fraction(1, 60), 0),
            "arcsec": (Fraction(1, 3600), 0),
            "rad": (180, -1),
            "mrad": (Fraction(180, 1000), -1),
            "semicircle": (180, 0),
        },
    ),
    "length": (
        "_m",
        {
            "m": (1, 0),
            "km": (1000, 0),
            "dm": (Fraction(1, 10), 0),
            "cm": (Fraction(1, 100), 0),
            "mm": (Fraction(1, 1000), 0),
            "ft": (Fraction("0.3048"), 0),
            "mi": (Fraction("1609.344"), 0),
            "nmi": (1852, 0),
        },
    ),
    "speed": (
        "_mps",
        {
            "m/s": (1, 0),
            "dm/s": (Fraction(1, 10), 0),
            "cm/s": (Fraction(1, 100), 0),
            "mm/s": (Fraction(1, 1000), 0),
            "km/h": (Fraction(10, 36), 0),
            "knot": (Fraction(1852, 3600), 0),
            "ft/min": (Fraction("0.00508"), 0),
            "mph": (Fraction("0.44704"), 0),
            "ft/s": (Fraction("0.3048"), 0),
        },
    ),
    "pressure": (
        "_pa",
        {
            "Pa": (1, 0),
            "hPa": (100, 0),
            "kPa": (1000, 0),
            "mbar": (100, 0),
            "bar": (10**5, 0),
            "atm": (101325, 0),
            "psi": (Fraction(4448221615260500, 645160000000), 0),
            "inHg": (Fraction("3386.389"), 0),
            "mmHg": (Fraction("133.322387415"), 0),
        },
    ),
    "temperature": (
        "_degc",
        {
            "degC": (1, 0),
            "K": (1, 0, Fraction("273.15")),
            "degF": (Fraction(5, 9), 0, Fraction(32)),
        },
    ),
    "time": (
        "_s",
        {
            "s": (1, 0),
            "ms": (Fraction(1, 10**3), 0),
            "us": (Fraction(1, 10**6), 0),
            "ns": (Fraction(1, 10**9), 0),
            "min": (60, 0),
            "h": (3600, 0),
            "day": (86400, 0),
        },
    ),
    "frequency": (
        "_hz",
        {"Hz": (1, 0), "mHz": (Fraction(1, 1000), 0), "kHz": (1000, 0), "MHz": (10**6, 0)},
    ),
    "carrier-to-noise density": ("_dbhz", {"dBHz": (1, 0)}),
    "level": ("_db", {"dB": (1, 0)}),
    "phase": ("_cycles", {"cycle": (1, 0)}),
    "clock drift": (
        "_sps",
        {
            "s/s": (1, 0),
            "ns/s": (Fraction(1, 10**9), 0),
            "ppm": (Fraction(1, 10**6), 0),
            "ppb": (Fraction(1, 10**9), 0),
        },
    ),
    "position variance": (
        "_m2",
        {"m2": (1, 0), "cm2": (Fraction(1, 10**4), 0), "mm2": (Fraction(1, 10**6), 0)},
    ),
    "velocity variance": ("_m2ps2", {"m2/s2": (1, 0)}),
    "pure number": ("", {"1": (1, 0), "%": (Fraction(1, 100), 0)}),
}

_ALIASES = {
    "m/s^2": "m/s2",
    "knots": "knot",
    "kn": "knot",
    "kph": "km/h",
    "dps": "deg/s",
    "Gauss": "G",
    "gauss": "G",
    "µT": "uT",
    "°": "deg",
    "°C": "degC",
}

UNITS = tuple(name for _, units in _TABLE.values() for name in units)
"""Every unit's name."""

_SUFFIXES = sorted(
    ((suffix, dimension) for dimension, (suffix, _) in _TABLE.items() if suffix),
    key=lambda pair: -len(pair[0]),
)


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of one dimension: ``value = (raw - zero) * factor`` in the schema's unit."""

    name: str
    dimension: str
    factor: Fraction
    pi: int = 0
    zero: Fraction = Fraction(0)

    def to_schema(self, raw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values in the schema's unit, ``(n,)``, infinite where beyond measure.

        A factor 1/k divides, so that a decimal stays the nearest number.
        """
        shifted = raw - float(self.zero) if self.zero else raw
        with np.errstate(over="ignore", invalid="ignore"):  # damage makes signalling NaNs
            if self.pi:
                return np.asarray(shifted * (float(self.factor) * math.pi**self.pi))
            return np.asarray(
                shifted * float(self.factor.numerator) / float(self.factor.denominator)
            )

    def from_schema(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return raw values that :meth:`to_schema` turns into these wherever such exist, else the
        nearest; ``(n,)``.
        """
        raw = values / (float(self.factor) * math.pi**self.pi) + float(self.zero)
        best = raw.copy()
        below, above = raw, raw
        for _ in range(4):
            below, above = np.nextafter(below, -np.inf), np.nextafter(above, np.inf)
            for candidate in (below, above):
                better = (self.to_schema(best) != values) & (self.to_schema(candidate) == values)
                best = np.where(better, candidate, best)
        return np.asarray(best)


def dimension_of(field: str) -> str:
    """Return the dimension of a schema field, as its name ends."""
    return next(
        (dimension for suffix, dimension in _SUFFIXES if field.endswith(suffix)), "pure number"
    )


def unit_for(field: str, name: str | None) -> Unit:
    """Return the unit of a column that is to fill a field; None: the field's own. A number may
    stand before it: ``1e-7 deg``.

    Raises:
        ConversionError: there is no such unit, or it is of another dimension than the field.
    """
    dimension = dimension_of(field)
    if name is None:
        return Unit(next(iter(_TABLE[dimension][1])), dimension, Fraction(1))
    unit = read_unit(name)
    if unit.dimension != dimension:
        own = ", ".join(repr(each) for each in _TABLE[dimension][1])
        raise ConversionError(
            f"the unit {name!r} is of {unit.dimension}, but the field {field!r} is of "
            f"{dimension}: use one of {own}"
        )
    return unit


def read_unit(text: str) -> Unit:
    """Return the unit of a text such as ``km/h`` or ``0.001 deg``.

    Raises:
        ConversionError: there is no such unit.
    """
    number, _, name = text.strip().rpartition(" ")
    name = _ALIASES.get(name, name)
    for dimension, (_, units) in _TABLE.items():
        if name in units:
            factor, pi, zero = (*units[name], Fraction(0))[:3]
            return Unit(
                text, dimension, Fraction(factor) * _multiple(number, text), pi, Fraction(zero)
            )
    near = difflib.get_close_matches(name, UNITS, 1, 0.5)
    hint = f"did you mean {near[0]!r}?" if near else f"units are {', '.join(UNITS)}"
    raise ConversionError(f"there is no unit {text!r}; {hint}")


def _multiple(number: str, text: str) -> Fraction:
    number = number.strip() or "1"
    try:
        within = len(number) <= 24 and 1e-30 < float(number) < 1e30
    except ValueError:
        within = False
    if not within:
        raise ConversionError(
            f"there is no unit {text!r}: what stands before a unit must be a positive number, as "
            "in '1e-7 deg'"
        )
    return Fraction(number)
