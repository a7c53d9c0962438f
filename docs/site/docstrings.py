"""Docstrings as the site reads them: roles become links to public names, options have their defaults."""

from __future__ import annotations

import functools
import re
from typing import Any

import griffe

from docs.site.api_pages import MODULES, public_names

# :func:`warpqem.simplify`, :class:`MeshOptions`, ...
ROLE = re.compile(r":(?:mod|class|func|meth|data|attr|exc):`~?([\w.]+)`")
# ``code``
LITERAL = re.compile(r"``([^`]+)``")


class Docstrings(griffe.Extension):
    """Reads docstrings and defaults as Python would."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Put code in the docstring of a class, a function or an attribute as Markdown has it."""
        _to_markdown(obj)

    def on_module(self, *, mod: Any, **_: Any) -> None:
        """Likewise of a module."""
        _to_markdown(mod)

    def on_attribute_instance(self, *, attr: Any, **_: Any) -> None:
        """Show the default of an option in place of all that it says."""
        value = attr.value
        if isinstance(value, griffe.ExprCall) and str(value.function) == "option" and value.arguments:
            attr.value = value.arguments[0]


def _to_markdown(obj: Any) -> None:
    if obj.docstring is not None:
        obj.docstring.value = LITERAL.sub(r"`\1`", ROLE.sub(_link, obj.docstring.value))


def _link(role: re.Match[str]) -> str:
    """A link to what a role names, or the name alone where it is not public."""
    full = _public().get(role[1])
    return f"`{role[1]}`" if full is None else f"[`{role[1]}`][{full}]"


@functools.cache
def _public() -> dict[str, str]:
    """Public names as docstrings write them, with those of the reference: in full, or the last part alone."""
    known: dict[str, str] = {}
    # The first module that has a name is meant by the name alone.
    for module in MODULES:
        for name in public_names(module):
            known[f"{module}.{name}"] = f"{module}.{name}"
            known.setdefault(name, f"{module}.{name}")
    return known
