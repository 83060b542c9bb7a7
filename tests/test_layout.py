"""The ready layout for Foxglove names what recordings have."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spoofbench.codec.channels import LOCATION_SUFFIX
from spoofbench.schema import KINDS, split_topic

LAYOUT = Path(__file__).parent.parent / "schemas" / "foxglove-layout.json"


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _texts(part)


def test_topics_and_fields_are_those_of_the_schema() -> None:
    configs = json.loads(LAYOUT.read_text())["configById"]
    paths = [text for text in _texts(configs) if text.startswith("/")]
    for path in paths:
        topic, _, field = path.partition(".")
        if topic.endswith(LOCATION_SUFFIX):
            topic = topic.removesuffix(LOCATION_SUFFIX) + "/gnss/pvt"
        kind = KINDS[split_topic(topic)[1]]
        assert not field or field in kind.fields, path
    assert len(paths) == 11


def test_every_panel_has_a_place() -> None:
    layout = json.loads(LAYOUT.read_text())
    placed = [text for text in _texts(layout["layout"]) if "!" in text]
    assert sorted(placed) == sorted(layout["configById"])
