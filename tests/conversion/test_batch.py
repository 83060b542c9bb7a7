"""Many logs at once: no two recordings go to one place, each log is accounted for, and one that
does harm does it to itself alone.
"""

import gzip
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spoofbench.codec import read
from spoofbench.conversion import Source
from spoofbench.conversion.batch import plan
from spoofbench.errors import ConversionError

FAKES = Path(__file__).parent / "fakes"

COMMAND = """
import signal
from spoofbench.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
main()
"""


def start(*words: str | Path, cwd: Path) -> subprocess.Popen[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(FAKES), *sys.path])}
    command = [
        sys.executable,
        "-c",
        COMMAND,
        "convert",
        *map(str, words),
    ]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=environment,
        start_new_session=True,
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


def test_optional_options_go_where_they_are_known(tmp_path: Path) -> None:
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


def leave_when_interrupted(
    process: "subprocess.Popen[str]", out: Path, stop: Callable[[], None]
) -> None:
    """Hold an interrupted conversion to leaving nothing half written."""
    stop()
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "Traceback" not in err
    assert [path.name for path in out.iterdir() if path.suffix != ".mcap"] == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("logs", [["a"], ["a", "b"]])
def test_what_is_interrupted_leaves_nothing(
    number: signal.Signals, logs: list[str], tmp_path: Path
) -> None:
    for name in logs:
        (tmp_path / name).write_text("steps....W")
    (tmp_path / "out").mkdir()
    process = start(*logs, "-o", "out", "--workers", "2", cwd=tmp_path)
    until_begun(process, tmp_path / "out", len(logs))
    leave_when_interrupted(process, tmp_path / "out", lambda: process.send_signal(number))
    assert list((tmp_path / "out").iterdir()) == []


def until_begun(process: "subprocess.Popen[str]", out: Path, logs: int) -> None:
    while len(list(out.iterdir())) < logs:
        assert process.poll() is None
        time.sleep(0.005)


@pytest.mark.parametrize("seed", range(4))
def test_signals_at_random_moments_leave_nothing_half_written(seed: int, tmp_path: Path) -> None:
    """To the main process or its group, once or again and again while it tidies up."""
    rng = random.Random(seed)
    logs = [f"log{number}" for number in range(4)]
    for number, name in enumerate(logs):
        (tmp_path / name).write_text("steps" + "." * (50 * number) + ("W" if number % 2 else ""))
    (tmp_path / "out").mkdir()
    process = start(*logs, "-o", "out", "--workers", "4", cwd=tmp_path)
    until_begun(process, tmp_path / "out", 1)
    time.sleep(rng.uniform(0.0, 0.3))

    def stop() -> None:
        send = os.killpg if seed % 2 else os.kill
        while process.poll() is None:
            send(process.pid, signal.SIGTERM)
            time.sleep(rng.uniform(0.0, 0.2))

    leave_when_interrupted(process, tmp_path / "out", stop)
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_workers_of_a_killed_conversion_end_and_leave_nothing(tmp_path: Path) -> None:
    logs = ["a", "b"]
    for name in logs:
        (tmp_path / name).write_text("steps....W")
    (tmp_path / "out").mkdir()
    process = start(*logs, "-o", "out", "--workers", "2", cwd=tmp_path)
    until_begun(process, tmp_path / "out", len(logs))
    process.kill()
    process.communicate(timeout=60)
    deadline = time.monotonic() + 30
    while list((tmp_path / "out").iterdir()) and time.monotonic() < deadline:
        time.sleep(0.05)
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


@pytest.fixture
def converters(install: Any) -> None:
    install(
        "whole",
        [],
        sniff=lambda source: float(not source.path.is_dir() or "whole" in source.members()),
    )


def touch(folder: Path, *names: str) -> list[Path]:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    return [folder / name for name in names]


def targets(inputs: list[Path], out: Path) -> list[str]:
    return [job.target.relative_to(out).as_posix() for job in plan(inputs, out)]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a.ubx", "b.nmea.gz"], ["a.mcap", "b.mcap"]),
        (["a/x.ubx", "b/x.ubx", "y"], ["a-x.mcap", "b-x.mcap", "y.mcap"]),
        (["a/x.ubx", "a/x.nmea"], ["x.ubx.mcap", "x.nmea.mcap"]),
        (["a/x.ubx", "a/X.nmea"], ["x.ubx.mcap", "X.nmea.mcap"]),
        (["a/x.ubx", "b/x.ubx", "a-x"], ["x.ubx.mcap", "b-x.mcap", "a-x.mcap"]),
        (["a/x.ubx", "a/x.ubx"], ["x.mcap"]),
    ],
)
def test_names_are_short_and_distinct(
    names: list[str], expected: list[str], converters: None, tmp_path: Path
) -> None:
    (tmp_path / "out").mkdir()
    assert targets(touch(tmp_path, *names), tmp_path / "out") == expected


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.sampled_from(["x", "X", "x-2", "a-x", "x.ubx", "a-x.ubx", "x.ubx.gz", "..x", "x-2.ubx"]),
        min_size=2,
        unique=True,
    ),
    st.data(),
)
def test_no_two_logs_share_a_name(
    install: Any, tmp_path: Path, names: list[str], data: Any
) -> None:
    install("none", [], sniff=0.0)
    folders = data.draw(
        st.lists(st.sampled_from(["a", "b/a", "b", "."]), min_size=len(names), max_size=len(names))
    )
    paths = touch(
        tmp_path, *(f"{folder}/{name}" for folder, name in zip(folders, names, strict=True))
    )
    made = [job.target for job in plan(paths, tmp_path / "out")]
    assert len({str(target).casefold() for target in made}) == len(paths)
    assert all(target.parent == tmp_path / "out" for target in made)


def test_one_log_goes_to_the_file_that_is_named(converters: None, tmp_path: Path) -> None:
    (log,) = touch(tmp_path, "a.ubx")
    assert [job.target for job in plan([log], tmp_path / "out.mcap")] == [tmp_path / "out.mcap"]


def test_a_folder_is_one_log_or_walked(converters: None, tmp_path: Path) -> None:
    touch(
        tmp_path,
        "logs/a.ubx",
        "logs/sub/a.ubx",
        "logs/sub/b.ubx",
        "logs/bag/whole",
        "logs/bag/part",
        "logs/.hidden",
        "logs/out/old.mcap",
    )
    out = tmp_path / "logs" / "out"
    jobs = plan([tmp_path / "logs"], out)
    assert [job.target.relative_to(out).as_posix() for job in jobs] == [
        "a.mcap",
        "bag.mcap",
        "sub/a.mcap",
        "sub/b.mcap",
    ]
    assert all(job.found_in_folder for job in jobs)
    assert [job.source for job in plan([tmp_path / "logs" / "bag"], tmp_path / "x.mcap")] == [
        tmp_path / "logs" / "bag"
    ]


def test_names_stay_within_the_output_folder(
    converters: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    touch(tmp_path, "logs/whole", "a.ubx")
    monkeypatch.chdir(tmp_path / "logs")
    (tmp_path / "out").mkdir()
    for inputs in ([Path()], [Path("../logs/../logs")], [Path("..") / "a.ubx"]):
        (job,) = plan(inputs, tmp_path / "out")
        assert job.target.resolve().parent == tmp_path / "out"
        assert Source.of(job.source)


def test_what_is_not_there_is_an_error(converters: None, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConversionError, match="does not exist"):
        plan([tmp_path / "missing"], tmp_path / "out")
    with pytest.raises(ConversionError, match="there is no file in"):
        plan([tmp_path / "empty"], tmp_path / "out")
