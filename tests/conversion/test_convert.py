"""From any converter's items to a file: recognised, accounted for, described, the same bytes
twice.
"""

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spoofbench.codec import read
from spoofbench.conversion import Block, Ledger, Reject, SizeHint, Source, SourceMetadata, convert
from spoofbench.conversion.contract import DETAILED_REJECTS
from spoofbench.errors import ConversionError, PluginError, RecordingError
from spoofbench.table import Table

START_NS = 1_700_000_000_000_000_000
TOPIC = "/imu0/imu"


def rows(*seconds: float, used: int | None = None, topic: str = TOPIC) -> Block:
    times = START_NS + (np.array(seconds) * 1e9).astype(np.int64)
    kind = topic.split("/", 2)[2]
    field = "accel_x_mps2" if kind == "imu" else "lat_deg"
    return Block(
        topic,
        Table(kind, times, {field: np.array(seconds)}),
        len(seconds) if used is None else used,
    )


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "some.log"
    path.write_bytes(b"abc" * 100)
    return path


def test_blocks_become_a_recording_that_says_where_it_is_from(
    install: Any, log: Path, tmp_path: Path
) -> None:
    install(
        "fake",
        [
            rows(1, 2),
            SourceMetadata({"source/imu0": {"axes": "frd"}, "recording": {"clock": "sensor"}}),
            Reject(2, 5, "junk"),
            rows(3),
        ],
    )
    shares: list[float] = []
    ledger = convert(log, tmp_path / "out.mcap", options={"rate_hz": "2.5"}, progress=shares.append)
    recording = read(tmp_path / "out.mcap")
    assert recording[TOPIC]["accel_x_mps2"].tolist() == [1, 2, 3]
    digest = hashlib.sha256(log.read_bytes()).hexdigest()
    origin = recording.metadata["origin"]
    assert (origin["file"], origin["size"], origin["sha256"]) == ("some.log", "300", digest)
    assert (origin["converter"], origin["converter_version"]) == ("fake", "7")
    assert json.loads(origin["options"])["rate_hz"] == 2.5
    assert dict(recording.metadata["recording"]) == {
        "clock": "sensor",
        "schema_version": "1",
        "session_id": digest[:16],
    }
    assert dict(recording.metadata["primary"]) == {"imu": "imu0"}
    assert dict(recording.metadata["source/imu0"]) == {"axes": "frd"}
    assert (ledger.used, ledger.skipped, dict(ledger.reasons)) == (3, 5, {"junk": 5})
    assert Ledger.of_metadata(recording.metadata["ledger"]) == ledger
    assert shares == [1]
    assert str(tmp_path) not in json.dumps(
        {name: dict(record) for name, record in recording.metadata.items()}
    )


def test_same_log_same_bytes(install: Any, log: Path, tmp_path: Path) -> None:
    install(
        "fake",
        [
            rows(1, 2),
            Reject(0, 1, "b"),
            Reject(1, 1, "a"),
            rows(5, 6, topic="/gnss0/gnss/pvt"),
            rows(3),
        ],
    )
    for name in ("one", "two"):
        convert(log, tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_rows_behind_what_was_written_are_rejected(install: Any, log: Path, tmp_path: Path) -> None:
    install("fake", [rows(1, 2, 3), rows(1.5, 2.5, 3, 4, used=8), rows(2, 2.1)])
    ledger = convert(log, tmp_path / "out.mcap")
    assert read(tmp_path / "out.mcap")[TOPIC]["accel_x_mps2"].tolist() == [1, 2, 3, 3, 4]
    assert dict(ledger.reasons) == {f"time runs backwards in {TOPIC}": 6}
    assert ledger.used + ledger.skipped == 3 + 8 + 2


def test_strict_turns_a_reject_into_an_error_and_leaves_no_file(
    install: Any, log: Path, tmp_path: Path
) -> None:
    install("fake", [rows(1), Reject(7, 2, "junk"), rows(2)])
    with pytest.raises(ConversionError, match=r"junk \(at record 7, 2 records\)"):
        convert(log, tmp_path / "out.mcap", strict=True)
    assert list(tmp_path.iterdir()) == [log]


def test_a_log_without_rows_is_an_error_that_says_why(
    install: Any, log: Path, tmp_path: Path
) -> None:
    install("fake", [Reject(0, 3, "junk"), Reject(3, 9, "rubbish"), Block(TOPIC, rows().table, 0)])
    with pytest.raises(
        ConversionError, match="gave no rows: 12 records were skipped, 9 of them because rubbish"
    ):
        convert(log, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [log]


def test_only_the_first_rejects_are_kept_in_detail(install: Any, log: Path, tmp_path: Path) -> None:
    install("fake", [rows(1), *(Reject(i, 1, "junk") for i in range(DETAILED_REJECTS + 5))])
    ledger = convert(log, tmp_path / "out.mcap")
    assert ledger.reasons["junk"] == DETAILED_REJECTS + 5
    assert len(ledger.rejects) == DETAILED_REJECTS


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"rate": "1"}, "no option 'rate'"),
        ({"rate_hz": "fast"}, "option rate_hz = 'fast' must be a number"),
        ({"mode": "medium"}, "mode = 'medium' must be one of 'fast', 'slow'"),
        ({"count": "1.5"}, "count = '1.5' must be empty or a whole number"),
        ({"keep": "maybe"}, "true or false"),
    ],
)
def test_options_are_read_by_type(
    install: Any, log: Path, tmp_path: Path, options: dict[str, str], sentence: str
) -> None:
    install("fake", [rows(1)])
    with pytest.raises(ConversionError, match=sentence):
        convert(log, tmp_path / "out.mcap", options=options)


