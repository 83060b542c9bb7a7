"""A really attacked recording is judged as it is: by its labels, without attacks of ours."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spoofbench import codec
from spoofbench.errors import SuiteError
from spoofbench.recording import Interval, Recording
from spoofbench.results import read_tasks, read_truth
from spoofbench.runner import run
from spoofbench.suite import RecordingEntry, Suite
from spoofbench.table import Table
from spoofbench.testing.recordings import START_NS, drive

MakeSuite = Callable[..., Suite]
S = 1_000_000_000
ATTACKED = Interval(START_NS + 30 * S, START_NS + 50 * S)
CLEAN = Interval(START_NS + 10 * S, START_NS + 30 * S)


def labelled(seed: int) -> Recording:
    def row(kind: str, interval: Interval, **more: list[str]) -> Table:
        bounds = {"start_ns": [interval.start_ns], "end_ns": [interval.end_ns]}
        return Table(kind, np.array([interval.start_ns]), {**bounds, **more})

    tables = {
        "/truth/attack": row(
            "truth/attack", ATTACKED, provenance=["real"], **{"class": ["replay"]}
        ),
        "/truth/clean": row("truth/clean", CLEAN),
    }
    return drive(seed, 90.0).replace(tables)


@pytest.fixture(scope="module")
def spoofed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spoofed") / "spoofed.mcap"
    codec.write(labelled(3), path)
    return path


def test_it_is_judged_by_its_labels_and_not_attacked_again(
    make_suite: MakeSuite, spoofed: Path, tmp_path: Path
) -> None:
    run(make_suite(["steady"], recordings={"spoofed": spoofed}), tmp_path / "results")
    (task,) = read_tasks(tmp_path / "results")
    assert (task.attack, task.provenance, task.status) == ("as recorded", "real attack", "ok")
    assert (task.window, task.calibrates) == (None, False)
    truth = read_truth(tmp_path / "results", task.variant_id)
    assert truth.intervals == (ATTACKED,)
    np.testing.assert_array_equal(
        truth.reviewed, ATTACKED.covers(truth.time_ns) | CLEAN.covers(truth.time_ns)
    )


def test_it_lends_no_signals(
    make_suite: MakeSuite, logs: Path, spoofed: Path, tmp_path: Path
) -> None:
    entries = (
        RecordingEntry("drive-1", logs / "drive-1.mcap", "monday", donors=("spoofed",)),
        RecordingEntry("spoofed", spoofed, "tuesday"),
    )
    with pytest.raises(SuiteError, match=r"'spoofed\.mcap' is attacked; a donor must be clean"):
        run(replace(make_suite(["steady"]), recordings=entries), tmp_path / "results")


def test_what_spoofbench_attacked_is_still_refused(make_suite: MakeSuite, tmp_path: Path) -> None:
    path = tmp_path / "variant.mcap"
    recording = labelled(3)
    codec.write(
        recording.replace({"/truth/attack": recording["/truth/attack"].replace(provenance=None)}),
        path,
    )
    with pytest.raises(SuiteError, match=r"'variant\.mcap' is attacked already"):
        run(make_suite(["steady"], recordings={"variant": path}), tmp_path / "results")
