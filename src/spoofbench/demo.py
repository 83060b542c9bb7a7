"""The main job on real data: a rosbag of a 43-minute drive goes in, a leaderboard comes out."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

from spoofbench.attacks.contract import attack_file
from spoofbench.conversion import convert
from spoofbench.errors import SpoofbenchError
from spoofbench.report import write_site
from spoofbench.runner import run
from spoofbench.scoring.leaderboard import leaderboard
from spoofbench.suite import load_suite, packaged_suite

Progress = Callable[[str], Callable[[float], None]]


def drive_bag() -> Path:
    """Return the folder of the drive's rosbag.

    Raises:
        SpoofbenchError: the package that carries it is not installed.
    """
    package = find_spec("pntos_cobra_datasets_ros")
    if package is None or not package.submodule_search_locations:
        raise SpoofbenchError(
            "the drive is not installed; install it with: pip install 'spoofbench[demo]'"
        )
    return Path(package.submodule_search_locations[0]) / "cobra_gps_ins_example_data"


def demonstrate(out: Path, workers: int | None, progress: Progress) -> Path:
    """Convert the drive, write one variant to look at, run the suite and write the page; return the
    page's path.

    What a killed demonstration has done is not done again.
    """
    out.mkdir(parents=True, exist_ok=True)
    recording, suite = out / "drive.mcap", out / "drive.toml"
    suite.write_text(packaged_suite("drive").read_text("utf-8"))
    step = progress("convert the drive")
    if not recording.exists():
        convert(drive_bag(), recording, progress=step)
    step(1.0)
    step = progress("write a replay variant")
    attack_file(recording, out / "drive-replay.mcap", "replay", {})
    step(1.0)
    results = out / "results"
    run(
        load_suite(suite),
        results,
        workers=workers,
        resume=results.exists(),
        progress=progress("run the detectors"),
    )
    step = progress("write the report")
    page = write_site(results, leaderboard(results), out / "site")
    step(1.0)
    return page
