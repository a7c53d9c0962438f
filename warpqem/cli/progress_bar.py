"""The progress of a command on stderr: what is being done, how far it is, and the time that is left."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column

from warpqem.cli import messages
from warpqem.printable import printable
from warpqem.runtime.compiling import compile_listener

__all__ = ["QuietProgress", "bar_columns", "progress_bar"]

_log = logging.getLogger(__name__)

# Characters of the bar: at 80 columns the text beside it has room for a mesh, its step, faces and frames.
BAR_WIDTH = 12
COMPILING = "compiling the kernels, which takes a minute or two the first time on a device"


class QuietProgress(Progress):
    """A progress display that writes nothing where it is disabled; before rich 14.3 its end is an empty line."""

    def stop(self) -> None:
        """Stop the display, if there is one."""
        if not self.disable:
            super().stop()


def bar_columns() -> list[ProgressColumn]:
    """Bar, percentage, time gone and left, and text, which is cut where a line is too short for it."""
    text = TextColumn(
        "{task.description}", markup=False, table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")
    )
    return [BarColumn(bar_width=BAR_WIDTH), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn(), text]


@contextmanager
def progress_bar(first_text: str) -> Iterator[Callable[[float, str], None]]:
    """Show a progress bar on stderr; nothing if stderr is not a terminal.

    Kernels that are compiled meanwhile are shown, too; without a terminal by a note.

    Yields:
        A function that takes the fraction done and what is being done.
    """
    console = Console(stderr=True)
    is_hidden = not console.is_terminal or messages.quiet
    with QuietProgress(*bar_columns(), console=console, transient=True, expand=True, disable=is_hidden) as progress:
        task = progress.add_task(first_text, total=1.0)
        shown, modules = first_text, 0

        def show(fraction: float, text: str) -> None:
            nonlocal shown
            if text != shown:
                _log.debug("%s", text)
            shown = printable(text)
            progress.update(task, completed=fraction, description=shown)

        def show_compiling(begins: bool) -> None:
            nonlocal modules
            modules += begins
            if is_hidden and modules == 1 and begins:
                messages.print_message("note", COMPILING)
            progress.update(task, description=f"compiling kernels ({modules}), {shown}" if begins else shown)

        def show_count(done: int, total: int) -> None:
            progress.update(task, description=f"compiling kernels ({done} of {total}), {shown}")

        with compile_listener(show_compiling, show_count):
            yield show
