"""Tables of plain text: figures that stay readable on a terminal, and paths without their beginning."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from warpqem.arguments.figures import rounded_up
from warpqem.cli import messages
from warpqem.printable import printable

__all__ = ["WIDEST", "PlainTable", "error_text", "print_table", "shortened_path", "terminal_width", "upper_text"]

# Where output goes to a file or a pipe, lines may be as long as a table needs, within reason.
WIDEST = 1000
# Characters of a path that are left at least: a name of most meshes.
MIN_PATH = 16


@dataclass(frozen=True)
class _Column:
    """A column of a table.

    Attributes:
        head: its name.
        right: whether its cells stand on the right, as figures do.
        is_path: whether its cells may lose their beginning.
        wraps: whether its cells may take several lines.
        rank: where a terminal has no room for all columns, those of the highest rank are left out first; 0 stays.
    """

    head: str
    right: bool
    is_path: bool
    wraps: bool
    rank: int


class PlainTable:
    """A table whose title and cells are shown as they are: no markup, and nothing that drives a terminal."""

    def __init__(self, title: str) -> None:
        self.title = printable(title)
        self._columns: list[_Column] = []
        self._rows: list[tuple[list[str], bool]] = []
        self._notes: list[str] = []

    def add_column(
        self, head: str, justify: str = "left", *, is_path: bool = False, wraps: bool = False, rank: int = 0
    ) -> None:
        """Add a column, before the rows.

        Args:
            head: Its name.
            justify: "right" for figures.
            is_path: Its cells may lose their beginning.
            wraps: Its cells may take several lines.
            rank: Where a terminal has no room for all columns, those of the highest rank go first; 0 stays.
        """
        self._columns.append(_Column(head, justify == "right", is_path, wraps, rank))

    def add_row(self, *cells: str | int | None, end_section: bool = False) -> None:
        """Add a row of plain text and counts; missing cells are empty, and a section ends with a line."""
        row = ["" if cell is None else f"{cell:,}" if isinstance(cell, int) else printable(cell) for cell in cells]
        self._rows.append((row + [""] * (len(self._columns) - len(row)), end_section))

    def add_note(self, text: str) -> None:
        """Add a line below the table."""
        self._notes.append(printable(text))

    def rendered(self, width: int = WIDEST) -> Table:
        """The table for lines of so many characters.

        Figures are whole: where there is no room for all, paths lose their beginning, and then columns are left out,
        with a note that names them.
        """
        kept = self._fitting(width)
        left_out = [column.head for at, column in enumerate(self._columns) if at not in kept]
        notes = [*self._notes, *([f"no room for {', '.join(left_out)}: see --json"] if left_out else [])]
        # Without lines between columns figures have room at 80 characters, and without edges at 25 lines.
        table = Table(title=Text(self.title), box=SIMPLE_HEAD, padding=(0, 0), show_edge=False, caption_justify="left")
        table.caption = Text("\n".join(notes)) if notes else None
        widths = self._widths(kept, width)
        for at in kept:
            column = self._columns[at]
            table.add_column(Text(column.head), justify="right" if column.right else "left", width=widths[at])
        for row, end_section in self._rows:
            cells = [shortened_path(row[at], widths[at]) if self._columns[at].is_path else row[at] for at in kept]
            table.add_row(*map(Text, cells), end_section=end_section)
        return table

    def _widths(self, kept: Sequence[int], width: int) -> dict[int, int]:
        """Characters of each column: what it needs, and of what is left over as much as it can use, paths first."""
        widths = {at: self._least(at) for at in kept}
        spare = width - _line_length(widths.values())
        first = sorted(kept, key=lambda at: (not self._columns[at].is_path, not self._columns[at].wraps))
        for number, at in enumerate(first):
            longest = max([len(self._columns[at].head), *(len(row[at]) for row, _ in self._rows)])
            # What several paths could use, they share.
            others = sum(self._columns[other].is_path for other in first[number + 1 :])
            more = max(0, min(longest - widths[at], spare // (others + 1)))
            widths[at], spare = widths[at] + more, spare - more
        return widths

    def _fitting(self, width: int) -> list[int]:
        """The columns that have room."""
        kept = list(range(len(self._columns)))
        droppable = sorted((at for at in kept if self._columns[at].rank), key=lambda at: -self._columns[at].rank)
        for at in droppable:
            if _line_length(map(self._least, kept)) <= width:
                break
            kept.remove(at)
        return kept

    def _least(self, at: int) -> int:
        """Characters that a column needs."""
        column, cells = self._columns[at], [row[at] for row, _ in self._rows]
        if column.wraps:
            cells = [word for cell in cells for word in cell.split()]
        longest = max(map(len, cells), default=0)
        return max([min(longest, MIN_PATH) if column.is_path else longest, *map(len, column.head.split())])


def _line_length(widths: Iterable[int]) -> int:
    """Characters of a line of columns, with a blank between them."""
    widths = list(widths)
    return sum(widths) + len(widths) - 1


def shortened_path(path: str, width: int) -> str:
    """A path without its beginning, where it is longer than so many characters."""
    if len(path) <= width:
        return path
    end = path[-(width - 3) :]
    # Whole names, unless the last one alone is too long.
    cut = end.find("/")
    return f"...{end[cut:] if 0 <= cut < len(end) - 1 else end}"


def error_text(value: float | None) -> str:
    """A measured figure as every table shows it; empty for none."""
    return "" if value is None else f"{value:.4g}"


def upper_text(value: float | None) -> str:
    """A figure that nothing is above, rounded up: as long as `error_text`, and as true."""
    return "" if value is None else rounded_up(value)


def terminal_width(to_stderr: bool = False) -> int:
    """Characters of a line on a terminal; where there is none, as many as a table has."""
    console = Console(stderr=to_stderr)
    return console.width if console.is_terminal else WIDEST


def print_table(table: PlainTable, to_stderr: bool = False) -> None:
    """Print a table, by default on stdout; where that is not a terminal, as wide as it needs to be.

    With --quiet nothing is printed.
    """
    if messages.quiet:
        return
    console = Console(stderr=to_stderr)
    shown = table.rendered(terminal_width(to_stderr))
    if not console.is_terminal:
        widest = console.measure(shown, options=console.options.update(max_width=WIDEST)).maximum
        # Rich measures tables without padding a character short.
        console.width = widest + len(shown.columns)
    console.print(shown)
