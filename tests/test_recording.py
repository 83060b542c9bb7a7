"""Recordings: frozen, exact about absence, blind where they must be."""

import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench.errors import RecordingError
from spoofbench.recording import Interval, Recording
from spoofbench.schema import KINDS, SENSOR_KINDS, topic_of
from spoofbench.table import Column, Table

WORDS = st.sampled_from(["1C", "5Q", "2X", "", "é"])


@st.composite
def tables(draw: st.DrawFn, kind: str | None = None) -> Table:
    """Any table of any kind: fields absent, present in some rows, or in all."""
    kind = kind or draw(st.sampled_from(sorted(KINDS)))
    rows = draw(st.integers(0, 8))
    times = np.array(
        sorted(
            draw(st.lists(st.integers(0, 3) | st.integers(0, 2**62), min_size=rows, max_size=rows))
        ),
        np.int64,
    )
    columns: dict[str, Any] = {}
    for field in KINDS[kind].fields.values():
        if not draw(st.booleans()):
            continue
        if field.category == "text":
            columns[field.name] = draw(st.lists(st.none() | WORDS, min_size=rows, max_size=rows))
        elif field.category == "bytes":
            columns[field.name] = draw(
                st.lists(st.none() | st.binary(max_size=3), min_size=rows, max_size=rows)
            )
        elif field.category == "float":
            columns[field.name] = np.array(
                draw(st.lists(st.floats(width=32), min_size=rows, max_size=rows)), field.dtype
            )
        else:
            top = 1 if field.category == "boolean" else 100
            values = np.array(
                draw(st.lists(st.integers(0, top), min_size=rows, max_size=rows)), field.dtype
            )
            columns[field.name] = Column(
                values, np.array(draw(st.lists(st.booleans(), min_size=rows, max_size=rows)), bool)
            )
    return Table(kind, times, columns)


@given(tables())
def test_pickled_table_is_equal(table: Table) -> None:
    assert pickle.loads(pickle.dumps(table)) == table


@given(tables(), st.integers(0, 8))
def test_prefix_and_rest_make_the_whole(table: Table, cut: int) -> None:
    head, tail = table.take(slice(0, cut)), table.take(slice(cut, None))
    assert len(head) + len(tail) == len(table)
    for name in table:
        np.testing.assert_array_equal(
            np.concatenate([head.valid(name), tail.valid(name)]), table.valid(name)
        )
        if table.column(name).categories is None:
            np.testing.assert_array_equal(np.concatenate([head[name], tail[name]]), table[name])
        else:
            assert head.texts(name) + tail.texts(name) == table.texts(name)


@given(tables(), st.integers(0, 8))
def test_the_past_does_not_know_the_future_words(table: Table, cut: int) -> None:
    head = table.take(slice(0, cut))
    for name in head:
        words = head.column(name).categories
        if words is not None:
            assert set(words) == {word for word in head.texts(name) if word is not None}


@given(tables())
def test_no_array_can_be_made_writable(table: Table) -> None:
    arrays = [
        table.time_ns,
        *(table[name] for name in table),
        *(table.take(slice(1, None))[name] for name in table),
    ]
    for array in arrays:
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True


@given(tables())
def test_absent_columns_and_absent_values_are_equal(table: Table) -> None:
    named = {name: table.column(name) for name in table.kind.fields}
    assert Table(table.kind.name, table.time_ns, named) == table
    topic = topic_of("s" if table.kind.name in SENSOR_KINDS else "", table.kind.name)
    assert (
        Recording({topic: Table(table.kind.name, table.time_ns, named)}).digest()
        == Recording({topic: table}).digest()
    )


@given(tables())
def test_the_last_row_of_each_time_is_what_a_dictionary_by_time_keeps(table: Table) -> None:
    row_of = {time: row for row, time in enumerate(table.time_ns.tolist())}
    assert table.last_per_time() == table.take(np.array(list(row_of.values()), int))


def _imu(times: list[int]) -> Table:
    return Table(
        "imu", np.array(times, np.int64), {"accel_x_mps2": np.arange(len(times), dtype=float)}
    )


