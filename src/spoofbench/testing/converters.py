"""What every converter must keep, as checks that name the law that is broken.

Three lines hold a converter to its contract::

    from spoofbench.testing import check_converter

    @check_converter("my-converter", [Path(__file__).with_name("sample.log")])
    def test_conformance(check): check()

Good samples are logs of a minute or more whose times are told early. What the laws on cuts and
damage say leaves out
the last seconds before them (:data:`spoofbench.testing.damage.HELD_S`): so long may a
converter hold rows to put them in order, to join what belongs together and to know what follows.
"""

import dataclasses
import hashlib
import inspect
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from spoofbench.conversion import Converter
from spoofbench.schema import split_topic
from spoofbench.table import Table
from spoofbench.testing.converter_cases import (
    ConverterOutcome,
    ConverterUnderTest,
    TrickledSource,
    differing,
)
from spoofbench.testing.damage import (
    FOREIGN_FILES,
    beginnings,
    copy_log,
    damaged_logs,
    keeps_memory_bounded,
    keeps_what_stands_around_damage,
    keeps_what_stands_before_a_cut,
    raises_only_its_errors,
    scratch,
    survives_garbage,
)
from spoofbench.testing.isolation import convert_alone
from spoofbench.testing.kit import Check, CheckResult, parametrised, require

if TYPE_CHECKING:
    import pytest

_RANGES = {
    "lat_deg": (-90.0, 90.0),
    "lon_deg": (-180.0, 360.0),
    "course_deg": (-360.0, 360.0),
    "elevation_deg": (-90.0, 90.0),
}
_NOT_NEGATIVE = (
    "_acc_m",
    "_acc_mps",
    "_std_m",
    "_std_cycles",
    "dop",
    "tow_s",
    "cov_nn_m2",
    "cov_ee_m2",
    "cov_dd_m2",
)


def check_converter(
    converter: str | Converter, samples: Sequence[Path], /, *, streamed: bool = True, **options: Any
) -> "pytest.MarkDecorator":
    """Parametrise a test's argument ``check`` with all checks of a converter.

    Args:
        converter: name of an entry point of ``spoofbench.converters``, or a module or object that
            is a converter.
        samples: logs of its format: files, folders or archives.
        streamed: the format is read from front to back, so that damage costs only what it touches.
            False for databases, archives and whatever is found through an index: damaged logs must
            then give rows, or one error.
        options: of its ``Options``.
    """
    return parametrised(
        LAWS, ConverterUnderTest(converter, tuple(samples), MappingProxyType(options), streamed)
    )


def run_converter_checks(
    converter: str | Converter,
    samples: Sequence[Path],
    options: Mapping[str, Any] = MappingProxyType({}),
    *,
    streamed: bool = True,
) -> list[CheckResult]:
    """Run all checks of a converter and return what each said.

    Raises:
        PluginError: there is no such converter, or it cannot be loaded.
    """
    subject = ConverterUnderTest(converter, tuple(samples), options, streamed)
    _ = subject.converter
    return [Check(law, subject).result() for law in LAWS]


def declares_itself(subject: ConverterUnderTest) -> None:
    """VERSION is a text, UNIT what the ledger counts, Options a frozen dataclass whose fields all
    have defaults.
    """
    converter: Any = subject.converter
    for name in ("VERSION", "UNIT", "Options", "sniff", "convert"):
        require(hasattr(converter, name), f"the converter has no {name}")
    require(
        isinstance(converter.VERSION, str) and bool(converter.VERSION),
        f"VERSION must be a text, not {converter.VERSION!r}",
    )
    require(
        converter.UNIT in ("bytes", "records"),
        f"UNIT must be 'bytes' or 'records', not {converter.UNIT!r}",
    )
    options = converter.Options
    require(
        isinstance(options, type) and dataclasses.is_dataclass(options),
        f"Options must be a dataclass, not {options!r}",
    )
    require(
        vars(options)["__dataclass_params__"].frozen,
        "Options is not frozen: write @dataclass(frozen=True)",
    )
    for field in dataclasses.fields(options):
        default = (
            field.default is not dataclasses.MISSING
            or field.default_factory is not dataclasses.MISSING
        )
        require(default, f"option {field.name!r} has no default")
    loose = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    for parameter in inspect.signature(options).parameters.values():
        require(
            parameter.kind not in loose, f"option {parameter} has no name: options must be fields"
        )


