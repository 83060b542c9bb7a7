"""Words of an error: names that are near, keys and values as TOML writes them."""

import difflib
import json
import re
import reprlib
from collections.abc import Iterable
from datetime import date


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """Return how a sentence about an unknown name ends: with the nearest name, or with all."""
    known = sorted(known)
    near = difflib.get_close_matches(given[:100], known, 1)
    return f"; did you mean {near[0]!r}?" if near else f"; there are {known or 'none'}"


def bare_key(key: str) -> str:
    """Return a key as TOML writes it: quoted where it must be."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def one_line(reason: object) -> str:
    return " ".join(str(reason).split())


class _Brief(reprlib.Repr):
    """A value as a message shows it: as TOML writes it, and shortened."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 100
        self.maxlong = 40
        self.maxlist = self.maxtuple = self.maxdict = 12

    def repr_bool(self, value: bool, _: int) -> str:
        return "true" if value else "false"

    def repr_date(self, value: date, _: int) -> str:
        return value.isoformat()

    repr_datetime = repr_date

    def repr_int(self, value: int, level: int) -> str:
        # decimal digits of what has very many cost too much, and Python refuses to count them
        if value.bit_length() > 4096:
            return f"{hex(value)[:18]}..."
        return super().repr_int(value, level)


shown = _Brief().repr
