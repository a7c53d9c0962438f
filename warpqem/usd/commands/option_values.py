"""Options of a simplification from names and values, as a command line, a table or JSON gives them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeVar, overload

from warpqem.arguments.number_text import parse_number, parse_whole
from warpqem.arguments.option_fields import OptionField, named_options, option_fields
from warpqem.errors import OptionError
from warpqem.usd.commands.option_conflicts import GOALS
from warpqem.usd.commands.simplify_options import SimplifyOptions

__all__ = ["override_options", "read_options"]

Options = TypeVar("Options")
TRUE, FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


@overload
def read_options(values: Mapping[str, Any]) -> SimplifyOptions: ...


@overload
def read_options(values: Mapping[str, Any], options: type[Options]) -> Options: ...


def read_options(values: Mapping[str, Any], options: type[Any] = SimplifyOptions) -> Any:
    """Options from values of the right type, or text that says the same.

    Args:
        values: Values by the names of the command line without their dashes in front, such as "max-error" or
            "max_error". None and an empty list stand for the default.
        options: The dataclass to make.

    Raises:
        OptionError: there is no such option, a value is none that it takes, or they exclude each other.
    """
    given = {_normal(name, options): _plain(value) for name, value in values.items()}
    return _make(options, {name: value for name, value in given.items() if value is not None and value != []})


def override_options(values: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Values in which others take precedence, but where they are None or empty text, as in an empty cell of a table.

    A goal among the others takes the place of any goal.
    """
    merged = {_normal(name, SimplifyOptions): value for name, value in values.items()}
    others = {_normal(name, SimplifyOptions): value for name, value in others.items() if value not in (None, "")}
    goals = {name for goal in GOALS for name in _names_of(option_fields(SimplifyOptions)[goal])}
    if goals & others.keys():
        merged = {name: value for name, value in merged.items() if name not in goals}
    return {**merged, **others}


def _names_of(entry: OptionField) -> list[str]:
    return list(named_options(entry.kind)) if entry.has_parts else [entry.name]


def _normal(name: str, options: type) -> str:
    normal, names = name.strip().replace("-", "_"), named_options(options)
    if normal not in names:
        raise OptionError(f"there is no option {name!r}; there are {', '.join(sorted(names))}")
    return normal


def _plain(value: Any) -> Any:
    return value.strip() if isinstance(value, str) else value


def _make(options: type[Options], given: Mapping[str, Any]) -> Options:
    found: dict[str, Any] = {}
    entries = option_fields(options)
    for field, entry in entries.items():
        if entry.has_parts:
            part = _make_part(entry.kind, given)
            found |= {} if part is None else {field: part}
        elif entry.name in given:
            found[field] = _read(entry, given[entry.name], entries)
    return options(**found)


def _make_part(options: type[Options], given: Mapping[str, Any]) -> Options | None:
    """An option that is made of options; None where none of those is given that it needs, nor another but defaults."""
    entries = option_fields(options)
    needed = [entry.name for entry in entries.values() if not entry.has_default]
    missing = [name for name in needed if name not in given]
    if missing == needed:
        return None
    if missing:
        here = next(name for name in needed if name in given)
        raise OptionError(f"`{here}` needs `{missing[0]}`")
    return _make(options, given)


def _read(entry: OptionField, value: Any, names: Collection[str]) -> Any:
    if entry.kind in _NUMBERS and entry.option.parse is None:
        try:
            return _NUMBERS[entry.kind](value)
        except (TypeError, ValueError, OverflowError):
            hint = entry.hint(value, names)
            raise OptionError(f"`{entry.name}` must be {entry.expected}, got {value!r}{hint}") from None
    try:
        return (entry.option.parse or _READERS.get(entry.kind, _text))(value)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, OptionError):
            raise
        raise OptionError(f"`{entry.name}` {value!r}: {error}") from None


def _boolean(value: Any) -> bool:
    if isinstance(value, bool):
        return value
    text = str(value).lower()
    if text not in TRUE + FALSE:
        raise ValueError("expected true or false")
    return text in TRUE


def _integer(value: Any) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise ValueError
    return parse_whole(value) if isinstance(value, str) else int(value)


def _number(value: Any) -> float:
    if isinstance(value, bool):
        raise ValueError
    if not isinstance(value, str):
        return float(value)
    # Messages show a number as it was written.
    return parse_whole(value) if value.lstrip("-").isdecimal() else parse_number(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("expected text")
    return value


def _bytes(value: Any) -> int | str:
    return value if isinstance(value, int) and not isinstance(value, bool) else _text(value)


# Readers of other types than text and names.
_READERS: dict[Any, Callable[[Any], Any]] = {bool: _boolean, int | str: _bytes}
_NUMBERS: dict[Any, Callable[[Any], Any]] = {float: _number, int: _integer}
