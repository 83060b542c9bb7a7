"""Commands of other distributions: named without import, imported when used, blamed alone."""

import subprocess
import sys
from pathlib import Path

import pytest

SOUND = '''
from typing import Annotated
import typer
def greet(name: Annotated[str, typer.Argument()], loud: bool = False) -> None:
    """Greet somebody."""
    typer.echo(name.upper() if loud else name)
number = 5
'''


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder of distributions: commands that are sound, that cannot be imported, that are no
    functions, and one that takes the name of a command of spoofbench itself.
    """
    (tmp_path / "fake_sound.py").write_text(SOUND)
    (tmp_path / "fake_broken.py").write_text("raise RuntimeError('the disk is on fire')\n")
    _distribution(tmp_path, "sound", "greet = fake_sound:greet\nnumber = fake_sound:number\n")
    _distribution(tmp_path, "broken", "broken = fake_broken:greet\ninfo = fake_broken:greet\n")
    return tmp_path


def _distribution(site: Path, name: str, commands: str) -> None:
    folder = site / f"spoofbench_{name}-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: spoofbench-{name}\nVersion: 1\n"
    )
    (folder / "entry_points.txt").write_text(f"[spoofbench.commands]\n{commands}")


def _spoofbench(site: Path, *words: str) -> subprocess.CompletedProcess[str]:
    code = f"import sys; sys.path.insert(0, {str(site)!r}); from spoofbench.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )


def test_help_names_commands_without_importing_them(site: Path) -> None:
    done = _spoofbench(site, "--help")
    assert done.returncode == 0
    assert "\n  greet " in done.stdout
    assert "\n  broken " in done.stdout
    assert "Of spoofbench-broken; ask it with --help." in done.stdout


def test_a_command_takes_its_words(site: Path) -> None:
    assert _spoofbench(site, "greet", "ada", "--loud").stdout == "ADA\n"
    assert "Greet somebody." in _spoofbench(site, "greet", "--help").stdout
    assert "Did you mean 'greet'" in _spoofbench(site, "gret").stderr


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        (
            "broken",
            (
                "command 'broken' of spoofbench-broken 1 cannot be loaded from "
                "'fake_broken:greet': RuntimeError: the disk is on fire"
            ),
        ),
        ("number", "command 'number' of spoofbench-sound 1 is not a function"),
    ],
)
def test_a_broken_command_is_blamed_by_name(site: Path, name: str, reason: str) -> None:
    done = _spoofbench(site, name)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"spoofbench: {reason}")
    assert done.stderr.count("\n") == 1


def test_a_command_of_spoofbench_keeps_its_name(site: Path) -> None:
    done = _spoofbench(site, "--help")
    assert "Say what a recording holds." in done.stdout
    assert done.stderr == (
        "spoofbench: command 'info' of spoofbench-broken 1 is ignored: spoofbench has a command "
        "'info' itself\n"
    )
    assert "Say what a recording holds." in _spoofbench(site, "info", "--help").stdout


def test_two_claims_to_one_name_leave_the_commands_of_spoofbench_alone(site: Path) -> None:
    _distribution(site, "rival", "greet = fake_broken:greet\n")
    done = _spoofbench(site, "--help")
    assert done.returncode == 0
    assert "Say what a recording holds." in done.stdout
    assert "'greet' of spoofbench-rival 1" in done.stderr
    assert "'greet' of spoofbench-sound 1" in done.stderr
