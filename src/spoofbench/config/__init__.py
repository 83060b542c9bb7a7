"""Configuration: values of TOML files and texts of the command line, read into dataclasses.

The dataclass is the whole description. Its fields are the keys, its annotations say what each may
be, its defaults what may be left out::

    @dataclass(frozen=True)
    class Parameters:
        rate_mps: Annotated[float, Gt(0)]
        axis: Literal["north", "east"] = "north"
        window_s: tuple[float, float] | None = None

    read(Parameters, {"rate_mps": 2, "axis": "east"}, "the suite 'drive.toml'")
    read(Parameters, {"rate_mps": Text("2"), "window_s": Text("[0, 9.5]")}, "attack 'drag-off'")

An annotation can be ``bool``, ``int`` (of 64 bits), ``float`` (finite, unless the field's default
is not), ``str``, a numpy scalar, ``Literal``, an enum (read by value or name), a path, ``None``, a
union, tuple, list or mapping of these, a dataclass, or ``Any`` (what TOML can say, apart from
dates), or ``object`` (whatever is there, as it is). ``Annotated`` adds constraints of
:mod:`annotated_types`, and by its ``doc("...")`` the words for what a value must be.
``field(metadata={"key": ...})`` gives a field another key.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from spoofbench.config.values import NOT_ONLY_FINITE, Section, Text, plain
from spoofbench.config.wording import bare_key, did_you_mean, one_line
from spoofbench.errors import ConfigError, SpoofbenchError

__all__ = [
    "NOT_ONLY_FINITE",
    "Text",
    "bare_key",
    "did_you_mean",
    "plain",
    "read",
    "read_toml",
]

T = TypeVar("T")


def read_toml(
    source: Path | bytes | str, what: str, error: type[SpoofbenchError] = ConfigError
) -> dict[str, Any]:
    """Return the table of a TOML file, or of the bytes or text of one.

    Args:
        source: a path, or what is in the file.
        what: what an error calls it, such as ``the suite 'drive.toml'``.
        error: class of the error.

    Raises:
        SpoofbenchError: of the class ``error``: it cannot be read, or is not TOML.
    """
    try:
        content = source.read_bytes() if isinstance(source, Path) else source
        return tomllib.loads(content.decode() if isinstance(content, bytes) else content)
    except OSError as reason:
        raise error(f"{what} cannot be read: {reason.strerror or reason}") from reason
    except RecursionError as reason:
        raise error(f"{what} is not TOML: it nests too deeply") from reason
    except ValueError as reason:
        raise error(f"{what} is not TOML: {one_line(reason)}") from reason


def read(
    kind: type[T],
    table: Mapping[str, Any],
    where: str,
    *,
    section: str = "",
    noun: str = "key",
    error: type[SpoofbenchError] = ConfigError,
) -> T:
    """Return a dataclass made from a table, with each value read as its field's annotation says.

    Args:
        kind: the dataclass. A ``ValueError`` of its ``__post_init__`` says what does not fit.
        table: by key, what TOML or JSON can say, finished instances, or :class:`Text`.
        where: what an error names first, such as ``the suite 'drive.toml'``.
        section: of the file that the table is, such as ``table.log``.
        noun: what an error calls a key, such as ``parameter``.
        error: class of the error.

    Raises:
        SpoofbenchError: of the class ``error``, in one sentence: a key is unknown or missing, a
            value is not what its annotation says, or the dataclass refuses the values.
    """
    try:
        top = Section(where, noun, error)
        made: T = (top.within(section) if section else top).read(kind, table)
    except RecursionError as reason:
        raise error(f"{where} nests its tables too deeply; write it flat") from reason
    return made
