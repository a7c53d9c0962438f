"""What USD raises, as errors of warpqem."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager

from pxr import Tf, UsdUtils

from warpqem.errors import StageError, WarpqemError

__all__ = ["UsdMessages", "first_line", "usd_errors_named"]

# Where USD's parser stopped.
SYNTAX = re.compile(r"(.+?):(\d+):(\d+): (.*)", re.DOTALL)
# The rule of its grammar that did not fit, a C++ type.
GRAMMAR = re.compile(r"parse error matching \S.*?(?= at ')", re.DOTALL)
# USD quotes the rest of the line, which may be all of a mesh.
MAX_CHARACTERS = 300
# What USD adds to the errors of composition of a stage, with an address in memory.
STAGE = re.compile(r" \((?:instantiating|recomposing|changing load rules on) stage .*\)$")


class UsdMessages:
    """Keeps the warnings that USD would print on stderr, with the names of its functions and source files.

    It works from the moment it is made until it is no longer referred to.
    """

    def __init__(self) -> None:
        self._delegate = UsdUtils.CoalescingDiagnosticDelegate()

    def take(self) -> list[str]:
        """The warnings since the last call, each once and on one line."""
        texts: dict[str, None] = {}
        for diagnostic in self._delegate.TakeUncoalescedDiagnostics():
            try:
                lines = str(diagnostic.commentary).splitlines()
            except UnicodeDecodeError:
                continue  # a quote of what is no text
            for line in filter(None, map(str.strip, lines)):
                texts[_shortened(STAGE.sub("", line))] = None
        return list(texts)


def first_line(error: Exception, file: str | os.PathLike[str] = "") -> str:
    """What an exception says, on one line and without the place in USD's own code.

    Args:
        error: The exception.
        file: File that the caller names already, so that a syntax error in it is named by line and column alone.
    """
    # One exception may hold a million errors, whose text together takes seconds to put together. Of a syntax error the
    # first often says what is wrong, and the second where.
    errors = error.args[:2] if isinstance(error, Tf.ErrorException) and error.args else [error]
    try:
        lines = [_first_line(str(getattr(one, "commentary", one))) for one in errors]
    except UnicodeDecodeError:
        # USD quotes what it has read, which may be no text.
        return f"{type(error).__name__} with a message that is no text"
    if not lines[0]:
        return type(error).__name__
    places = [SYNTAX.fullmatch(line) for line in lines]
    found = next((place for place in places if place is not None), None)
    if found is None:
        return _shortened(lines[0])
    named, row, column, what = found.groups()
    if places[0] is None:
        what = lines[0]
    before = "" if os.path.realpath(named) == os.path.realpath(file) else f"{named}: "
    return _shortened(f"{before}line {row}, column {column}: {GRAMMAR.sub('syntax error', what)}")


def _first_line(text: str) -> str:
    return next((line.strip() for line in text.splitlines() if line.strip()), "")


def _shortened(text: str) -> str:
    return text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}..."


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
