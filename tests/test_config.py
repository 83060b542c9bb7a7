"""A configuration is read as its dataclass says, or refused in one sentence with key and value."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, NewType, Optional

import numpy as np
import pytest
from annotated_types import Ge, Gt, Interval, MinLen, Predicate, doc
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofbench.config import Text, plain, read, read_toml
from spoofbench.errors import ConfigError, PluginError, SuiteError

Metres = NewType("Metres", float)
SINGLE, SMALL = np.float32(0), np.int16(0)


class Axis(Enum):
    NORTH = "n"
    EAST = "e"


class Shape(Enum):
    ROUND = (1, 2)
    FLAT = 7


@dataclass(frozen=True)
class Motion:
    speed_mps: Annotated[float, Gt(0)]
    axes: tuple[Axis, ...] = ()


@dataclass(frozen=True)
class Everything:
    """A field of every sort that can be annotated."""

    number: float
    count: int = 3
    flag: bool = False
    text: str = ""
    statistic: Literal["H", "M", 1, True] = "H"
    axis: Axis = Axis.NORTH
    shape: Shape = Shape.FLAT
    path: Path | None = None
    optional: Optional[float] = None  # noqa: UP045, as old code writes it
    either: int | float | str = 0
    pair: tuple[int, str] = (0, "")
    weights: tuple[float, ...] = ()
    names: list[str] = field(default_factory=list)
    by_axis: Mapping[Axis, int] = field(default_factory=dict)
    by_name: dict[str, float] = field(default_factory=dict)
    motion: Motion | None = None
    motions: tuple[Motion, ...] = ()
    single: np.float32 = SINGLE
    small: np.int16 = SMALL
    known: np.bool_ = np.False_
    height: Metres = Metres(0.0)
    horizon_s: float = math.inf
    share: Annotated[float, Interval(ge=0, lt=1)] = 0.5
    even: Annotated[int, Predicate(lambda number: number % 2 == 0)] = 0
    code: Annotated[str, MinLen(1), doc("a code such as 'A1'")] = "A1"
    renamed: int = field(default=0, metadata={"key": "name"})
    anything: Any = None
    made: int = field(default=0, init=False)


ENDLESS = frozenset({"horizon_s"})
finite = st.floats(allow_nan=False, allow_infinity=False)
int64 = st.integers(-(2**63) + 1, 2**63 - 1)
characters = st.characters(exclude_categories=["Cs"])
text = st.text(characters)
motions = st.builds(
    Motion, st.floats(0, exclude_min=True, allow_infinity=False), st.tuples(st.sampled_from(Axis))
)
plain_values = st.recursive(
    st.booleans() | int64 | finite | text,
    lambda inner: st.lists(inner).map(tuple) | st.dictionaries(text, inner),
    max_leaves=5,
)
everything = st.builds(
    Everything,
    number=finite,
    count=int64,
    flag=st.booleans(),
    text=text,
    statistic=st.sampled_from(["H", "M", 1, True]),
    axis=st.sampled_from(Axis),
    shape=st.sampled_from(Shape),
    path=st.none() | st.text(st.characters(codec="ascii", exclude_characters="\0")).map(Path),
    optional=st.none() | finite,
    either=int64 | finite | text,
    pair=st.tuples(int64, text),
    weights=st.lists(finite).map(tuple),
    names=st.lists(text),
    by_axis=st.dictionaries(st.sampled_from(Axis), int64),
    by_name=st.dictionaries(text, finite),
    motion=st.none() | motions,
    motions=st.lists(motions).map(tuple),
    single=st.floats(width=32, allow_nan=False, allow_infinity=False).map(np.float32),
    small=st.integers(-(2**15), 2**15 - 1).map(np.int16),
    known=st.booleans().map(np.bool_),
    height=finite.map(Metres),
    horizon_s=finite | st.just(math.inf),
    share=st.floats(0, 1, exclude_max=True),
    even=st.integers(-100, 100).map(lambda half: 2 * half),
    code=st.text(characters, min_size=1),
    renamed=int64,
    anything=plain_values,
)
toml_trees = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | text
    | st.dates()
    | st.times()
    | st.datetimes()
    | st.sampled_from(["n", "H", "FLAT", "7", "NORTH"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["speed_mps", "axes", "n", "e"]) | text, inner)
    ),
    max_leaves=12,
)
KEYS = [each.metadata.get("key", each.name) for each in fields(Everything)]


def _toml(value: Any) -> str:
    """Write a plain value as TOML, without what is None."""
    if isinstance(value, dict):
        pairs = (f"{_toml(k)} = {_toml(v)}" for k, v in value.items() if v is not None)
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return repr(value)
    return (
        json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        if value is not None
        else ""
    )


def _is_sentence(reason: object) -> bool:
    return str(reason).startswith("the suite 'x'") and "\n" not in str(reason)


def _read_or_refused(table: dict[str, Any]) -> Everything | None:
    """Read a table; if that is refused, hold the refusal to its form."""
    refusal = ""
    try:
        return read(Everything, table, "the suite 'x'", error=SuiteError)
    except SuiteError as error:
        refusal = str(error)
    assert _is_sentence(refusal)
    return None


@settings(deadline=None, max_examples=60)
@given(everything)
def test_what_a_configuration_says_reads_back_equal(made: Everything) -> None:
    said = {key: value for key, value in plain(made).items() if value is not None}
    assert read(Everything, said, "x") == made
    document = "\n".join(f"{key} = {_toml(value)}" for key, value in said.items())
    assert read(Everything, read_toml(document, "x"), "x") == made
    instances = {
        each.metadata.get("key", each.name): getattr(made, each.name)
        for each in fields(made)
        if each.init
    }
    assert read(Everything, instances, "x") == made


@settings(deadline=None, max_examples=60)
@given(everything)
def test_every_value_can_be_typed_as_key_and_value(made: Everything) -> None:
    typed = {key: Text(_toml(value)) for key, value in plain(made).items()}
    assert read(Everything, typed, "x") == made


@settings(deadline=None)
@given(text)
def test_a_text_that_is_no_toml_stands_for_itself(word: str) -> None:
    made = read(Everything, {"number": Text("1"), "text": Text(word)}, "x")
    if not word.startswith(('"', "'")):
        assert made.text == word


@settings(deadline=None, max_examples=300)
@given(st.dictionaries(st.sampled_from(KEYS) | text, toml_trees | text.map(Text)))
def test_any_tree_is_read_or_refused(tree: dict[str, Any]) -> None:
    made = _read_or_refused({"number": 1} | tree)
    for name, value in vars(made).items() if made else ():
        if isinstance(value, float) and name not in ENDLESS:
            assert math.isfinite(value)


@settings(deadline=None)
@given(st.sampled_from(KEYS), text | st.sampled_from(["nan", "inf", "1e999", "[1]", "{}", "''"]))
def test_any_text_is_read_or_refused(key: str, word: str) -> None:
    made = _read_or_refused({"number": 1, key: Text(word)})
    assert made is None or key in vars(made)


@pytest.mark.parametrize(
    ("key", "word", "value"),
    [
        ("number", ".5", 0.5),
        ("number", "7", 7.0),
        ("count", "007", 7),
        ("flag", "Yes", True),
        ("flag", "0", False),
        ("text", "5", "5"),
        ("text", '"5"', "5"),
        ("text", "a=b # c", "a=b # c"),
        ("statistic", "M", "M"),
        ("statistic", "1", 1),
        ("statistic", "true", True),
        ("axis", "n", Axis.NORTH),
        ("axis", "EAST", Axis.EAST),
        ("shape", "ROUND", Shape.ROUND),
        ("path", "logs/a b.ubx", Path("logs/a b.ubx")),
        ("path", "", None),
        ("optional", "", None),
        ("either", "1", 1),
        ("either", "1.0", 1.0),
        ("either", "one", "one"),
        ("weights", "[1, 2.5]", (1.0, 2.5)),
        ("motion", "{ speed_mps = 3, axes = ['e'] }", Motion(3.0, (Axis.EAST,))),
        ("horizon_s", "inf", math.inf),
    ],
)
def test_texts_are_read_as_their_annotation(key: str, word: str, value: Any) -> None:
    made = getattr(read(Everything, {"number": 1, key: Text(word)}, "x"), key)
    assert (made, type(made)) == (value, type(value))


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("number", "abc", "number = 'abc' must be a number"),
        ("number", Text("abc"), "number = 'abc' must be a number"),
        ("number", Text("nan"), "number = 'nan' must be a finite number"),
        ("number", math.inf, "number = inf must be a finite number"),
        ("number", True, "number = true must be a number"),
        ("horizon_s", Text("nan"), "horizon_s = 'nan' must be a finite number"),
        ("count", 1.0, "count = 1.0 must be a whole number"),
        ("count", 2**63, "count = 9223372036854775808 must be a whole number"),
        ("flag", 1, "flag = 1 must be true or false"),
        ("text", 5, "text = 5 must be a string"),
        ("statistic", "h", "statistic = 'h' must be one of 'H', 'M', 1, true"),
        ("axis", "NORHT", "axis = 'NORHT' must be one of 'n', 'e', 'NORTH', 'EAST'; did you mean"),
        ("path", "a\0b", "path = 'a\\x00b' must be a non-empty path"),
        ("either", [], "either = [] must be a whole number or a number or a string"),
        ("pair", [1], "pair = [1] must be a list of 2 values"),
        ("weights", [1, "x"], "weights[1] = 'x' must be a number"),
        ("weights", 1, "weights = 1 must be a list"),
        ("by_name", {"a b": "x"}, "by_name.\"a b\" = 'x' must be a number"),
        ("by_axis", {"up": 1}, "by_axis.up = 'up' must be one of 'n', 'e', 'NORTH', 'EAST'"),
        ("motion", 3, "motion = 3 must be a table: write it as [motion]"),
        ("motions", [3], "motions[0] = 3 must be a table: write it as [[motions]]"),
        ("single", 1e39, "single = 1e+39 must be a number from -3.4028"),
        ("small", 40_000, "small = 40000 must be a whole number from -32768 to 32767"),
        ("share", 1, "share = 1 must be a number of at least 0 and below 1"),
        ("code", 5, "code = 5 must be a code such as 'A1'"),
        ("numbr", 5, "has an unknown key 'numbr'; did you mean 'number'?"),
        ("made", 5, "has an unknown key 'made'"),
        ("anything", {"a": [math.nan]}, "anything.a[0] = nan must be a string, a finite number"),
    ],
)
def test_what_is_wrong_is_named(key: str, value: Any, sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(Everything, {"number": 1, key: value}, "the suite 'x'")
    assert _is_sentence(caught.value)
    assert sentence in str(caught.value)


def test_a_number_of_very_many_digits_is_shown_in_short() -> None:
    with pytest.raises(
        ConfigError, match=r"count = 0x1000000000000000\.\.\. must be a whole number"
    ):
        read(Everything, {"number": 1, "count": 1 << 20_000}, "x")


def test_a_section_is_named() -> None:
    for table, place in (
        ({"motion": {}}, "x, [motion] lacks the key 'speed_mps'; add it"),
        ({"motion": {"speed_mps": 0}}, "x, [motion]: speed_mps = 0 must be a number above 0"),
        ({"motions": [{"speed_mps": 1}, {}]}, "x, [[motions]] number 2 lacks the key 'speed_mps'"),
        ({"motion": {"speed_mps": 1, "axis": []}}, "'axis'; did you mean 'axes'?"),
    ):
        with pytest.raises(ConfigError) as caught:
            read(Everything, {"number": 1} | table, "x")
        assert place in str(caught.value)


@dataclass(frozen=True)
class Odd:
    """What a plugin should not annotate, beside what it may refuse."""

    level: float = 0.0
    signal: complex = 0j
    array: "np.ndarray[Any, Any] | None" = None
    ruled: Annotated[str, Ge(3)] = ""

    def __post_init__(self) -> None:
        if self.level < 0:
            raise ValueError("level must be at least 0")
        if self.level == 7:
            _ = 1 / (self.level - 7)


@pytest.mark.parametrize(
    ("key", "word", "sentence"),
    [
        ("signal", "1", "the parameter signal is of type complex, which neither TOML nor a text"),
        ("array", "[1]", "the parameter array is of type ndarray"),
        ("ruled", "x", "has the rule Ge(ge=3), which raises TypeError"),
        ("depth", "x", "has no parameter 'depth'; there are ['array', 'level', 'ruled', 'signal']"),
        ("level", "x", "parameter level = 'x' must be a number"),
        ("level", "-1", "refuses its parameters {'level': -1.0}: level must be at least 0"),
        ("level", "7", "refuses its parameters {'level': 7.0}: ZeroDivisionError: float division"),
    ],
)
def test_a_plugin_is_blamed_by_name(key: str, word: str, sentence: str) -> None:
    with pytest.raises(PluginError) as caught:
        read(Odd, {key: Text(word)}, "detector 'odd'", noun="parameter", error=PluginError)
    assert str(caught.value).startswith("detector 'odd'")
    assert sentence in str(caught.value)


def test_finished_instances_are_taken() -> None:
    array = np.ones(2)
    made = read(Odd, {"signal": 1j, "array": array, "level": np.float32(0.5)}, "x")
    assert made.array is array
    assert (made.signal, type(made.level)) == (1j, float)


def test_annotations_that_name_nothing_are_the_authors_fault() -> None:
    @dataclass(frozen=True)
    class Unresolved:
        level: "Missing" = 0  # type: ignore[name-defined]  # noqa: F821

    assert read(Unresolved, {}, "x").level == 0
    with pytest.raises(ConfigError, match="annotations of Unresolved cannot be resolved: NameErr"):
        read(Unresolved, {"level": 1}, "x")


def test_what_is_no_toml_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bytes.toml").write_bytes(b"\xff")
    for source, reason in (
        (tmp_path / "missing.toml", "the suite 'x' cannot be read: No such file"),
        (tmp_path, "the suite 'x' cannot be read: Is a directory"),
        (tmp_path / "bytes.toml", "the suite 'x' is not TOML: 'utf-8' codec"),
        ("a = \n", "the suite 'x' is not TOML: Invalid value"),
        ("a = " + "[" * 10_000, "the suite 'x' is not TOML"),
        ("a = " + "9" * 10_000, "the suite 'x' is not TOML"),
    ):
        with pytest.raises(SuiteError) as caught:
            read_toml(source, "the suite 'x'", SuiteError)
        assert str(caught.value).startswith(reason)
        assert "\n" not in str(caught.value)


def test_deep_tables_are_refused() -> None:
    with pytest.raises(ConfigError, match="nests its tables too deeply"):
        read(Everything, read_toml("anything" + ".a" * 900 + " = 1", "x") | {"number": 1}, "x")
