"""Units are those of the field, and values in them come back as they were."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoofbench_converters.table.units import UNITS, dimension_of, read_unit, unit_for

from spoofbench.errors import ConversionError
from spoofbench.schema import KINDS


@pytest.mark.parametrize(
    ("field", "unit", "raw", "value"),
    [
        ("accel_x_mps2", "g", 1.0, 9.80665),
        ("accel_x_mps2", None, 1.5, 1.5),
        ("gyro_x_radps", "deg/s", 180.0, math.pi),
        ("gyro_x_radps", "rpm", 30.0, math.pi),
        ("field_x_ut", "G", 0.5, 50.0),
        ("field_x_ut", "T", 2.5e-5, 25.0),
        ("course_deg", "rad", math.pi, 180.0),
        ("lat_deg", "1e-7 deg", 473891561.0, 47.3891561),
        ("height_m", "mm", 1601435.0, 1601.435),
        ("speed_mps", "km/h", 36.0, 10.0),
        ("speed_mps", "knots", 1.0, 1852 / 3600),
        ("speed_mps", "cm/s", 123.0, 1.23),
        ("pressure_pa", "hPa", 1013.25, 101325.0),
        ("pressure_pa", "psi", 1.0, 6894.757293168361),
        ("temperature_degc", "K", 273.15, 0.0),
        ("temperature_degc", "degF", 212.0, 100.0),
        ("tow_s", "ms", 511214500.0, 511214.5),
        ("pdop", "0.01 1", 254.0, 2.54),
        ("cn0_dbhz", None, 45.0, 45.0),
    ],
)
def test_values(field: str, unit: str | None, raw: float, value: float) -> None:
    assert unit_for(field, unit).to_schema(np.array([raw]))[0] == pytest.approx(value, rel=1e-15)


def test_a_tenth_of_a_micro_degree_is_the_nearest_decimal() -> None:
    raw = np.arange(473891561, 473892561, dtype=np.float64)
    values = unit_for("lat_deg", "1e-7 deg").to_schema(raw)
    assert values.tolist() == [
        float(f"{int(each) // 10**7}.{int(each) % 10**7:07d}") for each in raw
    ]


@given(st.sampled_from(UNITS), st.lists(st.floats(-1e9, 1e9, width=32), min_size=1, max_size=20))
def test_values_come_back(name: str, raw: list[float]) -> None:
    unit = read_unit(name)
    values = unit.to_schema(np.array(raw))
    again = unit.to_schema(unit.from_schema(values))
    assert np.array_equal(again, values)


def test_every_field_has_a_dimension_with_a_unit() -> None:
    for kind in KINDS.values():
        for field in kind.fields:
            assert unit_for(field, None).dimension == dimension_of(field)
    assert dimension_of("speed_mps") == "speed"
    assert dimension_of("accel_x_mps2") == "acceleration"
    assert dimension_of("cov_vel_nn_m2ps2") == "velocity variance"


@pytest.mark.parametrize(
    ("field", "unit"),
    [
        ("speed_mps", "deg"),
        ("lat_deg", "m"),
        ("pdop", "m"),
        ("height_m", "foot"),
        ("lat_deg", "0 deg"),
    ],
)
def test_what_does_not_fit_is_refused(field: str, unit: str) -> None:
    with pytest.raises(ConversionError, match="unit"):
        unit_for(field, unit)
