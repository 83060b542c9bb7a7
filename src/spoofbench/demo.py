"""The main job on real data: a rosbag of a 43-minute drive goes in, a leaderboard comes out, and
beside it stands what a really spoofed airliner shows.
"""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from spoofbench.attacks.contract import attack_file
from spoofbench.errors import SpoofbenchError
from spoofbench.fetch import fetch
from spoofbench.report import write_site
from spoofbench.runner import run
from spoofbench.scoring.leaderboard import leaderboard
from spoofbench.suite import Suite, load_suite, packaged_suite

DRIVE, AIRLINER = "drive", "airliner-spoofed"

Progress = Callable[[str], Callable[[float], None]]


@dataclass(frozen=True, slots=True)
class Demonstration:
    """What a demonstration has made.

    Attributes:
        page: path of the report.
        without: why the airliner is not in it, in one sentence; None where it is.
    """

    page: Path
    without: str | None


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


def demonstrate(out: Path, workers: int | None, progress: Progress) -> Demonstration:
    """Convert the drive, write one variant to look at, run the suite and write the page.

    What a killed demonstration has done is not done again.

    Args:
        out: folder for everything that is made.
        workers: tasks at a time; one per processor where None.
        progress: opens a progress bar by name.

    Raises:
        SpoofbenchError: the drive is not installed and cannot be downloaded, or the suite cannot
            be run.
    """
    out.mkdir(parents=True, exist_ok=True)
    recording, file = out / "drive.mcap", out / "drive.toml"
    file.write_text(packaged_suite("drive").read_text("utf-8"))
    suite = load_suite(file)
    step = progress("convert the drive")
    converted = fetch(DRIVE, progress=step)
    if not recording.exists():
        shutil.copyfile(converted, recording)
    step(1.0)
    without = None
    step = progress("fetch the spoofed airliner")
    try:
        fetch(AIRLINER, progress=step)
    except SpoofbenchError as error:
        without = f"the demo goes on without the really spoofed airliner: {error}"
        suite = without_recording(suite, AIRLINER)
    step(1.0)
    step = progress("write a replay variant")
    attack_file(recording, out / "drive-replay.mcap", "replay", {})
    step(1.0)
    results = out / "results"
    run(
        suite,
        results,
        workers=workers,
        resume=results.exists(),
        progress=progress("run the detectors"),
    )
    step = progress("write the report")
    page = write_site(results, leaderboard(results), out / "site")
    step(1.0)
    return Demonstration(page, without)


def without_recording(suite: Suite, name: str) -> Suite:
    """Return a suite without one of its recordings, by id, and without the detectors that are made
    for no class of those that remain.
    """
    recordings = tuple(entry for entry in suite.recordings if entry.id != name)
    classes = {entry.sensor_class for entry in recordings}
    detectors = (entry for entry in suite.detectors if classes & {*(entry.classes or classes)})
    return replace(suite, recordings=recordings, detectors=tuple(detectors))
