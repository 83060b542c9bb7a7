"""Where a bag is: a lone file, a folder or an archive with its metadata or, where a recorder was
killed, without.
"""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol

import apsw

from spoofbench.conversion import Source
from spoofbench.errors import ConversionError, SpoofbenchError
from spoofbench_converters.rosbag import mcap_log, sqlite_log

MAX_METADATA_BYTES = 4_194_304
MAX_FILES = 10_000
METADATA = "metadata.yaml"
_ABOUT = "rosbag2_bagfile_information"
_HEAD_BYTES = 4096
_MESSAGE_PACKINGS = ("", "zstd")


class Named(Protocol):
    """A file of a folder or an archive, or the source itself."""

    @property
    def path(self) -> Path: ...

    def open(self) -> IO[bytes]: ...


@dataclass(frozen=True, slots=True)
class Location:
    """Where a bag is.

    Attributes:
        files: in their order; None for one that is missing.
        counts: how many messages its metadata declare for each, 0 where they do not say.
        declared: how many messages they declare in all, 0 where they do not say.
    """

    files: tuple[Named | None, ...]
    counts: tuple[int, ...]
    declared: int = 0


def confidence(source: Source) -> float:
    """Return 1 for a bag of any kind by its content, less for an MCAP file of nobody in particular,
    0 for anything else.
    """
    if source.head:
        if source.is_archive:
            return float(_holds_bag(source)) * 0.9
        return _head_confidence(source)
    return float(_holds_bag(source)) if source.path.is_dir() else 0.0


def locate(source: Source) -> Location:
    """Return the files of a bag folder, of an archive with one, or the lone file.

    Raises:
        ConversionError: no bag, or a kind that cannot be read.
    """
    if not source.path.is_dir() and not source.is_archive:
        return Location((source,), (0,))
    members = source.members()
    name = min(
        (name for name in members if PurePosixPath(name).name == METADATA),
        key=lambda name: name.count("/"),
        default=None,
    )
    if name is None:
        found = _bags_among(members)
        if not found:
            raise ConversionError(f"{source.path.name!r} holds no bag")
        return Location(tuple(found), (0,) * len(found))
    return _described(source.path.name, members, name)


def _described(bag: str, members: Mapping[str, Any], name: str) -> Location:
    """Return the files that a bag's metadata name."""
    about = _metadata(bag, members[name])
    mode, packing, names = (
        about.get("compression_mode"),
        about.get("compression_format"),
        about.get("relative_file_paths"),
    )
    if (
        not isinstance(names, list)
        or not 0 < len(names) <= MAX_FILES
        or not all(isinstance(word, str) for word in names)
    ):
        raise ConversionError(f"the bag {bag!r} does not name its files")
    by_message = isinstance(mode, str) and mode.lower() == "message"
    if by_message and packing not in _MESSAGE_PACKINGS:
        raise ConversionError(
            f"the messages of the bag {bag!r} are packed by {str(packing)[:16]!r}; only zstd can "
            "be unpacked"
        )
    folder = PurePosixPath(name).parent
    files = []
    for word in names:
        plain = str(folder / PurePosixPath(word).name)
        # The names of packed files are noted with or without their ending, by version.
        files.append(
            next(
                (
                    members[found]
                    for found in (plain, f"{plain}.zstd", plain.removesuffix(".zstd"))
                    if found in members
                ),
                None,
            )
        )
    if not any(files):
        raise ConversionError(f"the bag {bag!r} lacks its file {PurePosixPath(names[0]).name!r}")
    declared = about.get("message_count")
    return Location(
        tuple(files), _counts(about, len(names)), declared if isinstance(declared, int) else 0
    )


def _counts(about: Mapping[str, Any], files: int) -> tuple[int, ...]:
    entries = about.get("files")
    if not isinstance(entries, list) or len(entries) != files:
        return (0,) * files
    counts = [entry.get("message_count") if isinstance(entry, dict) else 0 for entry in entries]
    return tuple(count if isinstance(count, int) else 0 for count in counts)


def _metadata(bag: str, member: Any) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    with member.open() as file:
        text = file.read(MAX_METADATA_BYTES + 1)
    if len(text) > MAX_METADATA_BYTES:
        raise ConversionError(
            f"{METADATA!r} of the bag {bag!r} is larger than {MAX_METADATA_BYTES:,} bytes"
        )
    try:
        about = YAML(typ="safe").load(text.decode("utf-8"))[_ABOUT]
    except (
        UnicodeDecodeError,
        YAMLError,
        KeyError,
        TypeError,
        ValueError,
        RecursionError,
    ) as error:
        raise ConversionError(
            f"{METADATA!r} of the bag {bag!r} cannot be read: {type(error).__name__}"
        ) from error
    if not isinstance(about, dict):
        raise ConversionError(f"{METADATA!r} of the bag {bag!r} does not describe a bag")
    return about


def _head_confidence(source: Source) -> float:
    if source.head.startswith(b"#ROSBAG"):
        return 1.0
    if source.head.startswith(mcap_log.MAGIC):
        profile = source.head[len(mcap_log.MAGIC) + 13 :][:4]
        return (
            1.0
            if profile in (b"ros1", b"ros2")
            else 0.5 * (b"ros2msg" in source.head or b"ros1msg" in source.head)
        )
    if not source.head.startswith(sqlite_log.MAGIC):
        return 0.0
    if is_plain(source, sqlite_log.MAGIC):
        return float(_is_bag_database(source.path))
    return float(b"CREATE TABLE messages" in source.head and b"CREATE TABLE topics" in source.head)


def _is_bag_database(path: Path) -> bool:
    try:
        with closing(sqlite_log.connect(path)) as database:
            return sqlite_log.tables(database) >= {"topics", "messages"}
    except (apsw.Error, OSError, UnicodeDecodeError):
        return False


def _holds_bag(source: Source) -> bool:
    """Whether a folder or an archive holds the metadata of a bag, or files of a bag and nothing
    else of size.
    """
    try:
        members = source.members()
        for name, member in members.items():
            if PurePosixPath(name).name == METADATA and _ABOUT.encode() in _head(member):
                return True
        return len(members) <= MAX_FILES and bool(_bags_among(members))
    except SpoofbenchError:
        return False


def _bags_among(members: Mapping[str, Any]) -> list[Any]:
    """Return the files of a bag whose metadata are missing: all of one kind, ``<name>_<number>``;
    none if there is anything else.
    """
    suffixes = {suffix for name in members for suffix in PurePosixPath(name).suffixes[:1]}
    if (
        suffixes not in ({".db3"}, {".mcap"}, {".bag"})
        or len({PurePosixPath(name).parent for name in members}) != 1
    ):
        return []
    numbered = {}
    for name, member in members.items():
        stem = PurePosixPath(name).name.partition(".")[0]
        base, _, number = stem.rpartition("_")
        numbered[(base, int(number)) if number.isascii() and number.isdigit() else (stem, 0)] = (
            member
        )
    if len({base for base, _ in numbered}) != 1 or not _head(
        next(iter(members.values()))
    ).startswith((b"SQLite", b"\x89MCAP", b"#ROSBAG")):
        return []
    return [numbered[key] for key in sorted(numbered)]


def _head(member: Any) -> bytes:
    try:
        with member.open() as file:
            return bytes(file.read(_HEAD_BYTES))
    except (OSError, SpoofbenchError):
        return b""


def is_plain(file: Named, magic: bytes) -> bool:
    """Whether the file on the disk is what :meth:`open` gives, not packed."""
    if getattr(file, "info", None) is not None:
        return False
    with file.path.open("rb") as raw:
        return raw.read(len(magic)) == magic
