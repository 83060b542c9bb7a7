"""The page as a file: whole, alone, the same every time, and closed to what the data bring."""

import base64
import json
import shutil
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from spoofbench.decisions import OutcomeLog, Outcomes
from spoofbench.detector import Decisions
from spoofbench.errors import ResultsError
from spoofbench.report import markdown, wording, write_site
from spoofbench.report.columns import FURTHER, MARKS, VERDICT, columns_of
from spoofbench.report.runs import ABSENT_DM, STEPS
from spoofbench.results import TaskOutcome, read_table, read_tasks, read_truth, write_tasks
from spoofbench.scoring.leaderboard import leaderboard
from spoofbench.scoring.score import SCORE_SCHEMA, score_folder


class Page(HTMLParser):
    """Start tags with their attributes, and the text of each ``script`` and ``style``."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.tags, self.raw, self.categories = [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag in ("script", "style"):
            self.raw.append((tag, dict(attributes), []))

    def handle_data(self, data):
        within_raw = self.tags and self.tags[-1][0] in ("script", "style")
        (self.raw[-1][2] if within_raw else self.categories).append(data)

    def data(self):
        return json.loads(
            "".join(
                next(text for tag, attributes, text in self.raw if attributes.get("id") == "data")
            )
        )


def page_of(folder, site):
    return Page(write_site(folder, leaderboard(folder), site).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(folder, tmp_path_factory):
    return page_of(folder, tmp_path_factory.mktemp("site"))


def test_equal_folders_give_equal_bytes(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "elsewhere")
    sites = [
        write_site(source, leaderboard(source), tmp_path / name).parent
        for source, name in ((folder, "a"), (copy, "b"))
    ]
    names = sorted(path.name for path in sites[0].iterdir())
    assert (
        names
        == ["index.html", "leaderboard.json", "leaderboard.md"]
        == sorted(path.name for path in sites[1].iterdir())
    )
    assert all((sites[0] / name).read_bytes() == (sites[1] / name).read_bytes() for name in names)
    assert (sites[0] / "leaderboard.md").read_text() == markdown(leaderboard(folder))


def test_nothing_points_outside(page):
    addresses = [
        value
        for _, attributes in page.tags
        for name, value in attributes.items()
        if name in ("src", "href", "srcset", "data", "action")
    ]
    assert addresses
    assert all(address.startswith(("#", "data:")) for address in addresses)
    assert not any(
        word in "".join(text)
        for tag, _, text in page.raw
        if tag == "style"
        for word in ("url(", "@import")
    )
    assert not {"iframe", "object", "embed", "base"} & {tag for tag, _ in page.tags}


def test_the_policy_forbids_requests(page):
    policy = next(
        a["content"]
        for tag, a in page.tags
        if tag == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy.split("; ") == [
        "default-src 'none'",
        "script-src 'unsafe-inline'",
        "style-src 'unsafe-inline'",
        "img-src data:",
    ]


def test_hostile_texts_are_texts(hostile_folder, page, tmp_path):
    hostile = page_of(hostile_folder, tmp_path)
    assert [tag for tag, _ in hostile.tags if tag in ("script", "style", "img")] == [
        "style",
        "script",
        "script",
    ]
    assert not any("onerror" in attributes for _, attributes in hostile.tags)
    task = next(task for task in read_tasks(hostile_folder) if task.reason)
    assert task.detector in "".join(hostile.categories)
    run = next(run for run in hostile.data()["runs"] if run["reason"])
    assert (run["detector"], run["reason"]) == (task.detector, task.reason)


def test_every_task_is_a_run_and_those_without_decisions_say_why(folder, page):
    runs = page.data()["runs"]
    tasks = read_tasks(folder)
    assert [(run["detector"], run["status"], run["reason"]) for run in runs] == [
        (task.detector, task.status, task.reason) for task in tasks
    ]
    assert all(
        (run["trace"] is None) == (run["status"] != "ok")
        and (run["reason"] is None) == (run["status"] == "ok")
        for run in runs
    )


def test_clean_tracks_are_shared_and_attacks_are_where_the_truth_says(folder, page):
    data = page.data()
    assert len({variant["clean"] for variant in data["variants"]}) == 1
    attacked = next(task for task in read_tasks(folder) if task.attack)
    truth = read_truth(folder, attacked.variant_id)
    variant = next(
        v
        for v in data["variants"]
        if (v["attack"], v["window"]) == (attacked.attack, str(attacked.window))
    )
    start_ns = int(truth.time_ns[0])
    assert variant["intervals"] == [
        [(i.start_ns - start_ns) / 1e9, (i.end_ns - start_ns) / 1e9] for i in truth.intervals
    ]
    assert [part["first"] for part in variant["attacked"]] == [int(truth.spoofed.argmax())]


def test_sort_keys_of_unknown_figures_are_empty(folder, page):
    keys = [
        attributes["data-sort"]
        for tag, attributes in page.tags
        if tag in ("td", "th") and "data-sort" in attributes
    ]
    (table,) = leaderboard(folder).tables
    columns = [*columns_of(table, VERDICT), *columns_of(table, FURTHER)]
    assert len(keys) == 3 * (len(columns) - 1)  # marks stand beneath the names
    assert "" in keys
    assert "None" not in keys


def test_each_table_is_headed_and_has_its_notes_its_marks_and_its_cells(
    calibrated_folder, tmp_path
):
    board = leaderboard(calibrated_folder)
    text = "".join(page_of(calibrated_folder, tmp_path).categories)
    for table in board.tables:
        assert text.count(wording.heading(table)) == 2
        assert wording.evidence(board, table) in text
        assert all(note in text for note in wording.notes(table))
        for row in table.rows:
            assert MARKS.entry(table, row).text in text
        for cell in table.cells:
            assert wording.cell_text(table, cell) in text
    assert {table.provenance for table in board.tables} == {"real attack", "injected"}


def test_a_run_is_drawn_over_the_threshold_that_is_ranked(calibrated_folder, tmp_path):
    data = page_of(calibrated_folder, tmp_path).data()
    scores = read_table(calibrated_folder / "scores.parquet", SCORE_SCHEMA).to_pylist()
    factors = {row["task_id"]: row["factor"] for row in scores if row["point"] == "calibrated"}
    outcomes = Outcomes(calibrated_folder)
    assert {factor > 1 for factor in factors.values()} == {True}
    for task, run in zip(read_tasks(calibrated_folder), data["runs"], strict=True):
        factor = factors.get(task.task_id, 1.0)
        made = outcomes.decisions(task.recording, task.task_id)
        steps = np.frombuffer(base64.b64decode(data["arrays"][run["trace"]["score"]]), "<i2")
        assert np.array_equal(steps > STEPS, made.available & (made.score > factor))
        low = made.available & (made.score < 0.99 * factor)
        assert np.allclose(steps[low] / STEPS, made.score[low] / factor, atol=1 / STEPS)
        shown = dict(run["facts"])["Threshold"]
        assert shown.startswith("as published" if task.recording == "flight" else f"{factor:.4g} ")


def test_a_really_attacked_recording_has_the_track_that_it_reported(calibrated_folder, tmp_path):
    data = page_of(calibrated_folder, tmp_path).data()
    (flight,) = (v for v in data["variants"] if v["recording"] == "flight")
    task = next(t for t in read_tasks(calibrated_folder) if t.recording == "flight")
    truth = read_truth(calibrated_folder, task.variant_id)
    base, attacked = (
        np.frombuffer(base64.b64decode(data["arrays"][index]), "<i4").reshape(2, -1)
        for index in (flight["clean"], flight["attacked"][0]["track"])
    )
    assert np.array_equal(base[0] == ABSENT_DM, truth.spoofed)
    assert attacked.shape[1] == truth.spoofed.sum()
    assert np.abs(attacked).max() < 1_000_000  # 100 km: the plane touches the track


def test_a_page_of_240_runs_of_2602_epochs_is_below_10_megabytes(make, tmp_path):
    attacks = [f"attack-{number}" for number in range(7)]
    folder = make(
        tmp_path / "results", [f"detector-{number}" for number in range(11)], attacks, 2602
    )
    assert len(read_tasks(folder)) == 242
    path = write_site(folder, leaderboard(folder), tmp_path / "site")
    assert path.stat().st_size < 10_000_000
    runs = Page(path.read_text(encoding="utf-8")).data()["runs"]
    assert {run["trace"]["rows"] for run in runs} == {2602}


def test_many_decisions_are_thinned_and_no_alert_vanishes(make, tmp_path):
    folder = make(tmp_path / "results", ["fast"], [])
    task = read_tasks(folder)[0]
    truth = read_truth(folder, task.variant_id)
    time_ns = np.arange(truth.time_ns[0], truth.time_ns[-1], 500_000)
    score = np.where(np.arange(time_ns.size) == 777_777, 1.5, 0.1)
    outcomes = OutcomeLog(folder)
    outcomes.add(task.task_id, TaskOutcome("ok", None, Decisions(time_ns, score, score > 0)))
    outcomes.sort({task.recording: [task.task_id]})
    score_folder(folder)
    path = write_site(folder, leaderboard(folder), tmp_path / "site")
    assert path.stat().st_size < 10_000_000
    data = Page(path.read_text(encoding="utf-8")).data()
    trace = data["runs"][0]["trace"]
    time_ms, steps = (
        np.frombuffer(base64.b64decode(data["arrays"][trace[name]]), kind)
        for name, kind in (("time", "<i4"), ("score", "<i2"))
    )
    assert trace["rows"] == time_ns.size > time_ms.size == steps.size
    assert time_ms[steps > STEPS].tolist() == [777_777 // 2 + 1]


def test_a_variant_that_could_not_be_made_is_shown_without_track(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "results")
    tasks = read_tasks(copy)
    lost = {task.variant_id for task in tasks if task.attack == "replay"}
    for variant in lost:
        (copy / "truth" / f"{variant}.parquet").unlink()
    tasks = [
        replace(task, status="skipped", reason="no donor") if task.variant_id in lost else task
        for task in tasks
    ]
    write_tasks(copy, tasks)
    score_folder(copy)
    data = page_of(copy, tmp_path / "site").data()
    shown = [run for run in data["runs"] if run["status"] == "skipped"]
    assert len(shown) == 9
    assert all(
        run["trace"] is None and data["arrays"][data["variants"][run["variant"]]["epochs"]] == ""
        for run in shown
    )


def test_a_truth_is_read_once_for_the_page(folder, tmp_path, monkeypatch):
    read = Counter()

    def counting(folder, variant_id):
        read[variant_id] += 1
        return read_truth(folder, variant_id)

    monkeypatch.setattr("spoofbench.report.runs.read_truth", counting)
    write_site(folder, leaderboard(folder), tmp_path)
    assert read == Counter({task.variant_id for task in read_tasks(folder)})


def test_a_damaged_folder_leaves_no_page(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "results")
    board = leaderboard(copy)
    next((copy / "decisions").iterdir()).write_bytes(b"damaged")
    with pytest.raises(ResultsError, match="is damaged"):
        write_site(copy, board, tmp_path / "site")
    assert list((tmp_path / "site").iterdir()) == []
