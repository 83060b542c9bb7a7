"""Check of magnetometers: unit and bias, against the Earth's field."""

import numpy as np

from spoofbench.doctor.finding import Finding
from spoofbench.recording import Recording

EARTH_TEXT = "the Earth's is 22 to 67"
"""In uT, at the surface (IGRF-13; Alken et al., Earth, Planets and Space 73, 2021)."""

LEAST_UT, MOST_UT = 10.0, 110.0
"""With what iron near a sensor adds or takes away."""

FIELD = ("field_x_ut", "field_y_ut", "field_z_ut")
LEAST_ROWS = 50
UNITS = {
    "it is in mT": 1e-3,
    "it is in gauss": 1e-2,
    "it is in milligauss": 10.0,
    "it is in nT": 1e3,
    "it is in gauss, but declared in tesla": 1e4,
    "it is in uT, but declared in tesla": 1e6,
    "it is in milligauss, but declared in tesla": 1e7,
    "it is in nT, but declared in tesla": 1e9,
    "it is in tesla": 1e-6,
}
MOST_BIAS = 50
"""Iron near a sensor adds less than so many times the Earth's field: a factor above it is a unit.
"""

MOST_SPAN_UT = 2 * MOST_UT
"""What turning in the Earth's field can change of one axis, whatever is added to it."""


def fields(recording: Recording) -> list[Finding]:
    """Magnetic flux densities that are not of the Earth's size: another unit, or a bias."""
    findings = []
    for topic in recording.topics("mag"):
        field = np.stack([recording[topic][name] for name in FIELD], axis=1)
        field = field[np.isfinite(field).all(axis=1)]
        if len(field) < LEAST_ROWS:
            continue
        size = float(np.median(np.linalg.norm(field, axis=1)))
        if size == 0 or LEAST_UT <= size <= MOST_UT:
            continue
        text = (
            f"the magnetic flux density is {size:,.{0 if size > 10 else 4}f} uT in the median "
            f"where {EARTH_TEXT}"
        )
        span = float(np.ptp(np.percentile(field, (1, 99), axis=0), axis=0).max())
        unit = next(
            (unit for unit, factor in UNITS.items() if LEAST_UT <= size / factor <= MOST_UT), None
        )
        is_bias = MOST_UT < size < MOST_BIAS * MOST_UT and span <= MOST_SPAN_UT
        if is_bias:
            advice = (
                "estimate the bias, such as of iron near the sensor, before headings are taken "
                "from it"
            )
            findings.append(
                Finding("mag-bias", "info", topic, f"{text}, but changes like it", advice)
            )
        elif unit is not None:
            findings.append(
                Finding(
                    "mag-unit",
                    "error",
                    topic,
                    f"{text}: {unit}",
                    "convert again with the right unit",
                )
            )
        else:
            findings.append(
                Finding(
                    "mag-scale", "warning", topic, text, "check unit and scale of the magnetometer"
                )
            )
    return findings
