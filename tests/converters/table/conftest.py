"""Tables that the tests write, and what becomes of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from spoofbench_converters import table

from spoofbench.conversion import Block, Ledger, Reject, Rejects, Source, SourceMetadata, Used
from spoofbench.recording import Recording
from spoofbench.table import Table

DATA = Path(__file__).parents[4] / "shared" / "data"

MAPPING = """
about = "A car logger"
clock = "sensor"

[table.log.time]
column = "t"
unit = "s"

[table.log."/imu0/imu"]
accel = ["ax", "ay", "az"]
"""


@dataclass(frozen=True)
class Result:
    """What a conversion of a log yields."""

    recording: Recording
    ledger: Ledger
    metadata: dict[str, dict[str, str]]

    @property
    def total(self) -> int:
        return self.ledger.used + self.ledger.skipped


def convert_table(path: Path, **options: Any) -> Result:
    """Convert a log."""
    return convert_by(table, path, **options)


def convert_by(converter: Any, path: Path, **options: Any) -> Result:
    """Convert a log and check that no two blocks of a topic run backwards."""
    tables: dict[str, list[Table]] = {}
    ledger, metadata = Ledger("bytes"), {}
    for item in converter.convert(Source.of(path), converter.Options(**options)):
        if isinstance(item, Block | Used | Reject | Rejects):
            ledger.enter(item)
        if isinstance(item, Block) and len(item.table):
            tables.setdefault(item.topic, []).append(item.table)
        elif isinstance(item, SourceMetadata):
            for name, record in item.metadata.items():
                metadata.setdefault(name, {}).update(record)
    return Result(
        Recording({topic: Table.concat(parts) for topic, parts in tables.items()}, metadata),
        ledger,
        metadata,
    )


@pytest.fixture
def convert_text(tmp_path: Path) -> Callable[..., Result]:
    """Convert text as a CSV file, by a mapping as TOML."""

    def convert(text: str | bytes, mapping: str = MAPPING, **options: Any) -> Result:
        (tmp_path / "log.csv").write_bytes(text.encode() if isinstance(text, str) else text)
        (tmp_path / "mapping.toml").write_text(mapping)
        return convert_table(
            tmp_path / "log.csv", mapping=str(tmp_path / "mapping.toml"), **options
        )

    return convert


@pytest.fixture(scope="session")
def data() -> Path:
    if not DATA.is_dir():
        pytest.skip(f"the field logs are not there: {DATA.name}")
    return DATA
