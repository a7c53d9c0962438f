"""Options as fields of dataclasses that say their range, their unit and what they do.

A field made by :func:`option` is an option; command line, manifests and checks are derived from it, so that a new
option is written once, in the dataclass.
"""

from __future__ import annotations

import functools
import sys
import types
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from typing import Any, Literal, Union

from warpqem.arguments.limits import Limits
from warpqem.arguments.number_hints import number_hint

__all__ = ["Option", "OptionField", "Panel", "check_options", "named_options", "option", "option_fields"]

KEY = "warpqem option"

# Heads of the help, in its order.
Panel = Literal["Input", "Goal", "Quality", "What to keep", "Skin and shapes", "Levels", "Output", "Machine"]


@dataclass(frozen=True)
class Option:
    """What an option says of itself.

    Attributes:
        help: what it does, in full sentences.
        unit: what a value counts, as the command line shows it, such as "PCT"; None for flags and names.
        limits: the numbers that it takes; None for what is no number.
        brief: what ``--help`` says of it; None for the first clause of ``help``, which ``--help-all`` has in full.
        name: on the command line and in manifests, with underscores; None for that of the field. Options that may be
            given several times are named in the singular there.
        basic: ``--help`` shows it; the others are experts', for ``--help-all``.
        choices: a function that gives the names that it takes, where these are known at run time only.
        parse: makes a value from text, or from a list that says the same; None for numbers, flags and names.
        repeated: the command line takes it several times.
        panel: under which head the help shows it.
    """

    help: str
    unit: str | None = None
    limits: Limits | None = None
    brief: str | None = None
    name: str | None = None
    basic: bool = False
    choices: Callable[[], tuple[str, ...]] | None = None
    parse: Callable[[Any], Any] | None = None
    repeated: bool = False
    panel: Panel | None = None


@dataclass(frozen=True)
class OptionField:
    """An option of a dataclass.

    Attributes:
        field: name of the field.
        name: name on the command line and in manifests.
        kind: the type of its values, without None.
        optional: whether None is one too.
        default: the default of the field.
        option: what it says of itself.
    """

    field: str
    name: str
    kind: Any
    optional: bool
    default: Any
    option: Option

    @property
    def has_default(self) -> bool:
        """Whether it may be left out."""
        return self.default is not MISSING

    @property
    def has_parts(self) -> bool:
        """Whether its values are made of options themselves."""
        return is_dataclass(self.kind) and bool(option_fields(self.kind))  # type: ignore[arg-type]  # a dataclass is a type

    @property
    def expected(self) -> str:
        """What a message says that a number must be."""
        limits = self.option.limits
        if self.kind is int:
            return "a whole number" if limits is None else f"a whole number {limits}"
        return "a number" if limits is None else limits.expected

    def hint(self, value: Any, names: Collection[str]) -> str:
        """What such a message says at its end, see :func:`warpqem.arguments.number_hints.number_hint`.

        Args:
            value: what was given.
            names: of all options that may be given beside it.
        """
        return number_hint(self.field, value, self.option.limits, self.option.unit, self.kind is int, names)

    @property
    def literals(self) -> tuple[str, ...]:
        """The names that it takes, known at once; empty for what is no name."""
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is Literal else ()


def option(default: Any, help: str, unit: str | None = None, limits: Limits | None = None, **more: Any) -> Any:
    """A field of a dataclass that is an option, see :class:`Option`."""
    return field(default=default, metadata={KEY: Option(help, unit, limits, **more)})


def option_fields(options: type) -> Mapping[str, OptionField]:
    """The options of a dataclass by the names of its fields, in order."""
    return _option_fields(options)


@functools.cache
def _option_fields(options: type) -> Mapping[str, OptionField]:
    hints: dict[str, Any] = {}
    for base in reversed(options.__mro__):
        # Fields that are no options may have types that are loaded for type checkers only.
        own = {entry.name for entry in fields(options) if KEY in entry.metadata} & vars(base).get(
            "__annotations__", {}
        ).keys()
        if own:
            names = vars(sys.modules[base.__module__])
            hints |= {name: eval(base.__annotations__[name], names) for name in own}
    return {entry.name: _option_field(entry, hints[entry.name]) for entry in fields(options) if KEY in entry.metadata}


def _option_field(entry: Field[Any], kind: Any) -> OptionField:
    said: Option = entry.metadata[KEY]
    parts = typing.get_args(kind) if typing.get_origin(kind) in (Union, types.UnionType) else (kind,)
    others = tuple(part for part in parts if part is not type(None))
    kept = others[0] if len(others) == 1 else Union[others]  # noqa: UP007
    return OptionField(entry.name, said.name or entry.name, kept, len(others) < len(parts), entry.default, said)


def named_options(options: type) -> dict[str, OptionField]:
    """The options of a dataclass by their names on the command line and in manifests.

    An option that is itself a dataclass of options stands for these.
    """
    named: dict[str, OptionField] = {}
    for entry in option_fields(options).values():
        named |= named_options(entry.kind) if entry.has_parts else {entry.name: entry}
    return named


def check_options(options: Any) -> dict[str, Any]:
    """The options of a dataclass as Python's own numbers, flags and names.

    Returns:
        The values by the names of the fields; those of other types, such as paths, as they are.

    Raises:
        OptionError: one is of the wrong type or outside its range.
    """
    entries, given = option_fields(type(options)), vars(options)
    # Most are as they are by default, which every mesh of a stage would have checked anew.
    return {
        name: given[name] if given[name] is entry.default else _checked(entry, given[name], entries)
        for name, entry in entries.items()
    }


def _checked(entry: OptionField, value: Any, names: Collection[str]) -> Any:
    # NumPy is behind these; the help of the command line does without.
    from warpqem.arguments.number_input import flag, real_number, shown, whole_number
    from warpqem.errors import OptionError

    limits = entry.option.limits
    if value is None and entry.optional:
        return None
    if entry.kind is bool:
        return flag(value, entry.field)
    if entry.kind in (int, float) and limits is not None:
        try:
            if entry.kind is float:
                return real_number(value, entry.field, entry.expected, limits.__contains__)
            number = whole_number(value, entry.field, int(limits.low), entry.expected)
            if number > limits.high:
                raise OptionError(f"{entry.field} must be {entry.expected}, got {shown(value)}")
            return number
        except OptionError as error:
            raise OptionError(f"{error.marked}{entry.hint(value, names)}") from None
    if entry.literals and (not isinstance(value, str) or value not in entry.literals):
        raise OptionError(f"{entry.field} must be {' or '.join(map(repr, entry.literals))}, got {shown(value)}")
    return value
