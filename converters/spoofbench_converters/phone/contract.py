"""What all formats of phone logs share: the options, reasons of rejects, axes, units, and the
fields of sensors' rows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STANDARD_GRAVITY_MPS2 = 9.80665
AXES = ("x", "y", "z")
DEVICE_AXES = "x to the right of the screen, y to its top, z out of it"
BODY = "forward to the top of the screen, right to its right, down into it"

NO_TIME = "a row without a time"
NO_POSITION = "a fix without a position"
OLDER = "a fix older than the log"


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the converter.

    Attributes:
        date: date or date and time (ISO 8601, UTC where no zone is given) at which a log without
            absolute time began.
        source: the one location provider to convert, where a log has several: ``GPS``, ``FLP`` or
            ``NLP``.
        append_clock: where the clock of a GnssLogger log jumps back, go on a median interval after
            the last row, instead of rejecting the rows that are behind.
        session: the recording's session id, instead of one from the log's digest.
    """

    date: str | None = None
    source: str | None = None
    append_clock: bool = False
    session: str | None = None


def known(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values ``(n,)`` with those below zero, by which phones say that they do not know,
    NaN.
    """
    return np.where(values < 0, np.nan, values)


def positive(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values ``(n,)`` with those not above zero NaN.

    Android gives 0 for an accuracy that it has not (``Location.getAccuracy``) and for the C/N0 of a
    satellite not received, iOS less.
    """
    return np.where(values > 0, values, np.nan)