def recognises_by_content(subject: ConverterUnderTest) -> None:
    """A sample is recognised under any name; other logs under its name, and damaged ones, never
    raise.
    """
    for path in subject.samples:
        score = subject.sniff(path)
        require(score > 0 or bool(subject.options), f"sniff() does not recognise {path.name!r}")
        with scratch() as folder:
            for name in ("renamed", "renamed.mp3"):
                renamed = copy_log(path, folder / name)
                require(
                    subject.sniff(renamed) == score,
                    f"sniff() of {path.name!r} answers otherwise where it is called {name!r}",
                )
            for number, foreign in enumerate(FOREIGN_FILES):
                other = folder / str(number) / path.name
                other.parent.mkdir()
                other.write_bytes(foreign)
                answer = subject.sniff(other)
                what = f"{len(foreign):,} bytes that begin with {foreign[:20]!r}"
                require(
                    answer == 0,
                    f"sniff() claims {what} as {answer} where it is called {path.name!r}",
                )
            empty = folder / f"folder of {path.name}"
            empty.mkdir()
            require(subject.sniff(empty) == 0, "sniff() claims an empty folder")
            for piece in beginnings(path):
                other = folder / "cut"
                other.write_bytes(piece)
                subject.sniff(other)


def converts(subject: ConverterUnderTest) -> None:
    """Each sample gives rows, without an error."""
    for path, whole in subject.wholes.items():
        require(whole.error is None, f"{path.name!r} is refused: {whole.error}")
        require(whole.rows > 0, f"{path.name!r} gives no rows")


def gives_rows_in_order(subject: ConverterUnderTest) -> None:
    """The rows of a topic never run backwards in time, over all blocks; times are of the Unix
    era.
    """
    for path, whole in subject.wholes.items():
        for topic, table in whole.tables.items():
            require(
                int(table.time_ns[0]) > 0,
                f"{topic} of {path.name!r} begins at time {int(table.time_ns[0])}",
            )


def says_what_can_be(subject: ConverterUnderTest) -> None:
    """Values of undamaged samples are finite or absent, within the range of their quantity; facts
    are text.
    """
    for path, whole in subject.wholes.items():
        for topic, table in whole.tables.items():
            for name in table:
                reason = _impossible(table, name)
                require(reason is None, f"{name} of {topic} of {path.name!r} {reason}")
        for name, record in whole.facts.items():
            texts = isinstance(name, str) and all(
                isinstance(text, str) for pair in record.items() for text in pair
            )
            require(
                texts,
                f"metadata {name!r} of {path.name!r} must be text by text, not {dict(record)!r}",
            )
        for topic in whole.tables:
            source = f"source/{split_topic(topic)[0] or 'reference'}"
            require(
                bool(whole.facts.get(source)),
                f"nothing says what {topic} of {path.name!r} is: yield metadata of {source!r}",
            )


def _impossible(table: Table, name: str) -> str | None:
    values = table[name][table.valid(name)]
    if values.dtype.kind == "f" and values.size:
        if np.isinf(values).any():
            return "is infinite"
        low, high = _RANGES.get(name, (0.0 if name.endswith(_NOT_NEGATIVE) else -np.inf, np.inf))
        if values.min() < low or values.max() > high:
            return f"is {values.min():g} to {values.max():g}, beyond {low:g} to {high:g}"
    field = table.kind.fields[name]
    if field.category == "enum":
        known = {value.number for value in table.kind.message.fields_by_name[name].enum_type.values}
        strange = set(values.tolist()) - known
        return f"has the unknown number {min(strange)}" if strange else None
    return None


def accounts_for_every_unit(subject: ConverterUnderTest) -> None:
    """Used and skipped make up the unpacked log, whole or damaged; rejects lie within it and do not
    overlap.
    """
    for path, whole in subject.wholes.items():
        _require_account(subject, whole, path.name)
        if path.is_file() and subject.converter.UNIT == "bytes":
            for what, log in damaged_logs(path):
                _require_account(
                    subject, subject.convert_bytes(path.name, log), f"{path.name}, {what}"
                )


