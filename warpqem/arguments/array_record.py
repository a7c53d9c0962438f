"""Dataclasses that hold arrays: shown in one line, equal to themselves alone.

Arrays have no one answer to ``==``, and thousands of numbers on a screen are of no use. Such a class is declared with
``@dataclass(eq=False, repr=False)`` and has :class:`ArrayRecord` as its base.
"""

from __future__ import annotations

import dataclasses
from typing import Any

__all__ = ["ArrayRecord", "brief"]

# Characters that a value may take in the line of its record.
LONGEST_VALUE = 60


class ArrayRecord:
    """Base of dataclasses with arrays: ``repr`` is one line, with the dtype and the shape of each array."""

    def __repr__(self) -> str:
        shown = [entry.name for entry in dataclasses.fields(self) if entry.repr]  # type: ignore[arg-type]  # a dataclass
        return f"{type(self).__name__}({', '.join(f'{name}={brief(getattr(self, name))}' for name in shown)})"


def brief(value: Any) -> str:
    """A value in a few words: an array by dtype and shape, several of something by their number."""
    if hasattr(value, "shape") and hasattr(value, "dtype") and value.shape != ():
        return f"{getattr(value.dtype, 'name', None) or value.dtype.__name__} {tuple(value.shape)}"
    if isinstance(value, (list, tuple, dict)):
        text = "" if any(hasattr(item, "shape") for item in value) else repr(value)
        fits = 0 < len(text) <= LONGEST_VALUE and "\n" not in text
        return text if fits else f"{type(value).__name__} of {len(value)}"
    text = " ".join(repr(value).split())
    if len(text) <= LONGEST_VALUE or isinstance(value, ArrayRecord):
        return text
    return f"{text[: LONGEST_VALUE - 3]}..."
