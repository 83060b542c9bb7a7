"""TOML values as a mapping wants them, refused in one sentence that says where."""

import difflib
from collections.abc import Iterator, Sequence
from typing import Any

from spoofbench.errors import ConversionError

_TYPES = {
    str: "text",
    bool: "true or false",
    dict: "a table",
    list: "a list",
    int: "a whole number",
    float: "a number",
}


class Node:
    """A TOML table and where it stands."""

    def __init__(self, content: dict[str, Any], where: str) -> None:
        self._content = content
        self.where = where

    def error(self, what: str) -> ConversionError:
        """Return an error that says where."""
        return ConversionError(f"{self.where} {what}")

    def __iter__(self) -> Iterator[str]:
        """Return the keys in the order of the text."""
        return iter(self._content)

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def only(self, *known: str) -> None:
        """Refuse a key that is none of these."""
        for key in self._content:
            if key not in known:
                near = difflib.get_close_matches(key, known, 1)
                raise self.error(
                    f"has the unknown key {key!r}; "
                    + (f"did you mean {near[0]!r}?" if near else f"it may have {sorted(known)}")
                )

    def raw(self, key: str) -> Any:
        """Return a value of any type, None where there is none."""
        return self._content.get(key)

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text; without a default it must be there."""
        return str(self._typed(key, str, default))

    def flag(self, key: str, default: bool) -> bool:
        return bool(self._typed(key, bool, default))

    def count(self, key: str) -> int:
        """Return a whole number from 0 on, 0 where there is none."""
        value = self._typed(key, int, 0)
        if not 0 <= value < 2**63:
            raise self.error(f"has {key!r} {value!r}, which must be a whole number from 0 on")
        return int(value)

    def number(self, key: str, default: float) -> float:
        value = self._content.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e30:
            raise self.error(f"has {key!r} {value!r}, which must be a number")
        return float(value)

    def one_of(self, key: str, choices: Sequence[str], default: str | None = None) -> str:
        """Return a text that is one of these."""
        value = self.text(key, default)
        if value != default and value not in choices:
            near = difflib.get_close_matches(value, choices, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it must be one of {list(choices)}"
            raise self.error(f"has {key} {value!r}; {hint}")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a text, or a list of texts, as a tuple; empty where there is none."""
        value = self._content.get(key, [])
        many = [value] if isinstance(value, str) else value
        if not isinstance(many, list) or not all(isinstance(each, str) and each for each in many):
            raise self.error(f"has {key!r} {value!r}, which must be a text or a list of texts")
        return tuple(many)

    def words(self, key: str) -> tuple[str, ...]:
        """Return what cells of a table may hold: a text, number or flag, or a list of them, as
        texts.
        """
        value = self._content.get(key, [])
        many = value if isinstance(value, list) else [value]
        if not all(isinstance(each, str | int | float) for each in many):
            raise self.error(f"has {key!r} {value!r}, which must be texts or numbers")
        return tuple(str(each).lower() if isinstance(each, bool) else str(each) for each in many)

    def child(self, key: str) -> "Node | None":
        """Return the table under a key, None where there is none."""
        return self.child_of(key) if key in self._content else None

    def child_of(self, key: str) -> "Node":
        value = self._typed(key, dict, None)
        return Node(value, f"{self.where}{':' if ':' not in self.where else ','} {key!r}")

    def children(self, key: str) -> Iterator[tuple[str, "Node"]]:
        """Return the tables under the keys of the table under a key."""
        within = self.child(key)
        if within is None:
            return
        for name in within:
            yield name, Node(within._typed(name, dict, None), f"{self.where}: {key} {name!r}")

    def _typed(self, key: str, kind: type, default: Any) -> Any:
        value = self._content.get(key, default)
        if value is None:
            raise self.error(f"lacks {key!r}")
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise self.error(f"has {key!r} {value!r}, which must be {_TYPES[kind]}")
        return value
