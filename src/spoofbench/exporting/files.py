"""Which topics go into which files; each file appears whole or not at all."""

import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from spoofbench import plugins
from spoofbench.codec import read
from spoofbench.conversion import Exporting
from spoofbench.errors import PluginError, RecordingError, SpoofbenchError
from spoofbench.exporting.gpx import write_gpx
from spoofbench.exporting.tables import arrow_table, write_csv, write_parquet
from spoofbench.recording import Recording
from spoofbench.schema import split_topic

Format = Literal["parquet", "csv"]

_WRITERS: Mapping[str, Callable[[Any, Path], None]] = {"parquet": write_parquet, "csv": write_csv}


def export(
    file: Path, out: Path, *, topics: Sequence[str] = (), table_format: Format = "csv"
) -> list[str]:
    """Write topics of a recording for other programs; return their names.

    Args:
        file: the recording.
        out: ends in ``.parquet`` or ``.csv``: one topic; in ``.gpx``: the tracks of all receivers,
            or of those asked for; in ``.zip``, or anything else, a folder: a file per topic.
        topics: those to write; else all.
        table_format: of the files in a folder or an archive.

    Raises:
        FormatError: the file is no recording; RecordingError: it has no such topic, or several
            where one file is to be written.
    """
    recording = read(file)
    chosen = _chosen(recording, topics)
    if out.suffix == ".gpx":
        chosen = [topic for topic in chosen if split_topic(topic)[1] == "gnss/pvt"]
        if not chosen:
            raise RecordingError(
                f"{file.name!r} has no gnss/pvt topic to draw; it has {sorted(recording)}"
            )
        with _whole(out) as path:
            write_gpx([(split_topic(topic)[0], recording[topic]) for topic in chosen], path)
    elif out.suffix.removeprefix(".") in _WRITERS:
        if len(chosen) != 1:
            raise RecordingError(
                f"{out.name!r} can hold one topic; say which with --topic, or name a folder or a "
                f".zip: {chosen}"
            )
        with _whole(out) as path:
            _WRITERS[out.suffix.removeprefix(".")](
                arrow_table(recording[chosen[0]], chosen[0], recording.metadata), path
            )
    else:
        _write_all(recording, chosen, out, table_format)
    return chosen


def export_by_mapping(file: Path, out: Path, mapping: str) -> None:
    """Write a recording as the table, or the folder of tables, that a mapping describes.

    Raises:
        FormatError: the file is no recording; PluginError: no converter knows mappings;
            ConversionError: there is no such mapping, or the recording has not what it names.
    """
    recording = read(file)
    for plugin in plugins.found(plugins.CONVERTERS).values():
        converter = plugin.load()
        if isinstance(converter, Exporting):
            break
    else:
        raise PluginError("no converter that is installed can export by a mapping")
    try:
        with _whole(out) as path:
            converter.export(recording, mapping, path)
    except SpoofbenchError:
        raise
    except Exception as error:  # a plugin may raise anything
        raise PluginError(
            f"{plugin} failed to export {file.name!r}: {type(error).__name__}: {error}"
        ) from error


def _chosen(recording: Recording, topics: Sequence[str]) -> list[str]:
    for topic in topics:
        if topic not in recording:
            raise RecordingError(
                f"the recording has no topic {topic!r}; it has {sorted(recording)}"
            )
    return list(dict.fromkeys(topics)) or list(recording)


def _write_all(
    recording: Recording, topics: Sequence[str], out: Path, table_format: Format
) -> None:
    """Write a file per topic into a folder, or into an archive."""
    with _whole(out) as path:
        folder = path.with_name(f"{path.name}.d") if out.suffix == ".zip" else path
        folder.mkdir(parents=True)
        try:
            for topic, name in _names(topics).items():
                _WRITERS[table_format](
                    arrow_table(recording[topic], topic, recording.metadata),
                    folder / f"{name}.{table_format}",
                )
            if folder != path:
                _pack(folder, path)
        finally:
            if folder != path:
                shutil.rmtree(folder)


def _pack(folder: Path, archive: Path) -> None:
    """Pack a folder; the times of its files are left out, so that the same tables give the same
    archive.
    """
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in sorted(folder.iterdir()):
            with (
                path.open("rb") as file,
                packed.open(zipfile.ZipInfo(path.name), "w", force_zip64=True) as member,
            ):
                shutil.copyfileobj(file, member)


def _names(topics: Sequence[str]) -> dict[str, str]:
    """Return a file name per topic, such as ``gnss0_gnss_pvt``, without what a path could take for
    more than a name.
    """
    names: dict[str, str] = {}
    for topic in topics:
        name = re.sub(r"[^A-Za-z0-9-]+", "_", topic).strip("_")
        while name.casefold() in {other.casefold() for other in names.values()}:
            name += "_"
        names[topic] = name
    return names


@contextmanager
def _whole(out: Path) -> Iterator[Path]:
    """Yield a place to write to; what is there takes the name of ``out`` at the end, or goes if an
    exception ends it.
    """
    place = out.with_name(f".{os.getpid()}.part.{out.name}")  # its suffix says the format
    if out.is_dir() and any(out.iterdir()):
        raise RecordingError(f"the folder {str(out)!r} is not empty; name another")
    if out.exists() and not (out.is_dir() or out.is_file()):
        raise RecordingError(f"{str(out)!r} is there and neither file nor folder; name another")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        yield place
        place.replace(out)
    except OSError as error:
        raise RecordingError(
            f"{str(out)!r} cannot be written: {error.strerror or error}"
        ) from error
    finally:
        if place.is_dir():
            shutil.rmtree(place)
        place.unlink(missing_ok=True)
