"""What is not the same in the runs of two scored results folders, by name."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import pandas as pd

from spoofbench.scoring.scored import ScoredFolder

Subject = Literal["version", "plugin", "recording", "suite", "parameter", "threshold"]


@dataclass(frozen=True, slots=True)
class Change:
    """Something that is not the same in both folders.

    Attributes:
        subject: what kind of thing it is.
        name: what has changed.
        a, b: its value; None where a folder has none.
    """

    subject: Subject
    name: str
    a: str | None
    b: str | None


def changes(a: ScoredFolder, b: ScoredFolder) -> tuple[Change, ...]:
    """Return what has changed between two folders, by subject, then name."""
    return tuple(
        Change(subject, name, *values)
        for subject in get_args(Subject)
        for name, values in _differing(_FACTS[subject](a), _FACTS[subject](b))
    )


def _differing(
    a: Mapping[str, str], b: Mapping[str, str]
) -> Iterator[tuple[str, tuple[str | None, str | None]]]:
    for name in sorted(a.keys() | b.keys()):
        if a.get(name) != b.get(name):
            yield name, (a.get(name), b.get(name))


def _versions(folder: ScoredFolder) -> dict[str, str]:
    versions: dict[str, str] = folder.run.get("versions", {})
    return {name: _short(text) for name, text in versions.items()}


def _plugins(folder: ScoredFolder) -> dict[str, str]:
    """Version and digest of the code of each plugin, by its name and distribution."""
    used: dict[str, str] = folder.run.get("plugins", {})
    return {
        name.rpartition(" ")[0]: f"{name.rpartition(' ')[2]}, code {_short(digest)}"
        for name, digest in used.items()
    }


def _recordings(folder: ScoredFolder) -> dict[str, str]:
    inputs: dict[str, str | None] = folder.run.get("inputs", {})
    return {name: _short(digest or "none") for name, digest in inputs.items()}


def _suite(folder: ScoredFolder) -> dict[str, str]:
    """Settings by dotted name; parameters are among those of tasks, defaults included."""
    return {
        name: text
        for name, text in _flat(folder.suite)
        if ".parameters" not in name and ".sources" not in name
    }


def _parameters(folder: ScoredFolder) -> dict[str, str]:
    """Parameters of detectors and attacks, and where those of detectors come from."""
    attacks = folder.tasks.dropna(subset=["attack_parameters"]).drop_duplicates("attack")
    return dict(
        _named(
            "detector", folder.detectors, "detector", "plugin", "parameters", "parameter_sources"
        )
    ) | dict(_named("attack", attacks, "attack", "attack_plugin", "attack_parameters"))


def _named(
    kind: str, tasks: pd.DataFrame, name: str, plugin: str, *columns: str
) -> Iterator[tuple[str, str]]:
    for _, task in tasks.iterrows():
        yield f"{kind} {task[name]}", str(task[plugin])
        for column in columns:
            suffix = " source" if column == "parameter_sources" else ""
            for key, text in _flat(json.loads(task[column])):
                yield f"{kind} {task[name]}.{key}{suffix}", text


def _thresholds(folder: ScoredFolder) -> dict[str, str]:
    """Factors of each detector on each class, one for each set of sessions held out."""
    table = folder.thresholds.sort_values(["held_out", "left_out"])
    return {
        f"{detector} on {sensor_class}": ", ".join(
            dict.fromkeys(
                str(row.how) if pd.isna(row.factor) else f"{row.factor:.6g} ({row.how})"
                for row in rows.itertuples()
            )
        )
        for (detector, sensor_class), rows in table.groupby(["detector", "sensor_class"])
    }


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Each value of nested mappings and of lists of things with an id, as text, by dotted name."""
    if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
        value = {str(each.get("id", number)): each for number, each in enumerate(value)}
    if isinstance(value, dict):
        for key, part in value.items():
            if key != "id":
                yield from _flat(part, f"{name}.{key}" if name else key)
    else:
        yield name, value if isinstance(value, str) else json.dumps(value)


def _short(text: str) -> str:
    """A digest by its first digits, which is enough to see that two differ."""
    return text[:12] if len(text) == 64 else text


_FACTS: Mapping[Subject, Any] = {
    "version": _versions,
    "plugin": _plugins,
    "recording": _recordings,
    "suite": _suite,
    "parameter": _parameters,
    "threshold": _thresholds,
}
