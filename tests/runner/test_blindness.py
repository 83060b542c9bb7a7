"""A detector's process holds nothing that tells what it is looking at."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from spoofbench.decisions import Outcomes
from spoofbench.recording import Recording
from spoofbench.results import read_tasks
from spoofbench.runner import run
from spoofbench.runner.blind import BlindReader, BlindWriter
from spoofbench.suite import AttackEntry, DetectorEntry, RecordingEntry, Suite, TaskLimits
from spoofbench.testing.recordings import drive, spoofed_drive

MakeSuite = Callable[..., Suite]
WORDS = (
    "telling-attack",
    "telling-recording",
    "telling-session",
    "telling-suite",
    "telling-results",
    "telling-file",
    "987654321987",
)
needs_proc = pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs /proc")


def spy_on(
    make_suite: MakeSuite, logs: Path, folder: Path, words: tuple[str, ...]
) -> set[tuple[str, str | None]]:
    copy = folder / "telling-file.mcap"
    copy.write_bytes((logs / "drive-1.mcap").read_bytes())
    suite = make_suite(
        [DetectorEntry("spy", "spy", {"words_backwards": tuple(word[::-1] for word in words)})],
        [AttackEntry("telling-attack", "nudge")],
        name="telling-suite",
        seed=987654321987,
        limits=TaskLimits(time_s=120.0, memory_mb=1024),
    )
    entry = RecordingEntry("telling-recording", copy, "telling-session")
    run(replace(suite, recordings=(entry,)), folder / "telling-results")
    return {(task.status, task.reason) for task in read_tasks(folder / "telling-results")}


@needs_proc
def test_no_name_seed_or_place_is_in_its_memory_arguments_or_environment(
    make_suite: MakeSuite, logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPOOFBENCH_HINT", "telling-attack")
    assert spy_on(make_suite, logs, tmp_path, WORDS) == {("ok", None)}


@needs_proc
def test_the_spy_finds_what_is_there(make_suite: MakeSuite, logs: Path, tmp_path: Path) -> None:
    # where it is seen first depends on what the garbage collector has untracked by then
    found = spy_on(make_suite, logs, tmp_path, ("no such word anywhere", "/gnss0/gnss/pvt"))
    assert {status for status, _ in found} == {"failed"}
    for _, reason in found:
        assert (reason or "").startswith("AssertionError: found word 1")


def test_a_missing_kind_does_not_tell_an_attack(make_suite: MakeSuite, tmp_path: Path) -> None:
    run(make_suite(["opportunist"]), tmp_path)
    alerts = {
        task.attack: Outcomes(tmp_path).decisions("drive-1", task.task_id).alert.all()
        for task in read_tasks(tmp_path)
    }
    assert alerts == {None: True, "nudge": True}


def test_material_is_the_blind_part_alone(tmp_path: Path) -> None:
    base, variant = drive(1), spoofed_drive(1)
    writer = BlindWriter(tmp_path / "material", base)
    writer.put("00001", variant)
    kept = BlindReader(tmp_path / "material").get("00001")
    blind = variant.blind()
    assert dict(kept) == dict(blind)
    assert kept.metadata == blind.metadata
    assert not any(word in topic for topic in kept for word in ("truth", "reference"))
    text = b"".join(path.read_bytes() for path in (tmp_path / "material").iterdir())
    assert b"drive-1.log" not in text
    assert b"truth" not in text


def test_tables_of_the_base_are_stored_and_loaded_once(tmp_path: Path) -> None:
    base = drive(1)
    topic = base.topics("gnss/pvt")[0]
    moved = base.replace({topic: base[topic].replace(lat_deg=base[topic]["lat_deg"] + 1.0)})
    writer = BlindWriter(tmp_path, base)
    for name, recording in (("0", base), ("1", moved)):
        writer.put(name, recording)
    assert len(list(tmp_path.iterdir())) == len(base.blind()) + 1 + 2
    reader = BlindReader(tmp_path)
    first, second = reader.get("0"), reader.get("1")
    assert first["/imu0/imu"] is second["/imu0/imu"]
    assert first[topic] != second[topic]
    assert second[topic] == moved[topic]


def test_what_a_detector_gets_cannot_be_written(tmp_path: Path) -> None:
    writer = BlindWriter(tmp_path, drive(1))
    writer.put("0", drive(1))
    kept: Recording = BlindReader(tmp_path).get("0")
    for table in kept.values():
        for values in (table.time_ns, *(table[name] for name in table)):
            with pytest.raises(ValueError, match=r"read-only|WRITEABLE"):
                values.flags.writeable = True
