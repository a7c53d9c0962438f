"""Names of options in messages: in Python those of its arguments, on the command line those of its flags."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from warpqem.arguments.option_fields import named_options
from warpqem.errors import OptionError

__all__ = ["error_text", "flags_of", "flags_of_options", "with_flags"]

# Names of fields whose option has another name, or that stand for several options.
ALIASES = {
    "asset_roots": "asset_root",
    "attribute_weights": "attribute_weight",
    "error": "screen_error",
    "prims": "prim",
    "variants": "variant",
    "screen": "screen_error",
    "field_of_view": "fov",
}
# Where a name of several words may stand: it is no part of a path, of a primvar or of quoted text.
NAME = re.compile(r"(?<![\w./'\"`-])([a-z]+(?:_[a-z]+)+)(?![\w./'\"`=-])")
FIRST = re.compile(r"([a-z_]+)(?=[ :])")
MARKED = re.compile(r"`([a-z_]+)`")


def flags_of(group: Any, arguments: Sequence[str]) -> dict[str, str]:
    """The flags of the command that arguments name, by the names of its options in Python.

    Args:
        group: The group of all commands.
        arguments: Of the command line, from the command on.
    """
    command = group
    for name in arguments:
        if name not in getattr(command, "commands", {}):
            break
        command = command.commands[name]
    options = [parameter for parameter in command.params if parameter.param_type_name == "option"]
    flags = {str(option.name): max(option.opts, key=len) for option in options}
    return flags | {field: flags[name] for field, name in ALIASES.items() if name in flags}


def flags_of_options(options: type) -> dict[str, str]:
    """The flags of a dataclass of options, by the names of its fields and options."""
    flags = {name: f"--{name.replace('_', '-')}" for name in named_options(options)}
    return flags | {field: flags[name] for field, name in ALIASES.items() if name in flags}


def error_text(error: Exception, flags: Mapping[str, str]) -> str:
    """The message of an error in the words of the command line."""
    if not isinstance(error, OptionError):
        return with_flags(str(error), flags)
    marked = MARKED.sub(lambda found: flags.get(found[1], found[1]), error.marked)
    # A message about an option begins with its name.
    begun = FIRST.sub(lambda found: flags.get(found[1], found[1]), marked, count=1) if FIRST.match(marked) else marked
    return with_flags(begun, flags)


def with_flags(text: str, flags: Mapping[str, str]) -> str:
    """A message in which names of several words, such as ``max_error``, are flags."""
    return NAME.sub(lambda found: flags.get(found[1], found[1]), text)
