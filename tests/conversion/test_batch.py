"""Many logs at once, by the command line: each is accounted for, and one that does harm does it to
itself alone.
"""

import gzip
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from spoofbench.codec import read

FAKES = Path(__file__).parent / "fakes"


def start(*words: str | Path, cwd: Path) -> subprocess.Popen[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(FAKES), *sys.path])}
    command = [
        sys.executable,
        "-c",
        "from spoofbench.cli import main; main()",
        "convert",
        *map(str, words),
    ]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=cwd, env=environment
    )


def convert(*words: str | Path, cwd: Path) -> tuple[int, str, str]:
    process = start(*words, cwd=cwd)
    out, err = process.communicate(timeout=120)
    assert process.returncode is not None
    assert "Traceback" not in err
    return process.returncode, out, err


def rows(out: str) -> dict[str, Any]:
    return {row["source"]: row for row in json.loads(out)}


def test_a_walked_folder(tmp_path: Path) -> None:
    (tmp_path / "logs" / "sub").mkdir(parents=True)
    (tmp_path / "logs" / "a.log").write_text("steps....!")
    (tmp_path / "logs" / "sub" / "a.log.gz").write_bytes(gzip.compress(b"steps" + b"." * 1000)[:-9])
    (tmp_path / "logs" / "notes.txt").write_text("nothing")
    code, out, err = convert("logs", "-o", "out", "--json", cwd=tmp_path)
    found = rows(out)
    assert (code, err) == (0, "")
    assert {source: row["status"] for source, row in found.items()} == {
        "logs/a.log": "converted",
        "logs/notes.txt": "not recognised",
        "logs/sub/a.log.gz": "converted",
    }
    assert found["logs/a.log"]["ledger"]["reasons"] == {"junk": 1, "the head": 5}
    packed = found["logs/sub/a.log.gz"]["ledger"]
    assert packed["reasons"] == {
        "the head": 5,
        "the packing is damaged: what follows could not be unpacked": 0,
    }
    assert packed["used"] > 900
    assert len(read(tmp_path / "out" / "sub" / "a.mcap")["/imu0/imu"]) == packed["used"]
    code, out, err = convert("logs", "-o", "out", cwd=tmp_path)
    assert [line.split()[0] for line in out.splitlines()] == [
        "rows",
        "4",
        "-",
        f"{packed['used']:,}",
    ]


