"""Options of a simplification from names and values, as a command line, a table or JSON gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from enum import Enum
from typing import Any

from warpqem.errors import OptionError
from warpqem.screen import ScreenView
from warpqem.usd.frames import FrameRange
from warpqem.usd.option_checks import parse_attribute_weight, parse_lods
from warpqem.usd.simplify_options import SimplifyOptions

__all__ = ["GOALS", "OPTION_NAMES", "override_options", "read_options", "screen_view"]

# These say how far to simplify.
GOALS = ("ratio", "faces", "max_error", "max_distance", "screen_error", "lods")
# What only means something together with screen_error, and the name of its argument of `screen_view`.
VIEW = {"screen_error": "error", "distance": "distance", "fov": "field_of_view", "image_height": "image_height"}
TRUE, FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def screen_view(
    error: float | None, distance: float | None, field_of_view: float = 45.0, image_height: int = 1080
) -> ScreenView | None:
    """The options of a view as one; None where no error is asked for.

    Raises:
        OptionError: the distance is missing, or asks for an error that is.
    """
    if error is None:
        if distance is not None:
            raise OptionError("--distance needs --screen-error")
        return None
    if distance is None:
        raise OptionError("--screen-error needs --distance")
    return ScreenView(error, distance, field_of_view, image_height)


def read_options(values: Mapping[str, Any]) -> SimplifyOptions:
    """Options from values of the right type, or text that says the same.

    Args:
        values: Values by the names of `warpqem simplify --help` without their dashes in front, such as "max-error" or
            "max_error". None and an empty list stand for the default.

    Raises:
        OptionError: there is no such option, a value is none that it takes, or they exclude each other.
    """
    given = {_normal(name): _plain(value) for name, value in values.items()}
    given = {name: value for name, value in given.items() if value is not None and value != []}
    view = {VIEW[name]: _read(name, given.pop(name)) for name in VIEW if name in given}
    found = {_FIELD_NAMES.get(name, name): _read(name, value) for name, value in given.items()}
    screen = screen_view(view.pop("error", None), view.pop("distance", None), **view)
    return SimplifyOptions(screen=screen, **found)


def override_options(values: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Values in which others take precedence, but where they are None or empty text, as in an empty cell of a table.

    A goal among the others takes the place of any goal.
    """
    merged = {_normal(name): value for name, value in values.items()}
    others = {_normal(name): value for name, value in others.items() if value not in (None, "")}
    if any(name in GOALS for name in others):
        merged = {name: value for name, value in merged.items() if name not in (*GOALS, "distance")}
    return {**merged, **others}


def _normal(name: str) -> str:
    normal = name.strip().replace("-", "_")
    if normal not in OPTION_NAMES:
        raise OptionError(f"there is no option {name!r}; there are {', '.join(OPTION_NAMES)}")
    return normal


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value.strip() if isinstance(value, str) else value


def _read(name: str, value: Any) -> Any:
    try:
        return _READERS[name](value)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, OptionError):
            raise
        raise OptionError(f"{name} {value!r}: {error}") from None


def _boolean(value: Any) -> bool:
    if isinstance(value, bool):
        return value
    text = str(value).lower()
    if text not in TRUE + FALSE:
        raise ValueError("expected true or false")
    return text in TRUE


def _integer(value: Any) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise ValueError("expected a whole number")
    return int(value)


def _number(value: Any) -> float:
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return float(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError("expected text")
    return value


def _names(value: Any) -> list[str]:
    """A list, or text with blanks between the entries."""
    return value.split() if isinstance(value, str) else [_text(entry) for entry in value]


# Readers for the types of the fields of SimplifyOptions, as they are written there.
_BY_TYPE: dict[str, Callable[[Any], Any]] = {
    "bool": _boolean,
    "float": _number,
    "int": _integer,
    "str": _text,
    "float | str": lambda value: value if isinstance(value, str) else _number(value),
    "str | os.PathLike[str]": _text,
    "int | str": lambda value: value if isinstance(value, int) and not isinstance(value, bool) else _text(value),
}
_READERS: dict[str, Callable[[Any], Any]] = {
    "lods": lambda value: parse_lods(value if isinstance(value, str) else ",".join(map(str, value))),
    "attribute_weight": lambda value: tuple(parse_attribute_weight(text) for text in _names(value)),
    "frames": lambda value: FrameRange.parse(_text(value)),
    "prim": lambda value: tuple(_names(value)),
    "asset_root": lambda value: (value,) if isinstance(value, str) else tuple(_text(entry) for entry in value),
    "screen_error": _number,
    "distance": _number,
    "fov": _number,
    "image_height": _integer,
}
# Options that may be given several times are named in the singular.
_FIELD_NAMES = {"attribute_weight": "attribute_weights", "prim": "prims", "asset_root": "asset_roots"}
_READERS.update(
    {
        field.name: _BY_TYPE[str(field.type).removesuffix(" | None")]
        for field in fields(SimplifyOptions)
        if field.name not in (*_READERS, *_FIELD_NAMES.values(), "screen")
    }
)
OPTION_NAMES = tuple(sorted(_READERS))
