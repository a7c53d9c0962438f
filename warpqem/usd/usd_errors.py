"""What USD raises, as errors of warpqem."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from pxr import Tf

from warpqem.errors import StageError, WarpqemError

__all__ = ["first_line", "usd_errors_named"]


def first_line(error: Exception) -> str:
    """The first line of an exception's text that says something; USD errors carry a C++ stack after it."""
    # One exception may hold a million errors, whose text together takes seconds to put together.
    first = error.args[0] if isinstance(error, Tf.ErrorException) and error.args else error
    try:
        text = str(first)
    except UnicodeDecodeError:
        # USD quotes what it has read, which may be no text.
        return f"{type(error).__name__} with a message that is no text"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if not lines:
        return type(error).__name__
    # Tf.ErrorException: Error in '<C++ function>' at line <n> in file <path> : '<what is wrong>'
    found = re.fullmatch(r"Error in .* : '(.*)'", lines[0])
    return found.group(1) if found else lines[0]


@contextmanager
def usd_errors_named(what: object, reading: bool = False) -> Iterator[None]:
    """Turn what USD raises while damaged values are read or written into a StageError that names something.

    Args:
        what: What is at work, such as a prim path.
        reading: Values are only being read, so that a type or value that does not fit is the file's.

    Raises:
        StageError: USD has raised something.
    """
    expected = (Tf.ErrorException, UnicodeDecodeError, *((TypeError, ValueError) if reading else ()))
    try:
        yield
    except WarpqemError:
        raise
    except expected as error:
        raise StageError(f"{what}: USD fails on a value of it ({first_line(error)})") from error