def test_a_format_that_is_named_is_the_only_one_asked_in_a_folder(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.log").write_text("steps....")
    (tmp_path / "logs" / "notes.txt").write_text("nothing")
    code, out, _ = convert("logs", "-o", "out", "--format", "steps", "--json", cwd=tmp_path)
    assert code == 0
    assert [row["status"] for row in rows(out).values()] == ["converted", "not recognised"]
    code, _, err = convert("logs", "-o", "out", "--format", "stairs", cwd=tmp_path)
    assert (code, err.partition(";")[0]) == (1, "spoofbench: no converter is called 'stairs'")


def test_one_that_does_harm_costs_itself_alone(tmp_path: Path) -> None:
    for name, text in {
        "a": "steps..",
        "dies": "steps..D",
        "lies": "steps..L",
        "b": "steps...",
    }.items():
        (tmp_path / name).write_text(text)
    code, out, err = convert("a", "dies", "lies", "b", "-o", "out", "--json", cwd=tmp_path)
    found = rows(out)
    assert code == 1
    assert [row["status"] for row in found.values()] == [
        "converted",
        "failed",
        "failed",
        "converted",
    ]
    assert "was ended by SIGKILL" in found["dies"]["reason"]
    assert "accounts for 7 bytes of 'lies', which has 8" in found["lies"]["reason"]
    assert [line.partition(":")[2].split(":")[0].strip() for line in err.splitlines()] == [
        "dies",
        "lies",
    ]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.mcap", "b.mcap"]


def test_wishes_go_where_they_are_known(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_text("steps..")
    code, out, _ = convert(
        "a", "b", "--date", "2026-01-02", "--mapping", "x", "-o", "out", cwd=tmp_path
    )
    assert code == 0
    assert "option 'mapping' does not exist for 2 of them: a, b" in out
    assert "2026-01-02" in read(tmp_path / "out" / "a.mcap").metadata["origin"]["options"]
    code, _, err = convert("a", "--mapping", "x", "-o", "out", cwd=tmp_path)
    assert (code, err) == (
        1,
        "spoofbench: the steps converter has no option 'mapping'; there are ['date']\n",
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("logs", [["a"], ["a", "b"]])
def test_what_is_interrupted_leaves_nothing(
    number: signal.Signals, logs: list[str], tmp_path: Path
) -> None:
    for name in logs:
        (tmp_path / name).write_text("steps....W")
    (tmp_path / "out").mkdir()
    process = start(*logs, "-o", "out", "--workers", "2", cwd=tmp_path)
    while len(list((tmp_path / "out").iterdir())) < len(logs):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in err
    assert list((tmp_path / "out").iterdir()) == []


MAPPING = """
clock = "sensor"
[table.log]
time = { column = "t", unit = "s" }
[table.log."/imu0/imu"]
accel_x_mps2 = "ax"
"""


def test_a_mapping_takes_what_no_converter_recognises(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    for name, text in {
        "a.csv": "t,ax\n1,2\n",
        "b.csv": "t,ax\n1,2\n3,4\n",
        "notes.txt": "nothing\n",
        "c.log": "steps...",
        "d.bin": "\x07\x00,\x1b\n\x01,2\n",
    }.items():
        (tmp_path / "logs" / name).write_text(text)
    (tmp_path / "mine.toml").write_text(MAPPING)
    code, out, err = convert(
        "logs/a.csv", "--mapping", "mine.toml", "-o", "a.mcap", "--json", cwd=tmp_path
    )
    assert (code, err, [row["ledger"]["rows"] for row in rows(out).values()]) == (
        0,
        "",
        [{"/imu0/imu": 1}],
    )
    code, out, err = convert("logs", "--mapping", "mine.toml", "-o", "out", "--json", cwd=tmp_path)
    status = {source: row["status"] for source, row in rows(out).items()}
    assert code == 0
    assert [source for source, what in status.items() if what == "converted"] == [
        "logs/a.csv",
        "logs/b.csv",
        "logs/c.log",
    ]
    assert set(status.values()) == {"converted", "not recognised"}
    assert "needs a column 't'" in err
    assert "'d.bin' is no text" in err
    code, _, err = convert("logs/notes.txt", "--mapping", "mine.toml", "-o", "a.mcap", cwd=tmp_path)
    assert (code, "needs a column 't'" in err) == (1, True)


def test_a_mapping_that_is_not_sound_says_so(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(MAPPING.replace("accel_x_mps2", "acel_x_mps2"))
    code, _, err = convert("mine.toml", "-o", "a.mcap", cwd=tmp_path)
    assert (code, "acel_x_mps2" in err) == (1, True)


def test_a_mapping_beside_its_files_is_their_session(tmp_path: Path) -> None:
    """The whole of them, packed or not, is accounted for and digested."""
    (tmp_path / "mine.toml").write_text(
        MAPPING.replace("[table.log]", '[table.log]\nfiles = "*.csv*"')
    )
    (tmp_path / "a.csv").write_text("t,ax\n1,2\n")
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(b"t,ax\n3,4\n5,6\n" * 200)[:-9])
    (tmp_path / "notes.txt").write_text("nothing")
    for convertible in (tmp_path / "mine.toml", Path("mine.toml")):
        code, out, err = convert(convertible, "-o", "out.mcap", "--json", cwd=tmp_path)
        assert (code, err) == (0, "")
        (row,) = rows(out).values()
        assert (
            "the packing is damaged: what follows could not be unpacked" in row["ledger"]["reasons"]
        )
        assert row["ledger"]["rows"]["/imu0/imu"] >= 3
    digests = {read(tmp_path / "out.mcap").metadata["origin"]["sha256"]}
    for name in ("a.csv", "mine.toml"):
        (tmp_path / name).write_text((tmp_path / name).read_text() + "\n")
        assert convert("mine.toml", "-o", "out.mcap", cwd=tmp_path)[0] == 0
        origin = read(tmp_path / "out.mcap").metadata["origin"]
        assert int(origin["size"]) == sum(
            (tmp_path / each).stat().st_size for each in ("mine.toml", "a.csv", "b.csv.gz")
        )
        digests.add(origin["sha256"])
    assert len(digests) == 3
