"""Progress of a call, as its caller follows it: by a function, as a bar, and with a way to cancel it.

Public functions that take long have ``progress`` and ``cancel``; :func:`with_progress_bar` around them draws the bar of
``progress=True``, and :func:`listener` makes one function of both, which the work calls as it goes on.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, Protocol, TypeVar

from warpqem.arguments.number_input import shown
from warpqem.errors import CancelledError, OptionError
from warpqem.runtime.compiling import compile_listener

__all__ = ["CancelToken", "Progress", "ProgressInput", "listener", "share_of", "with_progress_bar"]

P = ParamSpec("P")
R = TypeVar("R")

Progress = Callable[[float, str], None]
# True for a bar, False as None for nothing.
ProgressInput = Progress | bool | None

# What the stages of simplifying are called in a bar.
STAGES = {"read": "reading frames", "order": "collapsing edges", "place": "placing vertices"}


class CancelToken(Protocol):
    """What ends a call from another thread: ``threading.Event``, or anything with its ``is_set``."""

    def is_set(self) -> bool:
        """Whether the call is to end."""
        ...


def listener(progress: ProgressInput, cancel: CancelToken | None = None) -> Progress | None:
    """One function to call as the work goes on; None where nobody listens.

    Raises:
        OptionError: ``progress`` cannot be called, or ``cancel`` has no ``is_set``. A bar is drawn by
            :func:`with_progress_bar`, so that True here is nothing to call.
    """
    if progress is False:
        progress = None
    if progress is not None and not callable(progress):
        raise OptionError(f"progress must be a function, True for a bar, or None, got {shown(progress)}")
    if cancel is None:
        return progress
    if not callable(getattr(cancel, "is_set", None)):
        raise OptionError(f"cancel must have is_set, as threading.Event has, got {shown(cancel)}")
    token, show = cancel, progress

    def listen(fraction: float, text: str) -> None:
        if token.is_set():
            raise CancelledError(f"cancelled at {100.0 * fraction:.0f} %, {STAGES.get(text, text)}")
        if show is not None:
            show(fraction, text)

    # Nothing is begun for a call that was cancelled before.
    if token.is_set():
        raise CancelledError("cancelled before it began")
    return listen


def share_of(progress: Progress | None, start: float, share: float) -> Progress | None:
    """The progress of a part that begins at ``start`` and is so much of the whole."""
    if progress is None:
        return None
    return lambda fraction, text: progress(start + share * fraction, text)


def with_progress_bar(function: Callable[P, R]) -> Callable[P, R]:
    """Draw a bar on stderr, or in a notebook, where the argument ``progress`` of a function is True."""
    place = list(inspect.signature(function).parameters).index("progress")

    @functools.wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        given = list(args)
        if kwargs.get("progress") is not True and not (len(given) > place and given[place] is True):
            return function(*args, **kwargs)
        with _bar() as show:
            if len(given) > place:
                given[place] = show
            else:
                kwargs["progress"] = show
            return function(*given, **kwargs)  # type: ignore[arg-type]  # the same arguments but for one

    return run


@contextmanager
def _bar() -> Iterator[Progress]:
    # Loaded for a bar alone.
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(file=sys.stderr)
    columns: list[Any] = [BarColumn(bar_width=20), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn()]
    columns.append(TextColumn("{task.description}", markup=False))
    visible = console.is_terminal or console.is_jupyter
    if not visible:
        # A log has no use for a bar.
        yield lambda fraction, text: None
        return
    with Progress(*columns, console=console, transient=True) as bar:
        task, shown = bar.add_task("starting", total=1.0), "starting"

        def show(fraction: float, text: str) -> None:
            nonlocal shown
            shown = STAGES.get(text, text)
            bar.update(task, completed=fraction, description=shown)

        def show_compiling(begins: bool) -> None:
            bar.update(task, description="compiling kernels" if begins else shown)

        with compile_listener(show_compiling):
            yield show
