"""Android's raw GNSS measurements: satellites and signals, pseudoranges, clocks.

Sources: Android API reference, ``GnssMeasurement``, ``GnssClock`` and ``GnssStatus``; European GNSS
Agency, *Using GNSS Raw Measurements on Android Devices*, 2017, sections 2.3 and 2.4; RINEX 3.05,
tables 4 to 10.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofbench.gnss_time import DAY_NS, GPS_EPOCH_NS, WEEK_NS, leap_seconds_at_gps
from spoofbench.table import Column
from spoofbench_converters.phone.contract import positive
from spoofbench_converters.text.columns import ColumnReader, Fields

SPEED_OF_LIGHT_MPS = 299_792_458.0

# Android's constellation numbers, and the schema's by them.
_GPS, _SBAS, _GLONASS, _QZSS, _BEIDOU, _GALILEO, _NAVIC = range(1, 8)
SCHEMA_CONSTELLATION = np.array([0, 1, 2, 7, 6, 4, 3, 8], np.int32)

_TOW_DECODED, _MSEC_AMBIGUOUS, _TOD_DECODED, _E1C_SECONDARY, _TOW_KNOWN, _TOD_KNOWN = (
    8,
    16,
    128,
    2048,
    16384,
    32768,
)
_ADR_VALID = 1
_BEIDOU_LAG_NS = 14_000_000_000  # BeiDou time began 14 leap seconds after GPS time
_GLONASS_LEAD_NS = 3 * 3_600_000_000_000  # GLONASS time is that of Moscow
_E1C_PERIOD_NS = 100_000_000
_LONGEST_FLIGHT_NS = 300_000_000
_UNKNOWN_ABOVE = 1e30  # some phones write the largest float for an unknown uncertainty

# Nominal carrier in MHz, RINEX band, its attribute where phones track only one code there, name of
# the front-end band. The first of each constellation is the one that Android means where a
# measurement names no frequency.
_BANDS: dict[int, tuple[tuple[float, int, str, str], ...]] = {
    _GPS: ((1575.42, 1, "C", "L1"), (1227.6, 2, "", "L2"), (1176.45, 5, "", "L5")),
    _SBAS: ((1575.42, 1, "C", "L1"), (1176.45, 5, "", "L5")),
    _GLONASS: ((1602.0, 1, "C", "G1"), (1246.0, 2, "", "G2"), (1202.025, 3, "", "G3")),
    _QZSS: (
        (1575.42, 1, "C", "L1"),
        (1227.6, 2, "", "L2"),
        (1176.45, 5, "", "L5"),
        (1278.75, 6, "", "L6"),
    ),
    _BEIDOU: (
        (1561.098, 2, "I", "B1"),
        (1575.42, 1, "", "L1"),
        (1176.45, 5, "", "L5"),
        (1207.14, 7, "", "E5b"),
        (1268.52, 6, "", "B3"),
    ),
    _GALILEO: (
        (1575.42, 1, "", "L1"),
        (1176.45, 5, "", "L5"),
        (1207.14, 7, "", "E5b"),
        (1278.75, 6, "", "L6"),
    ),
    _NAVIC: ((1176.45, 5, "", "L5"), (2492.028, 9, "", "S"), (1575.42, 1, "", "L1")),
}
_TOLERANCE_MHZ = 5.0  # the channels of GLONASS lie up to 4 MHz from its carrier
_ATTRIBUTES = ("", *(chr(code) for code in range(ord("A"), ord("Z") + 1)))
SIGNALS = tuple(f"{band}{attribute}" for band in range(1, 10) for attribute in _ATTRIBUTES)
RF_BANDS = tuple(dict.fromkeys(band[3] for bands in _BANDS.values() for band in bands))


class Satellites(NamedTuple):
    """Satellites and signals of n rows."""

    columns: Fields  # constellation, svid, signal, frequency_slot
    android: NDArray[np.int64]  # Android's number of the constellation, 0 where unknown
    carrier_hz: NDArray[np.float64]  # NaN where unknown
    band: NDArray[np.int32]  # code into RF_BANDS


def satellites(reader: ColumnReader) -> Satellites:
    """Read which satellites and signals the rows are of.

    A signal is RINEX band and attribute. Where the log names no code, GPS, SBAS, QZSS and GLONASS
    L1 are taken as C/A and BeiDou B1 as 2I, which is what phones track there; elsewhere the band
    stands alone.
    """
    number, present = reader.exact(("ConstellationType",))
    android = np.where(present & (number > 0) & (number < SCHEMA_CONSTELLATION.size), number, 0)
    svid, has_svid = reader.exact(("Svid",))
    given = reader.floats("CarrierFrequencyHz")
    given = np.where(given > 0, given, np.nan)
    carrier, band, signal = _signals(android, given, reader.texts("CodeType"))
    slot, has_slot = _slots(android, given, svid)
    known = has_svid & (svid > 0) & (svid < 1000) & ~((android == _GLONASS) & (svid > 92))
    return Satellites(
        {
            "constellation": Column(SCHEMA_CONSTELLATION[android], android > 0),
            "svid": Column(
                np.where(known, within_constellation(android, svid), 0).astype(np.uint32), known
            ),
            "signal": Column(signal, None, SIGNALS),
            "frequency_slot": Column(slot.astype(np.int32), has_slot),
        },
        android,
        carrier,
        band,
    )


def within_constellation(android: NDArray[np.int64], svid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return satellites' numbers within their constellations: QZSS is numbered from 193, by its L1S
    signal from 183 (RINEX 3.05, 3.5).

    Args:
        android: Android's number of the constellation, ``(n,)``.
        svid: as Android numbers satellites, ``(n,)``.

    Returns:
        int64 ``(n,)``.
    """
    first = np.where(svid > 192, 192, np.where(svid > 182, 182, 0))
    return svid - np.where(android == _QZSS, first, 0)


