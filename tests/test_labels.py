"""Labels of real attacks: every time base means one instant, and what does not fit is refused in a
sentence that says what to do.
"""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofbench import api, info
from spoofbench.codec import read, write
from spoofbench.errors import ConfigError, RecordingError
from spoofbench.labels import label_file, label_recording, read_labels
from spoofbench.recording import (
    Interval,
    Recording,
    attacked_intervals,
    clean_intervals,
    is_really_attacked,
)
from spoofbench.table import Table
from spoofbench.testing.recordings import spoofed_drive

S = 1_000_000_000
START = datetime(2024, 5, 1, 9, 0, tzinfo=UTC)
START_NS = int(START.timestamp()) * S
GPS_MINUS_UTC_S = 18

HEAD = """
labelled_by = "J. Doe"
source = "a report"
time_check = "the position jumps at both edges"
"""


def flight() -> Recording:
    """An hour of epochs, one per second."""
    time_ns = START_NS + np.arange(3600) * S
    columns = {"lat_deg": np.full(3600, 48.0), "lon_deg": np.full(3600, 11.0)}
    return Recording({"/gnss0/gnss/pvt": Table("gnss/pvt", time_ns, columns)})


def labelled(folder: Path, text: str, name: str = "labels.toml") -> Recording:
    path = folder / name
    path.write_text(text)
    return label_recording(flight(), read_labels(path))


def toml(*intervals: tuple[str, str, str], time_base: str | None = "recording") -> str:
    """A file of (state, start, end) in TOML."""
    parts = [HEAD, f"time_base = {time_base!r}" if time_base else ""]
    for state, start, end in intervals:
        kind = 'class = "replay"' if state == "attacked" else ""
        parts.append(f"[[{state}]]\nstart = {start}\nend = {end}\n{kind}")
    return "\n".join(parts)


ATTACKED = Interval(START_NS + 600 * S, START_NS + 900 * S)
CLEAN = Interval(START_NS, START_NS + 600 * S)


@pytest.mark.parametrize(
    ("time_base", "texts"),
    [
        ("utc", ("2024-05-01T09:10:00", "2024-05-01T09:15:00")),
        ("utc", ('"2024-05-01 09:10:00.000"', "2024-05-01T11:15:00+02:00")),
        (None, ("2024-05-01T09:10:00Z", '"2024-05-01T04:15:00-05:00"')),
        ("gps", ("2024-05-01T09:10:18", "2024-05-01T09:15:18")),
        ("recording", ("600", '"900.0"')),
        ("+05:30", ("2024-05-01T14:40:00", "2024-05-01T14:45:00")),
    ],
)
def test_every_time_base_names_the_same_interval(
    time_base: str | None, texts: tuple[str, str], tmp_path: Path
) -> None:
    recording = labelled(tmp_path, toml(("attacked", *texts), time_base=time_base))
    assert attacked_intervals(recording) == (ATTACKED,)
    assert recording["/truth/attack"].texts("time_base") == [time_base or "utc"]


