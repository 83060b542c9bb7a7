"""Files are taken as the recipe says or not at all, and a recording is made once."""

import sys
from pathlib import Path

import pytest

from spoofbench.codec import read
from spoofbench.errors import SpoofbenchError
from spoofbench.fetch import cache, cached_path, fetch, names_of, recipe
from spoofbench.fetch.sources import digest_of_file
from spoofbench.recording import attacked_intervals
from spoofbench.testing import drive
from tests.fetch.conftest import LOG, Offers, Shelf, said


def _raw(folder: Path) -> list[str]:
    """What the cache keeps of downloads, whole or not."""
    return sorted(p.name for p in (folder / "cache").rglob("*") if p.is_file())


def test_a_recording_is_downloaded_once_and_converted_once(
    shelf: Shelf, server: Offers, tmp_path: Path
) -> None:
    server.files["log.csv"] = LOG
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    assert not cached_path("commute").exists()
    path = fetch("commute")
    assert path == cached_path("commute")
    assert path.name == "commute.mcap"
    assert len(read(path)["/gnss0/gnss/pvt"]) == 60
    del server.files["log.csv"]
    assert fetch("commute") == path
    assert server.asked == ["log.csv"]


def test_progress_reaches_the_end(shelf: Shelf, server: Offers) -> None:
    server.files["log.csv"] = LOG
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    shares: list[float] = []
    fetch("commute", progress=shares.append)
    assert shares[-1] == 1.0
    assert all(0 <= share <= 1 for share in shares)


def test_what_was_downloaded_serves_without_network(shelf: Shelf, server: Offers) -> None:
    server.files["log.csv"] = LOG
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    first = fetch("commute")
    octets = first.read_bytes()
    first.unlink()
    del server.files["log.csv"]
    assert fetch("commute").read_bytes() == octets
    assert server.asked == ["log.csv"]


def test_a_transfer_that_is_cut_off_leaves_nothing(
    shelf: Shelf, server: Offers, tmp_path: Path
) -> None:
    server.files["log.csv"] = LOG
    server.cut_off.add("log.csv")
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    with pytest.raises(SpoofbenchError, match="of the recording 'commute' cannot be"):
        fetch("commute")
    assert _raw(tmp_path) == []
    server.cut_off.clear()
    assert fetch("commute").is_file()


def test_another_file_is_refused_with_what_was_expected(
    shelf: Shelf, server: Offers, tmp_path: Path
) -> None:
    server.files["log.csv"] = LOG.replace(b"47.0", b"48.0", 1)
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    with pytest.raises(SpoofbenchError, match="is damaged or has changed") as caught:
        fetch("commute")
    assert recipe("commute").files[0].sha256 in str(caught.value)
    assert f"{len(LOG):,} bytes" in str(caught.value)
    assert _raw(tmp_path) == []


def test_what_is_not_there_is_said(shelf: Shelf, server: Offers) -> None:
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    with pytest.raises(SpoofbenchError, match=r"404 .*log\.csv; .*--from"):
        fetch("commute")


def test_a_server_that_does_not_answer_is_said(shelf: Shelf) -> None:
    shelf.offer(f"{{ url = 'http://127.0.0.1:9/log.csv', {said(LOG)} }}")
    with pytest.raises(SpoofbenchError, match=r"cannot be downloaded from http://127"):
        fetch("commute")


def test_damage_in_the_cache_is_downloaded_again(
    shelf: Shelf, server: Offers, tmp_path: Path
) -> None:
    server.files["log.csv"] = LOG
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    fetch("commute").unlink()
    kept = next((tmp_path / "cache" / "raw").iterdir())
    kept.write_bytes(LOG[:-1] + b"x")
    assert fetch("commute").is_file()
    assert kept.read_bytes() == LOG


def test_a_mirror_serves_under_any_name_and_the_network_is_left_alone(
    shelf: Shelf, server: Offers, tmp_path: Path
) -> None:
    server.files["log.csv"] = LOG
    shelf.offer(f"{{ url = '{server.url('log.csv')}', {said(LOG)} }}")
    deep = tmp_path / "mirror" / "a" / "b"
    deep.mkdir(parents=True)
    (deep / "other.name").write_bytes(LOG)
    assert fetch("commute", [tmp_path / "mirror"]).is_file()
    assert server.asked == []


