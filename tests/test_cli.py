"""The command line: quick to help, one sentence for what a user can cause, never a traceback."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from spoofbench import cli
from spoofbench.codec import write
from spoofbench.errors import PluginError
from spoofbench.testing.recordings import drive

HEAVY = ("numpy", "pandas", "pyarrow", "scipy", "rosbags", "rich", "google.protobuf")


def _spoofbench(*words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from spoofbench.cli import main; main()", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    code = "\n".join(
        (
            "import sys",
            "from spoofbench.cli import app",
            "app(['--help'], standalone_mode=False)",
            f"print([name for name in {HEAVY!r} if name in sys.modules])",
        )
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_help_fits_80_columns_and_names_every_command(tmp_path: Path) -> None:
    text = _spoofbench("--help", cwd=tmp_path).stdout
    assert max(map(len, text.splitlines())) <= 80
    for command in (
        "demo",
        "convert",
        "info",
        "doctor",
        "export",
        "attack",
        "label",
        "run",
        "score",
        "report",
        "compare",
        "plugins",
        "check",
    ):
        assert f"\n  {command} " in text
    assert "..." not in text.partition("Commands:")[2]


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["info", "missing.mcap"], 1),
        (["doctor", "missing.mcap"], 1),
        (["doctor", "text.mcap"], 1),
        (["doctor", "text.mcap", "--format", "nmae"], 1),
        (["export", "missing.mcap", "-o", "out.csv"], 1),
        (["export", "text.mcap", "-o", "out.csv"], 1),
        (["export", "text.mcap", "-o", "text.mcap"], 2),
        (["export", "text.mcap", "-o", "out", "--format", "xls"], 2),
        (["export", "text.mcap", "-o", "out", "--mapping", "x", "--topic", "/imu0/imu"], 2),
        (["export", "text.mcap"], 2),
        (["info", "text.mcap"], 1),
        (["info", "empty.mcap"], 1),
        (["convert", "missing", "-o", "out.mcap"], 1),
        (["convert", "text.mcap", "-o", "out.mcap"], 1),
        (["convert", "text.mcap", "-o", "out.mcap", "--format", "nmae"], 1),
        (["attack", "text.mcap", "-a", "replay", "-o", "out.mcap"], 1),
        (["attack", "text.mcap", "-a", "nonsense", "-o", "out.mcap"], 1),
        (["attack", "text.mcap", "-a", "replay", "-p", "delay", "-o", "out.mcap"], 2),
        (["attack", "text.mcap", "-a", "replay", "-p", "nonsense=1", "-o", "out.mcap"], 1),
        (
            [
                "attack",
                "text.mcap",
                "-a",
                "replay",
                "-p",
                "delay_s=1",
                "-p",
                "delay_s=2",
                "-o",
                "out.mcap",
            ],
            2,
        ),
        (["attack", "text.mcap", "-a", "replay", "-o", "text.mcap"], 2),
        (["attack", "empty.mcap", "-a", "meacon", "--donor", "text.mcap", "-o", "./text.mcap"], 2),
        (["attack", "text.mcap", "-a", "replay", "--start", "nan", "-o", "out.mcap"], 2),
        (["attack", "text.mcap", "-a", "replay", "--duration", "1e300", "-o", "out.mcap"], 2),
        (["attack", "text.mcap", "-a", "replay", "--seed", str(2**63), "-o", "out.mcap"], 2),
        (["run", "missing.toml", "-o", "results"], 1),
        (["run", "text.mcap", "-o", "results"], 1),
        (["score", "missing"], 1),
        (["report", "missing", "-o", "site"], 1),
        (["compare", "missing", "missing"], 1),
        (["check", "nonsense"], 1),
        (["nonsense"], 2),
        (["info"], 2),
    ],
)
def test_what_a_user_can_cause_is_one_sentence(words: list[str], code: int, tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("this is not a recording\n" * 10)
    (tmp_path / "empty.mcap").write_bytes(b"")
    done = _spoofbench(*words, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    if code == 1:
        assert done.stderr.startswith("spoofbench: ")
        assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (PluginError("two\nlines, \x1b[2J"), "two lines, \N{REPLACEMENT CHARACTER}[2J"),
        (OSError(28, "No space left on device", "x.mcap"), "x.mcap: No space left on device"),
        (OSError("no more"), "the output: no more"),
        (MemoryError(), "this takes more memory than there is"),
    ],
)
def test_any_mishap_is_one_line_that_a_terminal_can_show(
    error: Exception,
    sentence: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def mishap() -> None:
        raise error

    monkeypatch.setattr(cli, "app", mishap)
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 1
    assert capsys.readouterr().err == f"spoofbench: {sentence}\n"


def test_plugins_are_listed_for_machines(tmp_path: Path) -> None:
    rows = json.loads(_spoofbench("plugins", "--json", cwd=tmp_path).stdout)
    assert {
        "kind": "attack",
        "name": "replay",
        "distribution": "spoofbench",
        "version": "0.1.0",
    } in rows


def test_a_log_that_cannot_be_converted_does_not_stop_the_others(tmp_path: Path) -> None:
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text("this is not a log\n")
    done = _spoofbench("convert", "a.txt", "b.txt", "-o", "out", cwd=tmp_path)
    assert done.returncode == 1
    assert [line.split(":")[1].strip() for line in done.stderr.splitlines()] == ["a.txt", "b.txt"]


def test_the_doctor_answers_scripts_by_its_exit_code(tmp_path: Path) -> None:
    good = drive(1, 60.0, flaws=False)
    pvt = good["/gnss0/gnss/pvt"]
    write(good, tmp_path / "good.mcap")
    write(good.with_metadata({"source/gnss0": {"solution": "fused"}}), tmp_path / "fused.mcap")
    nowhere = pvt.replace(lat_deg=pvt["lat_deg"] * 0, lon_deg=pvt["lon_deg"] * 0)
    write(good.replace({"/gnss0/gnss/pvt": nowhere}), tmp_path / "nowhere.mcap")
    for names, code in (
        (["good"], 0),
        (["fused", "good"], 3),
        (["nowhere", "fused"], 4),
        (["good", "missing"], 1),
    ):
        done = _spoofbench("doctor", "--json", *(f"{name}.mcap" for name in names), cwd=tmp_path)
        assert done.returncode == code, done.stderr
        assert list(json.loads(done.stdout)) == [
            f"{name}.mcap" for name in names if name != "missing"
        ]
    text = _spoofbench("doctor", "nowhere.mcap", cwd=tmp_path).stdout
    assert "error    impossible-position  /gnss0/gnss/pvt\n" in text
    assert max(map(len, text.splitlines())) <= 80


def test_one_topic_is_exported(tmp_path: Path) -> None:
    write(drive(1, 60.0), tmp_path / "x.mcap")
    done = _spoofbench("export", "x.mcap", "-o", "imu.csv", "--topic", "/imu0/imu", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "imu.csv: /imu0/imu\n")
    assert (tmp_path / "imu.csv").read_text().startswith('"time_ns","time","accel_x_mps2"')


@pytest.mark.parametrize(
    ("parameter", "sentence"),
    [
        ("rate_mps=abc", "parameter rate_mps = 'abc' must be a number"),
        ("rate_mps=nan", "parameter rate_mps = 'nan' must be a finite number"),
        ("rate_mps=[1]", "parameter rate_mps = '[1]' must be a number"),
        ("direction_deg=north", "parameter direction_deg = 'north' must be empty or a number"),
        ("rate=1", "has no parameter 'rate'; did you mean 'rate_mps'?"),
        ("vertical_share=2", "vertical_share must"),
    ],
)
def test_a_parameter_is_refused_by_name_and_value(
    parameter: str, sentence: str, tmp_path: Path
) -> None:
    (tmp_path / "x.mcap").write_bytes(b"")
    words = ["attack", "x.mcap", "-a", "drag-off", "-p", parameter, "-o", "out.mcap"]
    done = _spoofbench(*words, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith("spoofbench: attack 'drag-off' of spoofbench ")
    assert sentence in done.stderr
