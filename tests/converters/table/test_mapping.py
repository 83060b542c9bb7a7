"""A mapping says what it must, or is refused in a sentence that says where."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.table.mapping import load_mapping, read_mapping, ready_names

from spoofbench.errors import ConversionError
from spoofbench.schema import KINDS

GOOD = """
about = "A car logger"
clock = "sensor"
[source.imu0]
axes = "flu"
[table.log]
[table.log.time]
column = "t"
unit = "ms"
[table.log."/imu0/imu"]
accel = { columns = ["ax", "ay", "-az"], unit = "g", at_rest = "down" }
gyro_z_radps = { column = "yawrate", unit = "deg/s" }
[table.log."/gnss0/gnss/pvt"]
changes = ["lat"]
lat_deg = "lat"
fix_type = { column = "q", values = { 1 = "RTK_FIXED", 2 = "FIX_TYPE_RTK_FLOAT" } }
time_valid = { value = true }
"""


def test_a_mapping_says_what_columns_are() -> None:
    mapping = read_mapping(GOOD.encode(), "good")
    imu, pvt = mapping.tables[0].topics
    assert [(field.name, field.column, field.negate) for field in imu.fields] == [
        ("accel_x_mps2", "ax", True),
        ("accel_y_mps2", "ay", True),
        ("accel_z_mps2", "-az", True),
        ("gyro_z_radps", "yawrate", False),
    ]
    assert pvt.fields[1].values == {"1": 9, "2": 8}
    assert pvt.fields[2].constant is True
    assert mapping.tables[0].wanted() == dict.fromkeys(
        ["t", "ax", "ay", "-az", "yawrate", "lat", "q"], False
    )
    assert mapping.sources == {"source/imu0": {"axes": "flu"}}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("clock =", "clocks =", "unknown key 'clocks'; did you mean 'clock'"),
        ('"sensor"', '"senser"', "did you mean 'sensor'"),
        ("lat_deg =", "lat_degs =", "did you mean 'lat_deg'"),
        (
            'unit = "deg/s"',
            'unit = "m/s2"',
            "the unit 'm/s2' is of acceleration, but the field 'gyro_z_radps' is of angular rate",
        ),
        ('unit = "deg/s"', 'unit = "deg/ss"', "did you mean 'deg/s'"),
        ('unit = "deg/s"', 'unit = "1e999999999 deg/s"', "a positive number"),
        ('unit = "ms"', 'unit = "hPa"', "no unit of time"),
        ('unit = "ms"', "", "needs a 'unit'"),
        ('"RTK_FIXED"', '"RTK_FIX"', "none of"),
        ('"ax", "ay", "-az"', '"ax", "ay"', "must be a list of three columns"),
        (
            'at_rest = "down"',
            'at_rest = "sideways"',
            "at_rest = 'sideways' must be one of 'up', 'down'",
        ),
        ("value = true", "value = 3", "does not fit 'time_valid'"),
        ("/imu0/imu", "/imu0/imus", "is not a topic"),
        ("/imu0/imu", "/gnss0/gnss/pvt/", "is not a topic"),
        ("/imu0/imu", "/truth/attack", "attacks are made"),
        ("/imu0/imu", "/truth/clean", "attacks are made"),
        ("gyro_z_radps", "accel_z_mps2", "of acceleration"),
        (
            '[table.log.time]\ncolumn = "t"',
            "[table.log.time]\ncolumn = 5",
            "column = 5 must be a string",
        ),
        ("[table.log]", '[table.log]\nheader = false\nformat = "csv"', "needs 'columns'"),
        ("[table.log]", '[table.log]\nfiles = "../*.csv"', "within the mapping's own folder"),
        ("[table.log]", '[table.log]\ndelimiter = "ab"', "one ASCII character"),
        ("[table.log]", '[table.log]\ncolumns = ["a", "a"]', "a column twice"),
        ("[table.log]", "[table.log", "is not TOML"),
    ],
)
def test_what_is_wrong_is_said(old: str, new: str, words: str) -> None:
    assert old in GOOD
    with pytest.raises(ConversionError) as caught:
        read_mapping(GOOD.replace(old, new).encode(), "bad")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_one_text_may_stand_for_a_list_and_any_number_for_a_cell() -> None:
    text = GOOD.replace('changes = ["lat"]', 'changes = "lat"\nwhere = { q = [1, nan, true] }')
    topic = read_mapping(text.encode(), "good").tables[0].topics[1]
    assert topic.changes == ("lat",)
    assert topic.where == (("q", ("1", "nan", "true")),)


def test_a_field_cannot_be_said_twice() -> None:
    with pytest.raises(ConversionError, match="'accel_x_mps2' is duplicated"):
        read_mapping(
            GOOD.replace("gyro_z_radps = ", 'accel_x_mps2 = "ay"\ngyro_z_radps = ').encode(), "bad"
        )


def test_a_mapping_is_found_by_path_or_by_name(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    assert load_mapping(path).folder == tmp_path.resolve()
    with pytest.raises(ConversionError, match="there is no mapping 'nothing'"):
        load_mapping("nothing")


@pytest.mark.parametrize("name", ready_names())
def test_ready_mappings_are_sound(name: str) -> None:
    mapping = load_mapping(name)
    assert mapping.about
    sources = {topic.source or "reference" for table in mapping.tables for topic in table.topics}
    assert {record.removeprefix("source/") for record in mapping.sources} == sources


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_any_change_is_read_or_refused(data: st.DataObject) -> None:
    lines = GOOD.split("\n")
    words = [
        "3",
        "-1",
        "true",
        '"x"',
        "[]",
        "{}",
        "[1]",
        '["a", "b", "c"]',
        "{ column = 1 }",
        "{ value = [] }",
        "1979-05-27",
        "inf",
        "nan",
        "[[1], { a = { b = 1 } }]",
        "{ columns = 3 }",
    ]
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(lines) - 1))
        key, equals, _ = lines[place].partition(" = ")
        lines[place] = data.draw(
            st.sampled_from(
                [
                    "",
                    f"{key} = {data.draw(st.sampled_from(words))}" if equals else key,
                    lines[place - 1],
                ]
            )
        )
    kinds, said = set[str](), ""
    try:
        kinds = {
            topic.kind
            for table in read_mapping("\n".join(lines).encode(), "changed").tables
            for topic in table.topics
        }
    except ConversionError as refusal:
        said = str(refusal)
    assert kinds <= set(KINDS)
    assert bool(kinds) != ("changed" in said)
    assert "\n" not in said