def test_options_reach_the_converter(install: Any, log: Path, tmp_path: Path) -> None:
    seen: list[Any] = []

    def items(source: Source, options: Any) -> Iterator[Any]:
        seen.append(options)
        assert source.head == log.read_bytes()
        yield rows(1)

    install("fake", items)
    convert(
        log,
        tmp_path / "out.mcap",
        options={"rate_hz": "10", "mode": "slow", "count": "3", "keep": "yes", "name": "a=b"},
    )
    assert (seen[0].rate_hz, seen[0].mode, seen[0].count, seen[0].keep, seen[0].name) == (
        10.0,
        "slow",
        3,
        True,
        "a=b",
    )


def test_the_surest_converter_is_taken_and_a_tie_is_an_error(
    install: Any, log: Path, tmp_path: Path
) -> None:
    install("weak", [rows(1, 2)], sniff=0.4)
    install("sure", [rows(1)], sniff=0.9)
    install("broken", [], sniff=ZeroDivisionError("oops"))
    assert convert(log, tmp_path / "out.mcap").used == 1
    assert convert(log, tmp_path / "out.mcap", format="weak").used == 2
    install("equal", [rows(1)], sniff=0.9)
    with pytest.raises(ConversionError, match=r"\['equal', 'sure'\]; say which with --format"):
        convert(log, tmp_path / "out.mcap")


def test_nobody_recognises_it(install: Any, log: Path, tmp_path: Path) -> None:
    install("other", [], sniff=0.0)
    install("broken", [], sniff=ZeroDivisionError("oops"))
    with pytest.raises(
        ConversionError,
        match=r"no converter recognises 'some.log'; tried \['other'\]; "
        "converter 'broken' of fake 1 failed: oops",
    ):
        convert(log, tmp_path / "out.mcap")


@pytest.mark.parametrize("items", [[object()], lambda source, options: 1 / 0])
def test_a_converter_that_breaks_is_blamed_by_name(
    install: Any, log: Path, tmp_path: Path, items: Any
) -> None:
    install("fake", items)
    with pytest.raises(PluginError, match="converter 'fake' of fake 1"):
        convert(log, tmp_path / "out.mcap")


def test_a_log_is_never_written_to(install: Any, log: Path, tmp_path: Path) -> None:
    install("fake", [rows(1)])
    for out in (log, tmp_path / "out.mcap"):
        with pytest.raises(ConversionError, match="would change the log"):
            convert(log if out == log else tmp_path, out)
    with pytest.raises(ConversionError, match="cannot be read"):
        convert(tmp_path / "missing", tmp_path / "out.mcap")


def test_a_file_may_have_any_name(install: Any, tmp_path: Path) -> None:
    install("fake", [rows(1)])
    log = tmp_path / os.fsdecode(b"\xff\x1b[2J\n.log")
    log.write_text("x")
    convert(log, tmp_path / "out.mcap")
    assert read(tmp_path / "out.mcap").metadata["origin"]["file"] == "\\udcff\x1b[2J\n.log"
    (tmp_path / "folder").mkdir()
    log.rename(tmp_path / "folder" / log.name)
    convert(tmp_path / "folder", tmp_path / "out.mcap")


def test_a_folder_is_digested_by_its_files(install: Any, tmp_path: Path) -> None:
    install("fake", [rows(1)])
    digests = []
    for name, text in (("a", "x"), ("b", "x"), ("c", "y")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "part").write_text(text)
        convert(tmp_path / name, tmp_path / "out.mcap")
        digests.append(read(tmp_path / "out.mcap").metadata["origin"]["sha256"])
    assert digests[0] == digests[1] != digests[2]


def test_extent_sets_the_scale_of_progress(install: Any, log: Path, tmp_path: Path) -> None:
    install("fake", [SizeHint(4), rows(1), rows(2), Reject(2, 1, "junk"), rows(3)], unit="records")
    shares: list[float] = []
    convert(log, tmp_path / "out.mcap", progress=shares.append)
    assert shares == [0, 0.25, 0.5, 0.75, 1, 1]


@pytest.mark.parametrize("counted", [299, 301])
def test_a_converter_that_counts_bytes_accounts_for_each(
    install: Any, log: Path, tmp_path: Path, counted: int
) -> None:
    install("fake", [rows(1, used=300)], unit="bytes")
    assert convert(log, tmp_path / "out.mcap").used == 300
    install("fake", [rows(1, used=counted)], unit="bytes")
    with pytest.raises(
        PluginError,
        match=rf"converter 'fake' of fake 1 accounts for {counted} bytes of 'some.log', which "
        "has 300",
    ):
        convert(log, tmp_path / "wrong.mcap")
    assert not (tmp_path / "wrong.mcap").exists()


def test_what_is_no_file_is_never_replaced(install: Any, log: Path, tmp_path: Path) -> None:
    install("fake", [rows(1, 2)])
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(RecordingError, match="no file"):
            convert(log, tmp_path / name)
    assert (tmp_path / "pipe").is_fifo()


def test_rows_before_1970_cost_themselves_alone(install: Any, log: Path, tmp_path: Path) -> None:
    early = Block(
        TOPIC, Table("imu", np.array([-5, -1, 0, 7]), {"accel_x_mps2": np.arange(4.0)}), 8
    )
    install("fake", [early, rows(1, 2)])
    ledger = convert(log, tmp_path / "out.mcap")
    assert read(tmp_path / "out.mcap")[TOPIC].time_ns.tolist() == [
        0,
        7,
        START_NS + 10**9,
        START_NS + 2 * 10**9,
    ]
    assert (ledger.used, dict(ledger.reasons)) == (
        6,
        {"times before 1970, which a recording cannot hold, in /imu0/imu": 4},
    )