def test_until_includes_its_time_and_between_is_half_open() -> None:
    recording = Recording({"/imu0/imu": _imu([1, 2, 2, 3])})
    assert recording.until(2)["/imu0/imu"].time_ns.tolist() == [1, 2, 2]
    assert recording.between(1, 3)["/imu0/imu"].time_ns.tolist() == [1, 2, 2]
    assert recording["/imu0/imu"].between(2, 3).time_ns.tolist() == [2, 2]
    assert recording.span == Interval(1, 4)


def test_blind_is_an_allow_list() -> None:
    everything: dict[str, Table] = {
        f"/s/{kind}": Table(kind, np.zeros(0, np.int64), {}) for kind in SENSOR_KINDS
    }
    everything["/reference/pva"] = Table("reference/pva", np.zeros(0, np.int64), {})
    everything["/truth/attack"] = Table("truth/attack", np.zeros(0, np.int64), {})
    everything["/truth/clean"] = Table("truth/clean", np.zeros(0, np.int64), {})
    metadata = {
        "recording": {"clock": "recorder", "session_id": "secret"},
        "primary": {"imu": "s"},
        "source/s": {"axes": "frd", "device": "secret"},
        "origin": {"file": "secret"},
        "whatever": {"attack": "secret"},
    }
    blind = Recording(everything, metadata).blind()
    assert blind.kinds == SENSOR_KINDS
    assert {name: dict(record) for name, record in blind.metadata.items()} == {
        "recording": {"clock": "recorder"},
        "primary": {"imu": "s"},
        "source/s": {"axes": "frd"},
    }


def test_primary_source_comes_first() -> None:
    recording = Recording({"/a/imu": _imu([1]), "/b/imu": _imu([2])}, {"primary": {"imu": "b"}})
    assert recording.primary("imu").time_ns.tolist() == [2]
    assert recording.topics("imu") == ("/b/imu", "/a/imu")


def test_tables_load_when_used_and_once() -> None:
    loads: list[int] = []

    def load() -> Table:
        loads.append(1)
        return _imu([1])

    recording = Recording({"/imu0/imu": load})
    assert recording.kinds == {"imu"}
    assert not loads
    assert recording["/imu0/imu"] is recording["/imu0/imu"]
    assert len(loads) == 1


def test_digest_sees_any_change() -> None:
    base = Recording({"/a/imu": _imu([1, 2])}, {"primary": {"imu": "a"}})
    others = [
        Recording({"/b/imu": _imu([1, 2])}, base.metadata),
        Recording({"/a/imu": _imu([1, 3])}, base.metadata),
        Recording(
            {"/a/imu": _imu([1, 2]).replace(accel_x_mps2=np.array([0.0, 1.5]))}, base.metadata
        ),
        Recording(
            {"/a/imu": _imu([1, 2]).replace(accel_x_mps2=np.array([-0.0, 1.0]))}, base.metadata
        ),
        base.with_metadata({"source/a": {"axes": "flu"}}),
    ]
    assert len({recording.digest() for recording in [base, *others]}) == 6
    assert base.with_metadata({"origin": {"file": "x"}}).digest() == base.digest()


@pytest.mark.parametrize(
    ("kind", "times", "columns", "message"),
    [
        ("imus", [1], {}, "not a kind"),
        ("imu", [2, 1], {}, "backwards at row 1"),
        ("imu", [1.5], {}, "must be int64"),
        ("imu", [1], {"lat_deg": [1.0]}, "no field 'lat_deg'"),
        ("imu", [1], {"accel_x_mps2": [1.0, 2.0]}, "has shape"),
        ("gnss/pvt", [1], {"num_sv": [-1]}, "do not fit"),
        ("gnss/pvt", [1], {"num_sv": [1.5]}, "do not fit"),
        ("gnss/signal", [1], {"signal": [b"1C"]}, "must be text"),
    ],
)
def test_what_does_not_fit_is_refused(
    kind: str, times: list[Any], columns: dict[str, Any], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        Table(kind, np.array(times), columns)
