"""One table, and each value in it, on the way to what a dataclass's annotations say."""

import difflib
import math
import operator
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import PurePath
from types import NoneType, UnionType
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import DocInfo, Ge, Gt, Le, Lt, MaxLen, MinLen, Predicate

from spoofbench.config.wording import bare_key, did_you_mean, one_line, shown
from spoofbench.errors import SpoofbenchError

NOT_ONLY_FINITE = "not only finite"
"""In ``Annotated``: floats within may be infinite or NaN."""

_IS_GROUP = "__is_annotated_types_grouped_metadata__"
_LISTS: Mapping[Any, Callable[[list[Any]], Any]] = {tuple: tuple, Sequence: tuple, list: list}
_TABLES = (dict, Mapping)
_BOUNDS: Mapping[type, tuple[str, Callable[[Any, Any], bool], str]] = {
    Ge: ("ge", operator.ge, "of at least"),
    Gt: ("gt", operator.gt, "above"),
    Le: ("le", operator.le, "at most"),
    Lt: ("lt", operator.lt, "below"),
}
_FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


class Text(str):
    """A value as a user typed it, which is read as its field's annotation wants it.

    It is taken as TOML where it is TOML (``2.5``, ``[1, 2]``, ``"5"``), and else as it stands;
    empty is ``None`` where that may be.
    """

    __slots__ = ()


def plain(value: Any) -> Any:
    """Return a value as JSON and TOML can say it, which :func:`read` turns back into an equal one.

    Raises:
        TypeError: there is no way to say it.
    """
    if is_dataclass(value) and not isinstance(value, type):
        values = ((_key(each), getattr(value, each.name)) for each in fields(value) if each.init)
        return {key: plain(item) for key, item in values}
    if isinstance(value, Enum):
        return value.value if type(value.value) in (str, int) else value.name
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if _is_numpy(type(value)):
        return plain(value.tolist())
    if isinstance(value, PurePath):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"neither JSON nor TOML can say {value!r}")


@dataclass(frozen=True, slots=True)
class Section:
    """A table on its way to a dataclass, and how an error calls it."""

    where: str
    noun: str
    error: type[SpoofbenchError]
    path: str = ""

    def read(self, kind: type[Any], table: Mapping[str, Any]) -> Any:
        known = {_key(each): each for each in fields(kind) if each.init}
        for key in table:
            if key not in known:
                has = "has an unknown" if self.noun == "key" else "has no"
                hint = did_you_mean(str(key), known)
                raise self.error(f"{self.where} {has} {self.noun} {shown(key)}{hint}")
        hints = self._annotations(kind) if table else {}
        values = {}
        for key, each in known.items():
            if key in table:
                value = _Value(self, key, each.default)
                values[each.name] = value.read_or_refuse(hints[each.name], table[key])
            elif each.default is MISSING and each.default_factory is MISSING:
                raise self.error(f"{self.where} lacks the {self.noun} {key!r}; add it")
        try:
            return kind(**values)
        except (ValueError, SpoofbenchError) as reason:
            refusal = one_line(reason)
        except Exception as reason:  # noqa: BLE001, the dataclass of a plugin may raise anything
            refusal = f"{type(reason).__name__}: {one_line(reason)}"
        raise self.error(
            f"{self.where}: {refusal}"
            if self.noun == "key"
            else f"{self.where} refuses its {self.noun}s {shown(values)}: {refusal}"
        )

    def within(self, key: str, number: int | None = None) -> "Section":
        """Return the table under a key, or one of several under it."""
        path = f"{self.path}.{key}" if self.path else key
        label = f"[{path}]" if number is None else f"[[{path}]] number {number}"
        top = self.where.removesuffix(f", [{self.path}]") if self.path else self.where
        return Section(f"{top}, {label}", self.noun, self.error, path)

    def _annotations(self, kind: Any) -> dict[str, Any]:
        try:
            return _annotations_of(kind)
        except Exception as reason:  # annotations of a plugin may raise anything
            raise self.error(
                f"{self.where}: the annotations of {kind.__name__} cannot be resolved: "
                f"{type(reason).__name__}: {one_line(reason)}; its author must import what they "
                "name at run time"
            ) from reason


