"""ROS 2 bags in SQLite: where the database is, and how it is opened."""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import apsw

from spoofbench.errors import ConversionError

SQLITE_MAGIC = b"SQLite format 3\0"
MAX_MESSAGE_BYTES = 16_384
MAX_METADATA_BYTES = 4_194_304
BUSY_MS = 2000

_WAL = 2  # bytes 18 and 19 of the header: the file format's write and read version


@dataclass(frozen=True, slots=True)
class Location:
    """Where a bag's database is, and how many messages its metadata declare (None: not said)."""

    database: Path
    declared: int | None


def locate(path: Path) -> Location:
    """Return the database of a bag folder, or of a bare ``.db3``.

    Raises:
        ConversionError: a kind of bag that cannot be read yet, or no bag at all.
    """
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(16)
        if head != SQLITE_MAGIC:
            raise ConversionError(f"{path.name!r} is {_what(head)}, which cannot be converted yet; give a ROS 2 bag in SQLite")
        return Location(path, None)
    about = _metadata(path / "metadata.yaml")
    storage, files = about.get("storage_identifier"), about.get("relative_file_paths")
    # What is printed or turned to text must be text: a few nested aliases stand for gigabytes.
    if not all(isinstance(word, str | None) for word in (storage, about.get("compression_mode"))):
        raise ConversionError(f"the bag {path.name!r} does not say in words how it is stored")
    if about.get("compression_mode") not in (None, "", "none", "NONE"):
        raise ConversionError(f"the bag {path.name!r} is compressed ({about['compression_mode']!r}); decompress it with `ros2 bag convert`")
    if storage != "sqlite3":
        raise ConversionError(f"the bag {path.name!r} is stored as {storage!r}, which cannot be converted yet; store it as 'sqlite3'")
    if not isinstance(files, list) or len(files) != 1:
        count = len(files) if isinstance(files, list) else 0
        raise ConversionError(f"the bag {path.name!r} is split into {count} files; merge it with `ros2 bag convert`")
    if not isinstance(files[0], str):
        raise ConversionError(f"the bag {path.name!r} does not name its database")
    database = path / Path(files[0]).name
    if not database.is_file():
        raise ConversionError(f"the bag {path.name!r} lacks its database {database.name!r}")
    declared = about.get("message_count")
    return Location(database, declared if isinstance(declared, int) else None)


def is_bag(path: Path) -> bool:
    """Whether a database has the tables of a bag, or a folder the metadata of one."""
    if path.is_dir():
        try:
            with (path / "metadata.yaml").open("rb") as file:
                return b"rosbag2_bagfile_information" in file.read(4096)
        except OSError:
            return False
    try:
        with closing(connect(path)) as database:
            return tables(database) >= {"topics", "messages"}
    except (apsw.Error, UnicodeDecodeError):
        return False


def connect(path: Path) -> apsw.Connection:
    """Open a database read-only, leaving no trace beside it.

    Raises:
        apsw.Error: it cannot be opened.
    """
    with path.open("rb") as file:
        head = file.read(20)
    write_ahead = Path(f"{path}-wal")
    settled = head[18:19] == bytes([_WAL]) and not (write_ahead.exists() and write_ahead.stat().st_size)
    # A settled write-ahead database is opened as immutable: else SQLite creates files beside it.
    uri = f"file:{quote(str(path.resolve()))}?mode=ro{'&immutable=1' if settled else ''}"
    database = apsw.Connection(uri, flags=apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI)
    database.set_busy_timeout(BUSY_MS)
    database.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_MESSAGE_BYTES)
    # Tables alone are read, no code in the schema runs, and a file shorter than its header says opens nevertheless.
    for pragma in ("trusted_schema=OFF", "cell_size_check=ON", "writable_schema=ON"):
        database.execute(f"PRAGMA {pragma}")
    return database


def tables(database: apsw.Connection) -> set[str]:
    """Return the names of the tables, views left out."""
    return {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}


def _metadata(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        if path.stat().st_size > MAX_METADATA_BYTES:
            raise ConversionError(f"{path.name!r} of the bag {path.parent.name!r} is larger than {MAX_METADATA_BYTES:,} bytes")
        content = YAML(typ="safe").load(path.read_text("utf-8"))
        about = content["rosbag2_bagfile_information"]
    except (OSError, UnicodeDecodeError, YAMLError, KeyError, TypeError, RecursionError) as error:
        raise ConversionError(f"{path.name!r} of the bag {path.parent.name!r} cannot be read: {type(error).__name__}") from error
    if not isinstance(about, dict):
        raise ConversionError(f"{path.name!r} of the bag {path.parent.name!r} does not describe a bag")
    return about


def _what(head: bytes) -> str:
    known = {b"#ROSBAG": "a ROS 1 bag", b"\x89MCAP0": "an MCAP file", b"\x28\xb5\x2f\xfd": "a compressed file"}
    return next((name for magic, name in known.items() if head.startswith(magic)), "no SQLite database")