def _require_account(subject: ConverterUnderTest, found: ConverterOutcome, what: str) -> None:
    if found.error is not None:
        return
    for offset, length, reason in found.rejects:
        require(
            isinstance(reason, str) and bool(reason),
            f"on {what}, the reject at {offset} has no reason",
        )
        require(
            offset >= 0 and length >= 0,
            f"on {what}, a reject has offset {offset} and length {length}",
        )
    if subject.converter.UNIT == "records" or found.size is None:
        return
    total = found.used + found.skipped
    require(
        total == found.size,
        (
            f"on {what}, {found.used} bytes used and {found.skipped} skipped make {total}, not "
            f"{found.size}"
        ),
    )
    end = 0
    for offset, length, reason in found.rejects:
        require(
            offset + length <= found.size,
            f"on {what}, the reject of {length} at {offset} ({reason}) lies beyond {found.size}",
        )
        require(
            length == 0 or offset >= end,
            (
                f"on {what}, the reject of {length} at {offset} ({reason}) overlaps one that ends "
                f"at {end}"
            ),
        )
        end = max(end, offset + length)


def is_deterministic(subject: ConverterUnderTest) -> None:
    """Converting again gives the same, also after other logs."""
    for path, whole in reversed(list(subject.wholes.items())):
        other = differing(subject.convert(path).digests, whole.digests)
        require(not other, f"{other} of {path.name!r} are others the second time")


def depends_on_content_alone(subject: ConverterUnderTest) -> None:
    """Under another name, in another folder, time zone, locale and hash seed it gives the same, and
    leaves no file behind.
    """
    with scratch() as folder:
        renamed = [
            copy_log(path, folder / f"{number}" / "x")
            for number, path in enumerate(subject.samples)
        ]
        for (path, whole), alone in zip(
            subject.wholes.items(),
            convert_alone(subject.given, renamed, subject.options),
            strict=True,
        ):
            other = differing(alone.digests, whole.digests)
            require(
                not other,
                f"{other} of {path.name!r} are others under another name, in another place",
            )
            require(not alone.left, f"on {path.name!r}, convert() leaves files: {alone.left}")


def reads_in_any_pieces(subject: ConverterUnderTest) -> None:
    """A stream that gives fewer bytes than it is asked for gives the same rows; so rows do not
    depend on where pieces end.
    """
    for path, whole in subject.wholes.items() if subject.streamed else ():
        other = differing(subject.convert(path, TrickledSource).digests, whole.digests)
        require(not other, f"{other} of {path.name!r} are others in smaller pieces")


def leaves_log_and_process(subject: ConverterUnderTest) -> None:
    """The log, its folder, the working folder, the environment and the time zone stay as they
    are.
    """
    for path in subject.samples:
        with scratch() as folder:
            copied = copy_log(path, folder / path.name)
            before = _state(folder)
            subject.sniff(copied)
            subject.convert(copied)
            for what, value in _state(folder).items():
                require(
                    value == before[what], f"on {path.name!r}, sniff() or convert() changes {what}"
                )


def _state(folder: Path) -> dict[str, Any]:
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
    digests = {
        name: hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for name, path in files.items()
    }
    about = {
        "the working folder": Path.cwd(),
        "the environment": dict(os.environ),
        "the time zone": time.tzname,
    }
    return {"the log or its folder": digests, "numpy's error state": np.geterr(), **about}


LAWS: tuple[Callable[[ConverterUnderTest], None], ...] = (
    declares_itself,
    recognises_by_content,
    converts,
    gives_rows_in_order,
    says_what_can_be,
    accounts_for_every_unit,
    is_deterministic,
    depends_on_content_alone,
    reads_in_any_pieces,
    leaves_log_and_process,
    keeps_what_stands_before_a_cut,
    keeps_what_stands_around_damage,
    survives_garbage,
    raises_only_its_errors,
    keeps_memory_bounded,
)
