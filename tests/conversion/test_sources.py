"""Packed sources give what can be unpacked, say where they end early, and stay bounded."""

import bz2
import gzip
import io
import lzma
import os
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spoofbench.conversion import Source, sources
from spoofbench.errors import ConversionError, LimitError

PACKINGS: dict[str, Callable[[bytes], bytes]] = {
    "gzip": gzip.compress,
    "zstd": zstandard.compress,
    "bzip2": bz2.compress,
    "xz": lzma.compress,
}
DATA = b"".join(b"$GPGGA,%d\r\n" % i for i in range(40_000)) + bytes(range(256)) * 20


def unpacked(path: Path) -> tuple[bytes, Source]:
    source = Source.of(path).reset()
    with source.open() as file:
        return file.read(), source


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("parts", [1, 2])
def test_packed_files_give_their_bytes(packing: str, parts: int, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(PACKINGS[packing](DATA) * parts)
    content, source = unpacked(path)
    assert content == DATA * parts
    assert source.size() == len(DATA) * parts
    assert not source.stats.damage


@pytest.mark.parametrize("packing", PACKINGS)
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, exclude_max=True))
def test_a_packed_file_that_is_cut_off_gives_what_was_before(
    packing: str, share: float, tmp_path: Path
) -> None:
    path = tmp_path / "log"
    packed = PACKINGS[packing](DATA)
    path.write_bytes(packed[: 10 + int(share * (len(packed) - 10))])
    try:
        content, source = unpacked(path)
    except ConversionError as error:
        assert "cannot be unpacked" in str(error)  # noqa: PT017 - either is right
        return
    assert DATA.startswith(content)
    assert source.size() == source.stats.ended[""] == len(content)
    assert source.stats.damage or content == DATA


def test_junk_behind_a_packed_file_is_damage(tmp_path: Path) -> None:
    path = tmp_path / "log.gz"
    path.write_bytes(gzip.compress(DATA) + b"junk")
    content, source = unpacked(path)
    assert content == DATA
    assert source.stats.damage


@pytest.mark.parametrize("packing", PACKINGS)
def test_what_unpacks_to_too_much_is_refused_in_a_sentence(
    packing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "MAX_UNPACKED_BYTES", 3 * 2**20)
    path = tmp_path / "bomb"
    path.write_bytes(PACKINGS[packing](bytes(16 * 2**20)))
    with pytest.raises(LimitError, match="'bomb' unpacks to more than 3,145,728 bytes"):
        unpacked(path)


def test_members_of_folders_and_archives_are_the_same(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    files = {"a.csv": b"a" * 10, "sub/b.csv": DATA}
    with zipfile.ZipFile(tmp_path / "log.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            (folder / name).write_bytes(content)
            archive.writestr(name, content)
    for path in (folder, tmp_path / "log.zip"):
        source = Source.of(path)
        assert source.size() == 10 + len(DATA)
        for name, member in source.members().items():
            with member.open() as file:
                assert file.read() == files[name]
        assert source.stats.ended == {
            name: len(content) for name, content in files.items() if path != folder
        }
        assert source.size() == 10 + len(DATA)


def test_a_damaged_member_ends_where_the_damage_is(tmp_path: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("log", os.urandom(100_000))
    octets = bytearray(packed.getvalue())
    octets[60_000] ^= 255
    path = tmp_path / "log.zip"
    path.write_bytes(octets)
    source = Source.of(path)
    with source.members()["log"].open() as file:
        content = file.read()
    assert source.stats.ended == {"log": len(content)}
    assert "CRC" in source.stats.damage["log"]
    assert source.size() == len(content)


def test_damage_costs_the_same_however_much_is_read_at_a_time(tmp_path: Path) -> None:
    content = b"".join(b"%09d\n" % number for number in range(400_000))
    with zipfile.ZipFile(tmp_path / "log.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("log.txt", content)
    packed = bytearray((tmp_path / "log.zip").read_bytes())
    packed[len(packed) // 2] ^= 1
    (tmp_path / "log.zip").write_bytes(packed)
    whole = []
    for size in (1000, 65_536, 2**22):
        with Source.of(tmp_path / "log.zip").members()["log.txt"].open() as stream:
            whole.append(b"".join(iter(partial(stream.read, size), b"")))
    assert whole[0] == whole[1] == whole[2]
    assert len(whole[0]) > len(content) // 4


@pytest.mark.parametrize("content", [b"PK\x03\x04", b"PK\x03\x04" + bytes(500)])
def test_a_broken_archive_is_one_sentence(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log.zip"
    path.write_bytes(content)
    with pytest.raises(ConversionError, match=r"the archive 'log.zip' cannot be read"):
        Source.of(path).members()


def test_a_pipe_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConversionError, match="neither a file nor a folder"):
        Source.of(tmp_path / "pipe")
