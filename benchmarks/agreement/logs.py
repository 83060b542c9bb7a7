"""Which files of a folder are logs, and what must be said to convert them."""

import csv
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent
NO_LOGS = (".chk", ".md", ".msg", ".tag")


@dataclass(frozen=True, slots=True)
class SampleLog:
    """A log: its path, its name within the folder, the manifest's row on it, and the format and
    options to convert it with.
    """

    path: Path
    name: str
    manifest: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)
    format: str | None = None


def logs(folder: Path) -> Iterator[SampleLog]:
    """Yield the logs in a folder, in the order of their names.

    Definitions, companions and other parsers' answers are none. ``options.toml`` beside this file
    gives options by name.
    """
    rows = {
        manifest.parent / row.get("stored_as", row.get("name", "")): row
        for manifest in folder.rglob("manifest.csv")
        for row in csv.DictReader(manifest.open(newline="", encoding="utf-8"))
    }
    with (HERE / "options.toml").open("rb") as file:
        options = tomllib.load(file)
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if path.suffix in NO_LOGS or path.name in ("manifest.csv", "LICENSE", "NOTICE"):
            continue
        given = {
            name: text.replace("{folder}", str(path.parent))
            for name, text in options.get(path.name, {}).items()
        }
        form = given.pop("format", None)
        yield SampleLog(path, path.relative_to(folder).as_posix(), rows.get(path, {}), given, form)