@cache
def _annotations_of(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


class _Mismatch(Exception):
    """A value is not what its annotation says; ``args`` are its label, the value, and what it must
    be.
    """


@dataclass(frozen=True, slots=True)
class _Value:
    """A value of a section on its way to what its annotation says; ``number`` counts the items of a
    list from 1.
    """

    section: Section
    key: str
    default: Any = None
    number: int | None = None
    any_float: bool = False

    @property
    def label(self) -> str:
        return self.key if self.number is None else f"{self.key}[{self.number - 1}]"

    def read_or_refuse(self, kind: Any, value: Any) -> Any:
        """Return the value of a field; a mismatch becomes a sentence."""
        try:
            return self._typed(kind, value) if isinstance(value, Text) else self.read(kind, value)
        except _Mismatch as mismatch:
            label, wrong, wanted = mismatch.args
        noun = "" if self.section.noun == "key" else f"{self.section.noun} "
        raise self.section.error(
            f"{self.section.where}: {noun}{label} = {shown(wrong)} must be {wanted}"
        )

    def read(self, kind: Any, value: Any) -> Any:
        """Return the value as the annotation says.

        Raises:
            _Mismatch: it cannot be that.
            SpoofbenchError: of the section's class: a table within it is wrong, or nothing can be
                read for such an annotation.
        """
        if kind is type(value) and kind in (bool, str):
            return value  # as most are
        origin, args = get_origin(kind) or kind, get_args(kind)
        if origin is Annotated:
            return self._constrained(args[0], args[1:], value)
        if origin in (Union, UnionType):
            return self._union(args, value)
        if origin is Final or hasattr(kind, "__supertype__"):  # the latter: typing.NewType
            return self.read(args[0] if args else kind.__supertype__, value)
        if _is_numpy(type(value)) and not _is_numpy(origin):
            value = value.tolist()
        if origin in (None, NoneType):
            return self._require(value is None, value, "empty")
        if origin is object:
            return value
        if origin is Any:
            return self._anything(value)
        if origin is Literal:
            return self._choice([(plain(choice), choice) for choice in args], value)
        if origin in _TABLES:
            return self._table(args or (str, Any), value)
        if origin in _LISTS:
            return self._list(origin, args, value)
        return self._scalar(origin, value) if isinstance(origin, type) else self._other(kind, value)

    def _typed(self, kind: Any, text: Text) -> Any:
        """Return what a user typed, in the first reading that fits."""
        refusals: list[Exception] = []
        for reading in _readings(str(text)):
            try:
                return self.read(kind, reading)
            except (_Mismatch, self.section.error) as refusal:
                refusals.append(refusal)
        first = refusals[0]
        if not isinstance(first, _Mismatch) or first.args[0] != self.label:
            raise first
        wanted = first.args[2]
        with suppress(_Mismatch, self.section.error):
            self.read(kind, None)
            wanted = f"empty or {wanted}"
        raise _Mismatch(self.label, str(text), wanted)

    def _scalar(self, kind: type[Any], value: Any) -> Any:
        if kind is bool:
            return self._require(isinstance(value, bool), value, "true or false")
        if kind is int:
            return int(self._require(_is_int64(value), value, "a whole number"))
        if kind is float:
            return self._number(value)
        if kind is str:
            return str.__str__(self._require(isinstance(value, str), value, "a string"))
        if is_dataclass(kind) and not isinstance(value, kind):
            form = f"[{self.key}]" if self.number is None else f"[[{self.key}]]"
            self._require(isinstance(value, Mapping), value, f"a table: write it as {form}")
            return self.section.within(self.key, self.number).read(kind, value)
        if issubclass(kind, Enum):
            members = [(plain(member), member) for member in kind]
            return self._choice([*members, *kind.__members__.items()], value)
        if issubclass(kind, PurePath):
            fits = isinstance(value, PurePath) or (isinstance(value, str) and value != "")
            return kind(self._require(fits and "\0" not in str(value), value, "a non-empty path"))
        return self._numpy(kind, value) if _is_numpy(kind) else self._other(kind, value)

    def _number(self, value: Any) -> float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        self._require(is_number, value, "a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.nan
        self._require(self._is_allowed(number), value, "a finite number")
        return number

    def _is_allowed(self, number: float) -> bool:
        is_default = isinstance(self.default, float) and number == self.default
        return math.isfinite(number) or is_default or self.any_float

    def _numpy(self, kind: Any, value: Any) -> Any:
        import numpy as np

        value = value.tolist() if isinstance(value, np.generic) else value
        if issubclass(kind, np.bool_):
            return kind(self.read(bool, value))
        is_whole = issubclass(kind, np.integer)
        is_number = is_whole or issubclass(kind, np.floating)
        if not is_number or kind in (np.integer, np.signedinteger, np.unsignedinteger, np.floating):
            return self._other(kind, value)
        number = self.read(int if is_whole else float, value)
        limits: Any = np.iinfo(kind) if is_whole else np.finfo(kind)
        low, high = (type(number)(limit) for limit in (limits.min, limits.max))
        fits = low <= number <= high or not math.isfinite(number)
        self._require(fits, value, f"{_noun(number)} from {low} to {high}")
        return kind(number)

    def _choice(self, choices: Sequence[tuple[Any, Any]], value: Any) -> Any:
        """Return what goes with a plain value, of pairs of plain value and choice."""
        sought = plain(value) if isinstance(value, Enum) else value
        for known, choice in choices:
            if type(known) is type(sought) and known == sought:
                return choice
        names = list(dict.fromkeys(shown(known) for known, _ in choices))
        near = difflib.get_close_matches(shown(sought), names, 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise _Mismatch(self.label, value, f"one of {', '.join(names)}{hint}")

    def _union(self, kinds: Sequence[Any], value: Any) -> Any:
        """Return the value as the kind that it is already, or else the first that it can be."""
        wanted = []
        refusals: list[SpoofbenchError] = []
        for kind in sorted(kinds, key=lambda kind: type(value) is not kind):
            try:
                return self.read(kind, value)
            except _Mismatch as mismatch:
                wanted.append(mismatch)
            except self.section.error as refusal:
                refusals.append(refusal)
        if refusals:
            raise refusals[0]
        deeper = [mismatch for mismatch in wanted if mismatch.args[0] != self.label]
        if deeper:
            raise deeper[0]
        words = dict.fromkeys(str(mismatch.args[2]) for mismatch in wanted)
        raise _Mismatch(self.label, value, " or ".join(w for w in words if w != "empty"))

    def _list(self, kind: Any, args: tuple[Any, ...], value: Any) -> Any:
        self._require(isinstance(value, list | tuple), value, "a list")
        kinds: Sequence[Any] = args
        if kind is not tuple or not args or args[-1] is Ellipsis:
            kinds = (args[0] if args else Any,) * len(value)
        self._require(len(kinds) == len(value), value, f"a list of {len(kinds)} values")
        items = [
            replace(self, key=self.label, number=number).read(each, item)
            for number, (each, item) in enumerate(zip(kinds, value, strict=True), 1)
        ]
        return _LISTS[kind](items)

    def _table(self, kinds: tuple[Any, ...], value: Any) -> dict[Any, Any]:
        self._require(isinstance(value, Mapping), value, "a table")
        key_kind, kind = kinds
        made = {}
        for key, item in value.items():
            within = replace(self, key=f"{self.label}.{bare_key(str(key))}", number=None)
            is_text = isinstance(key, str) and key_kind not in (str, Any)
            name = within._typed(key_kind, Text(key)) if is_text else within.read(key_kind, key)
            made[name] = within.read(kind, item)
        return made

    def _anything(self, value: Any) -> Any:
        """Return what TOML can say apart from dates, with tuples for lists."""
        if isinstance(value, list | tuple):
            return self._list(tuple, (), value)
        if isinstance(value, Mapping):
            return self._table((str, Any), value)
        if value is None or isinstance(value, str | bool):
            return value
        fits = self._is_allowed(value) if isinstance(value, float) else _is_int64(value)
        return self._require(
            fits, value, "a string, a finite number, true or false; write dates as strings"
        )

    def _constrained(self, kind: Any, metadata: Iterable[Any], value: Any) -> Any:
        rules = [
            rule
            for each in metadata
            for rule in (each if getattr(each, _IS_GROUP, False) else (each,))
        ]
        within = replace(self, any_float=True) if NOT_ONLY_FINITE in rules else self
        words = next((rule.documentation for rule in rules if isinstance(rule, DocInfo)), None)
        try:
            made = within.read(kind, value)
            broken = made is not None and not all(self._keeps(rule, made) for rule in rules)
            wanted = _noun(made)
        except _Mismatch as mismatch:
            label, _, wanted = mismatch.args
            if words is None and label != self.label:
                raise
            broken = True
        if broken:
            raise _Mismatch(self.label, value, words or _with_rules(wanted, rules))
        return made

    def _keeps(self, rule: Any, value: Any) -> bool:
        try:
            if type(rule) in _BOUNDS:
                name, compare, _ = _BOUNDS[type(rule)]
                return bool(compare(value, getattr(rule, name)))
            if isinstance(rule, MinLen):
                return len(value) >= rule.min_length
            if isinstance(rule, MaxLen):
                return len(value) <= rule.max_length
            return not isinstance(rule, Predicate) or bool(rule.func(value))
        except Exception as reason:  # a rule of a plugin may raise anything
            raise self._blame(
                f"has the rule {rule!r}, which raises {type(reason).__name__}: {one_line(reason)}"
            ) from reason

    def _other(self, kind: Any, value: Any) -> Any:
        """Return a finished instance; nothing else can be read for this annotation."""
        if isinstance(kind, type) and isinstance(value, kind):
            return value
        name = getattr(kind, "__name__", None) or str(kind)
        raise self._blame(f"is of type {name}, which neither TOML nor a text can say")

    def _blame(self, what: str) -> SpoofbenchError:
        return self.section.error(
            f"{self.section.where}: the {self.section.noun} {self.label} {what}; its author must "
            "annotate it otherwise"
        )

    def _require(self, fits: bool, value: Any, wanted: str) -> Any:
        if not fits:
            raise _Mismatch(self.label, value, wanted)
        return value


def _is_int64(value: Any) -> bool:
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    return is_whole and -(2**63) <= value < 2**63


def _readings(text: str) -> Iterator[Any]:
    """Yield what a text can mean, the most literal first."""
    if not text:
        yield None
    with suppress(ValueError, RecursionError):
        table = tomllib.loads(f"value = {text}")
        if table.keys() == {"value"}:
            yield table["value"]
    yield text
    for number in (int, float):
        with suppress(ValueError):
            yield number(text)
    if text.lower() in _FLAGS:
        yield _FLAGS[text.lower()]


def _with_rules(wanted: str, rules: Iterable[Any]) -> str:
    """Return the words for what a value must be, with its constraints."""
    limits = []
    for rule in rules:
        if type(rule) in _BOUNDS:
            name, _, words = _BOUNDS[type(rule)]
            limit = getattr(rule, name)
            limits.append(f"{words} {limit:g}" if isinstance(limit, float) else f"{words} {limit}")
        elif isinstance(rule, MinLen) and rule.min_length == 1:
            wanted = wanted.replace("a ", "a non-empty ", 1)
        elif isinstance(rule, MinLen):
            limits.append(f"of length {rule.min_length} or more")
        elif isinstance(rule, MaxLen):
            limits.append(f"of length {rule.max_length} or less")
        elif isinstance(rule, Predicate):
            limits.append(f"for which {getattr(rule.func, '__name__', rule.func)} holds")
    return " ".join([wanted, " and ".join(limits)]).strip()


def _noun(value: Any) -> str:
    if isinstance(value, int):
        return "a whole number"
    nouns = {float: "a number", str: "a string", tuple: "a list", list: "a list", dict: "a table"}
    return nouns.get(type(value), "a value")


def _key(field: "Field[Any]") -> str:
    return str(field.metadata.get("key", field.name))


def _is_numpy(kind: Any) -> bool:
    return getattr(kind, "__module__", None) == "numpy"
