"""The demo shows the really spoofed airliner, or says in one sentence why it does not."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from spoofbench import demo
from spoofbench.codec import read, validate, write
from spoofbench.errors import SpoofbenchError
from spoofbench.suite import Suite, find_suite, load_suite
from spoofbench.testing import drive

REASON = "'a.json.gz' cannot be downloaded; fetch it later"


@pytest.fixture
def fetched(tmp_path: Path) -> Path:
    path = tmp_path / "fetched.mcap"
    write(drive(1, 700.0, flaws=False), path)
    return path


@pytest.fixture
def ran(fetched: Path, monkeypatch: pytest.MonkeyPatch) -> list[Suite]:
    """The suites that were run, in a demo that runs no detector."""
    suites: list[Suite] = []

    def run(suite: Suite, results: Path, **_: object) -> None:
        suites.append(suite)
        results.mkdir(exist_ok=True)

    monkeypatch.setattr(demo, "run", run)
    monkeypatch.setattr(demo, "leaderboard", lambda _: None)
    monkeypatch.setattr(demo, "write_site", lambda *parts: parts[-1] / "index.html")
    return suites


def _fetching(fetched: Path, *lacking: str) -> Callable[..., Path]:
    def fetch(name: str, progress: Callable[[float], None]) -> Path:
        if name in lacking:
            raise SpoofbenchError(REASON)
        progress(1.0)
        return fetched

    return fetch


def _demonstrate(out: Path) -> demo.Demonstration:
    return demo.demonstrate(out, 1, lambda _: lambda _: None)


def test_all_that_there_is_is_shown(
    tmp_path: Path, fetched: Path, ran: list[Suite], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "fetch", _fetching(fetched))
    out = tmp_path / "demo"
    made = _demonstrate(out)
    assert made == demo.Demonstration(out / "site" / "index.html", None)
    assert ran == [load_suite(find_suite(Path("drive")))]
    assert read(out / "drive.mcap").digest() == read(fetched).digest()
    variant = read(out / "drive-replay.mcap")
    assert len(variant["/truth/attack"]) == 1
    validate(out / "drive-replay.mcap")


def test_without_the_airliner_the_demo_goes_on_and_says_so(
    tmp_path: Path, fetched: Path, ran: list[Suite], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "fetch", _fetching(fetched, demo.AIRLINER))
    made = _demonstrate(tmp_path / "demo")
    assert made.without == f"the demo goes on without the really spoofed airliner: {REASON}"
    whole, (suite,) = load_suite(find_suite(Path("drive"))), ran
    assert [entry.id for entry in suite.recordings] == ["drive"]
    gone = {entry.id for entry in whole.detectors} - {entry.id for entry in suite.detectors}
    assert gone == {"envelope-airliner"}
    assert suite.attacks == whole.attacks


def test_without_the_drive_there_is_no_demo(
    tmp_path: Path, fetched: Path, ran: list[Suite], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "fetch", _fetching(fetched, demo.DRIVE))
    with pytest.raises(SpoofbenchError, match="cannot be downloaded"):
        _demonstrate(tmp_path / "demo")
    assert ran == []


def test_what_is_there_is_not_made_again(
    tmp_path: Path, fetched: Path, ran: list[Suite], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo, "fetch", _fetching(fetched))
    out = tmp_path / "demo"
    _demonstrate(out)
    before = (out / "drive.mcap").stat().st_mtime_ns
    shutil.rmtree(out / "results")
    _demonstrate(out)
    assert (out / "drive.mcap").stat().st_mtime_ns == before
    assert len(ran) == 2
