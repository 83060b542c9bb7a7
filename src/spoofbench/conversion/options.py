"""A converter's options from the texts of a command line."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from spoofbench.errors import ConversionError


def make_options(options_type: type[Any], texts: Mapping[str, str], converter: str) -> Any:
    """Return the options dataclass with each text read as its field's type.

    Raises:
        ConversionError: there is no such option, or a text does not fit it.
    """
    hints = get_type_hints(options_type)
    known = [field.name for field in fields(options_type)]
    values = {}
    for name, text in texts.items():
        if name not in known:
            raise ConversionError(
                f"the {converter} converter has no option {name!r}; it has {known or 'none'}"
            )
        try:
            values[name] = _read(text, hints[name])
        except ValueError:
            raise ConversionError(
                f"option {name!r} of the {converter} converter is {text!r}, but must be "
                f"{_named(hints[name])}"
            ) from None
    try:
        return options_type(**values)
    except Exception as error:  # a plugin may raise anything
        raise ConversionError(
            f"the {converter} converter refuses its options {dict(texts)!r}: {error}"
        ) from error


def _read(text: str, hint: Any) -> Any:
    if get_origin(hint) in (Union, UnionType):
        inner = [option for option in get_args(hint) if option is not NoneType]
        return None if text == "" else _read(text, inner[0])
    if get_origin(hint) is Literal:
        return _one_of(text, {str(choice): choice for choice in get_args(hint)})
    if hint is bool:
        return _one_of(
            text.lower(),
            {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False},
        )
    if hint in (str, int, float, Path):
        return hint(text)
    raise TypeError(f"an option cannot be of type {hint!r}")


def _one_of(text: str, choices: Mapping[str, Any]) -> Any:
    if text not in choices:
        raise ValueError(text)
    return choices[text]


def _named(hint: Any) -> str:
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(
            "empty" if option is NoneType else _named(option) for option in get_args(hint)
        )
    if get_origin(hint) is Literal:
        return f"one of {[str(choice) for choice in get_args(hint)]}"
    return {bool: "true or false", int: "a whole number", float: "a number"}.get(
        hint, str(getattr(hint, "__name__", hint))
    )