@given(st.integers(0, 3_000_000_000), st.integers(1, 500_000_000), st.integers(-14, 14))
def test_local_time_and_gps_time_agree_with_utc_to_the_microsecond(
    tmp_path_factory: pytest.TempPathFactory, start_us: int, length_us: int, offset_h: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    edges = [START + timedelta(microseconds=us) for us in (start_us, start_us + length_us)]
    shifts = {
        "utc": timedelta(0),
        "gps": timedelta(seconds=GPS_MINUS_UTC_S),
        f"{offset_h:+03d}:00": timedelta(hours=offset_h),
    }
    found = set()
    for time_base, shift in shifts.items():
        start, end = ((edge + shift).replace(tzinfo=None).isoformat() for edge in edges)
        text = toml(("attacked", start, end), time_base=time_base)
        found.update(attacked_intervals(labelled(folder, text)))
    expected_ns = [START_NS + us * 1000 for us in (start_us, start_us + length_us)]
    assert found == {Interval(*expected_ns)}


def test_csv_says_what_toml_says(tmp_path: Path) -> None:
    intervals = (("clean", "0", "600"), ("attacked", "600", "900"))
    by_toml = labelled(tmp_path, toml(*intervals))
    by_csv = labelled(
        tmp_path,
        "\ufeffstate,start,end,class,labelled_by,source,time_check,time_base\n"
        "attacked,600,900,replay,J. Doe,a report,the position jumps at both edges,recording\n"
        "clean,0,600,,J. Doe,a report,the position jumps at both edges,recording\n",
        "labels.CSV",
    )
    assert by_csv.digest() == by_toml.digest()
    assert attacked_intervals(by_toml) == (ATTACKED,)
    assert clean_intervals(by_toml) == (CLEAN,)


def test_labels_go_through_a_file_and_info_says_them(tmp_path: Path) -> None:
    write(flight(), tmp_path / "flight.mcap")
    (tmp_path / "l.toml").write_text(toml(("attacked", "600", "900"), ("clean", "0", "600")))
    label_file(tmp_path / "flight.mcap", tmp_path / "l.toml", tmp_path / "out.mcap")
    recording = read(tmp_path / "out.mcap")
    assert is_really_attacked(recording)
    assert (attacked_intervals(recording), clean_intervals(recording)) == ((ATTACKED,), (CLEAN,))
    text = " ".join(info.as_text(info.summarise(tmp_path / "out.mcap")).split())
    assert (
        "really attacked for 5 min 00 s (replay), clean for 10 min 00 s, not reviewed for 44 min "
        "59 s; by J. Doe, from a report; time base recording, checked: the position jumps at both "
        "edges"
    ) in text


def test_the_api_labels_too(tmp_path: Path) -> None:
    (tmp_path / "l.toml").write_text(toml(("attacked", "600", "900")))
    assert attacked_intervals(api.label(flight(), tmp_path / "l.toml")) == (ATTACKED,)


def test_no_detector_sees_labels(tmp_path: Path) -> None:
    recording = labelled(tmp_path, toml(("attacked", "600", "900"), ("clean", "0", "600")))
    assert recording.blind().digest() == flight().blind().digest()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            toml(("attacked", "2024-05-01T09:10:00", "2024-05-01T09:15:00"), time_base=None),
            r"start = 2024-05-01T09:10:00 does not say what clock it is of; add time_base",
        ),
        (
            toml(("attacked", "2024-05-01T09:10:00Z", "2024-05-01T09:15:00Z"), time_base="gps"),
            "has an offset from UTC, which GPS time has not",
        ),
        (toml(("attacked", "600", "900"), time_base="utc"), "must be a date and a time"),
        (toml(("attacked", "2024-05-01", "900"), time_base="utc"), "must be a date and a time"),
        (toml(("attacked", '"0001-01-01T00:00:00"', "1"), time_base="gps"), "a date and a time"),
        (toml(("attacked", "nan", "900")), "must be seconds after the recording's first row"),
        (toml(("attacked", "true", "900")), "must be seconds after the recording's first row"),
        (toml(("attacked", "900", "600")), r"\[\[attacked\]\] number 1: it must end after it"),
        (toml(("attacked", "600", "600")), "it must end after it starts"),
        (toml(("attacked", "3000", "3601")), "is not within the recording"),
        (toml(("attacked", "-1", "10")), "is not within the recording"),
        (
            toml(("attacked", "600", "900"), ("clean", "0", "601")),
            r"\[\[attacked\]\] number 1 overlaps .*\[\[clean\]\] number 1",
        ),
        (toml(("attacked", "1", "9"), ("attacked", "8", "12")), "number 2 overlaps .*number 1"),
        (toml(("clean", "0", "600")), "no attacked interval"),
        (toml(("attacked", "1", "2"), time_base="local"), "time_base = 'local' must be 'utc'"),
        (toml(("attacked", "1", "2"), time_base="+25:00"), "the offset of local times"),
        (toml(("attacked", "1", "2\nnote = 'x'")), "unknown key 'note'"),
        (toml(("clean", "1", "2\nclass = 'x'")), "unknown key 'class'"),
        ("note = 1\n" + toml(("attacked", "1", "2")), "unknown key 'note'"),
        (toml(("attacked", "1", "2")).replace("a report", " "), "must be a text that says"),
        (toml(("attacked", "1", "2")).replace("source", "# "), "lacks the key 'source'"),
        ("[[attacked]", "is not TOML"),
    ],
)
def test_what_does_not_fit_is_refused(text: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=sentence) as refusal:
        labelled(tmp_path, text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ("attacked,600,900,,J,r,c,recording", "line 2: an interval that is attacked needs a class"),
        ("clean,600,900,replay,J,r,c,recording", "an interval that is clean has no class"),
        ("spoofed,600,900,replay,J,r,c,recording", "state = 'spoofed' must be"),
        ("attacked,600,900", "not as many cells"),
        ("attacked,600,900,replay,J,r,c,recording,more", "not as many cells"),
        ('attacked,"600', "is not CSV"),
    ],
)
def test_what_does_not_fit_in_csv_is_refused(rows: str, sentence: str, tmp_path: Path) -> None:
    head = "state,start,end,class,labelled_by,source,time_check,time_base\n"
    with pytest.raises(ConfigError, match=sentence):
        labelled(tmp_path, head + rows, "labels.csv")


def test_a_labelled_recording_is_labelled_again_only_when_asked(tmp_path: Path) -> None:
    first = labelled(tmp_path, toml(("attacked", "600", "900"), ("clean", "0", "600")))
    (tmp_path / "again.toml").write_text(toml(("attacked", "700", "900")))
    again = read_labels(tmp_path / "again.toml")
    with pytest.raises(RecordingError, match="labelled already; exchange its labels by --replace"):
        label_recording(first, again)
    second = label_recording(first, again, replace=True)
    assert second.digest() == label_recording(flight(), again).digest()
    assert clean_intervals(second) == ()


def test_an_attack_of_ours_is_never_called_real(tmp_path: Path) -> None:
    (tmp_path / "l.toml").write_text(toml(("attacked", "60", "90")))
    for replace in (False, True):
        with pytest.raises(RecordingError, match="an attack that was made"):
            label_recording(spoofed_drive(), read_labels(tmp_path / "l.toml"), replace=replace)
