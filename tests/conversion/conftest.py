"""A converter of a made-up format, as a plugin."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal

import pytest

from spoofbench import plugins
from spoofbench.conversion import Item, Source


@dataclass(frozen=True)
class Options:
    rate_hz: float = 1.0
    name: str = "x"
    mode: Literal["fast", "slow"] = "fast"
    count: int | None = None
    keep: bool = False


@dataclass(frozen=True)
class FakePlugin:
    name: str
    converter: Any
    distribution: str = "fake"
    version: str = "1"

    def __str__(self) -> str:
        return f"converter {self.name!r} of fake 1"

    def load(self) -> Any:
        if isinstance(self.converter, Exception):
            raise self.converter
        return self.converter


Install = Callable[..., None]


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install converters by name; each is a list of items, or a function that yields them."""
    found: dict[str, FakePlugin] = {}
    monkeypatch.setattr(plugins, "found", lambda group: found)

    def add(
        name: str,
        items: Any,
        sniff: float | Exception | Callable[[Source], float] = 1.0,
        unit: str = "records",
    ) -> None:
        def convert(source: Source, options: Any) -> Iterator[Item]:
            yield from (items(source, options) if callable(items) else items)

        def judge(source: Source) -> float:
            if isinstance(sniff, Exception):
                raise sniff
            return sniff(source) if callable(sniff) else sniff

        found[name] = FakePlugin(
            name,
            SimpleNamespace(VERSION="7", UNIT=unit, Options=Options, sniff=judge, convert=convert),
        )

    return add
