"""Docstrings as the site reads them: roles become code, options have their defaults."""

from __future__ import annotations

import re
from typing import Any

import griffe

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
        obj.docstring.value = LITERAL.sub(r"`\1`", ROLE.sub(r"`\1`", obj.docstring.value))
