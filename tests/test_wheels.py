"""What is shipped: wheels of every distribution, installed in a fresh environment, with every entry
point.
"""

import json
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
DISTRIBUTIONS = [ROOT, *sorted(path.parent for path in ROOT.glob("plugins/*/pyproject.toml"))]
LOAD_ALL = """
import json
from spoofbench import plugins
groups = (plugins.CONVERTERS, plugins.ATTACKS, plugins.DETECTORS, plugins.COMMANDS)
found = {
    group: {name: plugin.distribution for name, plugin in plugins.found(group).items()}
    for group in groups
}
for group in groups:
    for plugin in plugins.found(group).values():
        plugin.load()
import spoofbench
print(json.dumps({"found": found, "file": spoofbench.__file__}))
"""


def _run(*command: str | Path, cwd: Path | None = None) -> str:
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, cwd=cwd, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    out = tmp_path_factory.mktemp("wheels")
    for distribution in DISTRIBUTIONS:
        _run(
            sys.executable,
            "-m",
            "build",
            "--wheel",
            "--no-isolation",
            "--outdir",
            out,
            distribution,
        )
    return sorted(out.glob("*.whl"))


def test_every_distribution_says_what_it_is(wheels: list[Path]) -> None:
    assert len(wheels) == len(DISTRIBUTIONS)
    for wheel in wheels:
        names = zipfile.ZipFile(wheel).namelist()
        assert any(name.endswith("py.typed") for name in names), wheel.name
        assert not [name for name in names if "test_" in name], wheel.name


def test_suites_and_recipes_are_shipped(wheels: list[Path]) -> None:
    core = next(wheel for wheel in wheels if wheel.name.startswith("spoofbench-"))
    folder = ROOT / "benchmarks"
    lying = {
        f"spoofbench/{path.relative_to(ROOT)}"
        for part in ("recordings.toml", "suites/*", "labels/*")
        for path in folder.glob(part)
    }
    packed = {n for n in zipfile.ZipFile(core).namelist() if n.startswith("spoofbench/benchmarks")}
    assert packed == lying


def test_every_entry_point_is_found_and_loads_in_a_fresh_environment(
    wheels: list[Path], tmp_path: Path
) -> None:
    fresh = tmp_path / "fresh"
    _run(sys.executable, "-m", "venv", "--without-pip", fresh)
    python = fresh / "bin" / "python"
    _run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        *wheels,
    )
    site = Path(
        _run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    # A path line makes the dependencies importable without running the .pth files of the editable
    # installs beside them.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    answer = json.loads(_run(python, "-I", "-c", LOAD_ALL, cwd=tmp_path))
    declared: dict[str, dict[str, str]] = {}
    for distribution in DISTRIBUTIONS:
        project = tomllib.loads((distribution / "pyproject.toml").read_text())["project"]
        for group, entries in project["entry-points"].items():
            declared.setdefault(group, {}).update(dict.fromkeys(entries, project["name"]))
    assert answer["found"] == declared
    assert Path(answer["file"]).is_relative_to(fresh)