def _signals(
    android: NDArray[np.int64], given_hz: NDArray[np.float64], codes: NDArray[np.bytes_]
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    """Return carrier frequencies, front-end bands and RINEX signals, as codes."""
    carrier, band, signal = (
        given_hz.copy(),
        np.full(android.size, -1, np.int32),
        np.full(android.size, -1, np.int32),
    )
    letter = (
        codes.astype("S2").view(np.uint8).reshape(-1, 2)
        if android.size
        else np.zeros((0, 2), np.uint8)
    )
    attribute = np.where(
        (letter[:, 1] == 0) & (letter[:, 0] >= ord("A")) & (letter[:, 0] <= ord("Z")),
        letter[:, 0].astype(np.int32) - 64,
        0,
    )
    for constellation, bands in _BANDS.items():
        selected = android == constellation
        if not selected.any():
            continue
        for place, (mhz, number, default, name) in enumerate(bands):
            rows = selected & (np.abs(given_hz - mhz * 1e6) < _TOLERANCE_MHZ * 1e6)
            if place == 0:
                unnamed = selected & np.isnan(given_hz)
                carrier[unnamed & (constellation != _GLONASS)] = mhz * 1e6
                rows |= unnamed
            band[rows] = RF_BANDS.index(name)
            code = np.where(attribute == 0, _ATTRIBUTES.index(default), attribute)
            signal[rows] = ((number - 1) * len(_ATTRIBUTES) + code)[rows]
    return carrier, band, signal


def _slots(
    android: NDArray[np.int64], given_hz: NDArray[np.float64], svid: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the frequency slots of GLONASS, from the carrier, or where Android has only them
    instead of the satellite.
    """
    first = np.rint((given_hz - 1602e6) / 562_500)
    second = np.rint((given_hz - 1246e6) / 437_500)
    slot = np.where(np.abs(first) <= 7, first, np.where(np.abs(second) <= 7, second, np.nan))
    slot = np.where(np.isnan(slot) & (svid >= 93) & (svid <= 106), svid - 100.0, slot)
    known = (android == _GLONASS) & ~np.isnan(slot)
    return np.where(known, slot, 0).astype(np.int64), known


class Times(NamedTuple):
    """The receiver's clock at n measurements."""

    gps_ns: NDArray[
        np.int64
    ]  # time that the receiver claims, since the GPS epoch, whole nanoseconds
    rest_ns: NDArray[np.float64]  # to be added to it
    leap_s: NDArray[np.int64]
    known: NDArray[np.bool_]  # whether the receiver claims a time

    def utc_ns(self) -> NDArray[np.int64]:
        """Return the claimed time as Unix UTC, int64 ``(n,)``."""
        return self.gps_ns + GPS_EPOCH_NS - self.leap_s * 1_000_000_000


def receiver_times(reader: ColumnReader) -> Times:
    """Read the time that the receiver claims: its hardware clock minus that clock's bias, as the
    row states it; ``(n,)`` each.
    """
    clock, has_clock = reader.exact(("TimeNanos",))
    bias, has_bias = reader.exact(("FullBiasNanos",))
    leap, has_leap = reader.exact(("LeapSecond",))
    known = has_clock & has_bias & (bias != 0)
    with np.errstate(over="ignore"):
        gps = np.where(known, clock - bias, 0)
    known &= (gps > 0) & (gps < 2**62)
    rest = np.nan_to_num(reader.floats("TimeOffsetNanos")) - np.nan_to_num(
        reader.floats("BiasNanos")
    )
    return Times(
        np.where(known, gps, 0), rest, np.where(has_leap, leap, leap_seconds_at_gps(gps)), known
    )


def week_and_tow(gps_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return GPS week and time of week in seconds, ``(n,)`` each, of nanoseconds since the GPS
    epoch.
    """
    return gps_ns // WEEK_NS, (gps_ns % WEEK_NS).astype(np.float64) / 1e9


def observations(reader: ColumnReader, seen: Satellites, times: Times) -> Fields:
    """Read the measurements, fields ``(n,)``.

    The pseudorange is the speed of light times the claimed time of reception minus the time of
    transmission, where the tracking state says that the latter is known without ambiguity, or what
    the log itself says. It holds the receiver's clock error as far as the row's own bias does not.
    """
    wavelength = SPEED_OF_LIGHT_MPS / seen.carrier_hz
    adr_state, has_adr = reader.exact(("AccumulatedDeltaRangeState",))
    valid = has_adr & ((adr_state & _ADR_VALID) != 0)
    adr, adr_std = (
        reader.floats("AccumulatedDeltaRangeMeters"),
        _known(reader.floats("AccumulatedDeltaRangeUncertaintyMeters")),
    )
    range_rate_std = _known(reader.floats("PseudorangeRateUncertaintyMetersPerSecond"))
    pseudorange = _pseudoranges(reader, seen, times)
    received_std = _known(reader.floats("ReceivedSvTimeUncertaintyNanos"))
    return {
        **seen.columns,
        "pseudorange_m": pseudorange,
        "pseudorange_std_m": np.where(
            np.isnan(pseudorange), np.nan, received_std * (SPEED_OF_LIGHT_MPS * 1e-9)
        ),
        "carrier_cycles": np.where(valid, adr / wavelength, np.nan),
        "carrier_std_cycles": np.where(valid, adr_std / wavelength, np.nan),
        "doppler_hz": -reader.floats("PseudorangeRateMetersPerSecond") / wavelength,
        "doppler_std_hz": range_rate_std / wavelength,
        "cn0_dbhz": positive(reader.floats("Cn0DbHz")),
    }


def _pseudoranges(reader: ColumnReader, seen: Satellites, times: Times) -> NDArray[np.float64]:
    """Pseudoranges in metres, NaN where ambiguous or beyond 0.3 s of flight: section 2.4 of the
    agency's paper.
    """
    state, has_state = reader.exact(("State",))
    sent, has_sent = reader.exact(("ReceivedSvTimeNanos",))
    glonass, galileo = seen.android == _GLONASS, seen.android == _GALILEO
    week = (state & (_TOW_DECODED | _TOW_KNOWN)) != 0
    day = (state & (_TOD_DECODED | _TOD_KNOWN)) != 0
    secondary = galileo & ~week & ((state & _E1C_SECONDARY) != 0)
    system = times.gps_ns - np.where(seen.android == _BEIDOU, _BEIDOU_LAG_NS, 0)
    system += np.where(glonass, _GLONASS_LEAD_NS - times.leap_s * 1_000_000_000, 0)
    period = np.where(glonass, DAY_NS, np.where(secondary, _E1C_PERIOD_NS, WEEK_NS))
    flight = (system - sent) % period
    flight = np.where((flight > period // 2) & ~secondary, flight - period, flight)
    usable = (
        has_state & has_sent & times.known & (seen.android > 0) & ((state & _MSEC_AMBIGUOUS) == 0)
    )
    usable &= (
        np.where(glonass, day, week | secondary) & (flight > 0) & (flight < _LONGEST_FLIGHT_NS)
    )
    computed = np.where(usable, (flight + times.rest_ns) * (SPEED_OF_LIGHT_MPS * 1e-9), np.nan)
    logged = reader.floats("RawPseudorangeMeters")
    return np.where(np.isnan(logged), computed, logged)


def _known(uncertainty: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where((uncertainty >= 0) & (uncertainty < _UNKNOWN_ABOVE), uncertainty, np.nan)


def clock_columns(reader: ColumnReader) -> Fields:
    """Read the receiver's clock but for its bias."""
    return {
        "drift_sps": reader.floats("DriftNanosPerSecond") * 1e-9,
        "acc_s": _known(reader.floats("BiasUncertaintyNanos")) * 1e-9,
        "drift_acc_sps": _known(reader.floats("DriftUncertaintyNanosPerSecond")) * 1e-9,
    }
