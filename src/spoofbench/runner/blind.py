"""Blind material: what detectors see of a recording's variants, in a private folder under numbers
that say nothing.

A table that variants share is stored once, and loaded once, so that a detector may remember what it
made of it.
"""

import json
import pickle
from functools import partial
from pathlib import Path
from typing import Any

from spoofbench.recording import Recording
from spoofbench.table import Table


class BlindWriter:
    """Writes the blind part of variants into a folder; tables of the base are stored once for
    all.
    """

    def __init__(self, folder: Path, base: Recording) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._shared = {
            topic: (f"base-{number}", table)
            for number, (topic, table) in enumerate(base.blind().items())
        }
        for file, table in self._shared.values():
            self._dump(file, table)

    def put(self, name: str, variant: Recording) -> None:
        """Store a variant."""
        blind, files = variant.blind(), {}
        for number, (topic, table) in enumerate(blind.items()):
            file, base = self._shared.get(topic, ("", None))
            files[topic] = file if table is base else f"{name}-{number}"
            if table is not base:
                self._dump(files[topic], table)
        about = {
            "metadata": {key: dict(record) for key, record in blind.metadata.items()},
            "tables": files,
        }
        (self.folder / f"{name}.json").write_text(json.dumps(about))

    def _dump(self, file: str, table: Table) -> None:
        with (self.folder / file).open("wb") as stream:
            pickle.dump(table, stream, protocol=5)


class BlindReader:
    """Reads variants from a folder; tables of the base are the same objects in all of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._shared: dict[str, Table] = {}

    def get(self, name: str) -> Recording:
        """Return a variant, its tables loaded when first used."""
        about = self._about(name)
        return Recording(
            {topic: partial(self._load, file) for topic, file in about["tables"].items()},
            about["metadata"],
        )

    def size(self, name: str) -> int:
        """Size in bytes of a variant's tables."""
        return sum(
            (self.folder / file).stat().st_size for file in self._about(name)["tables"].values()
        )

    def _about(self, name: str) -> dict[str, Any]:
        about: dict[str, Any] = json.loads((self.folder / f"{name}.json").read_text())
        return about

    def _load(self, file: str) -> Table:
        if file in self._shared:
            return self._shared[file]
        with (self.folder / file).open("rb") as stream:
            table: Table = pickle.load(stream)
        if file.startswith("base-"):
            self._shared[file] = table
        return table