def test_the_mirror_may_be_an_environment_variable(
    shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shelf.offer(f"{{ url = 'https://example.org/log.csv', {said(LOG)} }}")
    (tmp_path / "empty").mkdir()
    (tmp_path / "mirror").mkdir()
    monkeypatch.setenv("SPOOFBENCH_MIRROR", f"{tmp_path / 'empty'}:{tmp_path / 'mirror'}")
    with pytest.raises(SpoofbenchError, match=r"not in the mirror .*empty.* or .*mirror"):
        fetch("commute")
    (tmp_path / "mirror" / "log.csv").write_bytes(LOG[:-1])
    with pytest.raises(SpoofbenchError, match="is damaged or has changed"):
        fetch("commute")
    (tmp_path / "mirror" / "log.csv").write_bytes(LOG)
    assert fetch("commute").is_file()


@pytest.mark.parametrize("kind", ["wheel", "bare", "network", "installed", "other wheel"])
def test_a_member_of_a_wheel_is_found_wherever_it_is(
    shelf: Shelf,
    server: Offers,
    wheel: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
) -> None:
    content = wheel.read_bytes()
    shelf.offer(f"{{ wheel = 'example', member = 'example/data/log.csv', {said(LOG)} }}")
    recipes_text = (shelf.folder / "recordings.toml").read_text()
    shelf.write(
        f"wheels.example = {{ url = '{server.url(wheel.name)}', {said(content)} }}\n{recipes_text}"
    )
    mirror = tmp_path / "mirror"
    mirror.mkdir()
    folders = [mirror]
    if kind == "wheel":
        (mirror / wheel.name).write_bytes(content)
    elif kind == "bare":
        (mirror / "anything").write_bytes(LOG)
    elif kind == "other wheel":  # built again: other bytes, the same member
        (mirror / "rebuilt.whl").write_bytes(content + b"\0")
    elif kind == "network":
        server.files[wheel.name] = content
        folders = []
    else:
        site = tmp_path / "site"
        (site / "example-1.0.dist-info").mkdir(parents=True)
        (site / "example-1.0.dist-info" / "METADATA").write_text("Name: example\nVersion: 1.0\n")
        (site / "example" / "data").mkdir(parents=True)
        (site / "example" / "data" / "log.csv").write_bytes(LOG)
        monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    assert len(read(fetch("commute", folders))["/gnss0/gnss/pvt"]) == 60
    assert server.asked == ([wheel.name] if kind == "network" else [])


def test_a_member_that_changed_is_refused(shelf: Shelf, wheel: Path) -> None:
    other = LOG.replace(b"47.0", b"48.0", 1)
    shelf.offer(f"{{ wheel = 'example', member = 'example/data/log.csv', {said(other)} }}")
    text = (shelf.folder / "recordings.toml").read_text()
    content = said(wheel.read_bytes())
    shelf.write(f"wheels.example = {{ url = 'https://x.invalid/{wheel.name}', {content} }}\n{text}")
    with pytest.raises(SpoofbenchError, match="is damaged or has changed"):
        fetch("commute", [wheel.parent])


def test_a_stale_recording_is_made_again(
    shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mirror = tmp_path / "mirror"
    mirror.mkdir()
    (mirror / "log.csv").write_bytes(LOG)
    file = f"{{ url = 'https://example.org/log.csv', {said(LOG)} }}"
    shelf.offer(file)
    first = fetch("commute", [mirror])
    shelf.offer(file, options="{ mapping = 'strapdown_phone', session = 'x' }")
    assert not cached_path("commute").exists()
    second = fetch("commute", [mirror])
    assert read(second).metadata["recording"]["session_id"] == "x"
    assert digest_of_file(first) != digest_of_file(second)
    monkeypatch.setattr(cache, "_code", lambda _: {"spoofbench": "changed"})
    assert not cached_path("commute").exists()


def test_labels_are_written_beside_the_rows_and_decide_the_recording(
    shelf: Shelf, tmp_path: Path
) -> None:
    mirror = tmp_path / "mirror"
    mirror.mkdir()
    (mirror / "log.csv").write_bytes(LOG)
    shelf.offer(f"{{ url = 'https://example.org/log.csv', {said(LOG)} }}")
    plain = fetch("commute", [mirror])
    labels = (
        "labelled_by = 'N. N.'\nsource = 'x'\ntime_base = 'utc'\ntime_check = 'x'\n[[attacked]]\n"
        "class = 'generated'\nstart = 2024-05-01T10:00:20\nend = 2024-05-01T10:00:{}\n"
    )
    text = (shelf.folder / "recordings.toml").read_text()
    shelf.write(f"{text}labels = 'commute.toml'\n")
    (shelf.folder / "labels").mkdir()
    seen = {plain}
    for end in (30, 40):
        (shelf.folder / "labels" / "commute.toml").write_text(labels.format(end))
        seen.add(path := fetch("commute", [mirror]))
        (interval,) = attacked_intervals(read(path))
        assert (interval.end_ns - interval.start_ns) / 1e9 == end - 20
    assert len(seen) == 3


def test_what_cannot_be_converted_leaves_no_recording(shelf: Shelf, tmp_path: Path) -> None:
    mirror = tmp_path / "mirror"
    mirror.mkdir()
    (mirror / "log.csv").write_bytes(b"no log")
    shelf.offer(f"{{ url = 'https://example.org/log.csv', {said(b'no log')} }}")
    with pytest.raises(SpoofbenchError):
        fetch("commute", [mirror])
    assert _raw(tmp_path) == []


def test_a_name_is_a_recording_or_a_suite(shelf: Shelf) -> None:
    shelf.offer(f"{{ url = 'https://example.org/log.csv', {said(LOG)} }}")
    (shelf.folder / "suites" / "cars.toml").write_text(
        "[[recordings]]\nid = 'a'\nfetch = 'commute'\n[[recordings]]\nid = 'b'\npath = 'b.mcap'\n"
    )
    assert names_of(["cars"]) == names_of(["commute"]) == names_of(["cars", "commute"])
    with pytest.raises(SpoofbenchError, match=r"'comute'.*commute"):
        names_of(["comute"])


def test_a_simulated_recording_is_the_same_wherever_it_is_made(
    shelf: Shelf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shelf.simulate(seed=3)
    first = fetch("simulated")
    recording = read(first)
    expected = drive(3, 120.0, lag_s=0.2)
    assert recording.digest() == expected.digest()
    monkeypatch.setenv("SPOOFBENCH_CACHE", str(tmp_path / "another"))
    again = fetch("simulated")
    assert again != first
    assert again.read_bytes() == first.read_bytes()


def test_another_simulation_is_another_recording(shelf: Shelf) -> None:
    shelf.simulate(seed=3)
    first = fetch("simulated")
    shelf.simulate(seed=4)
    assert cached_path("simulated") != first
    assert read(fetch("simulated")).digest() != read(first).digest()
